# The preset `physics`: what its fits need of each closure, and the prediction of all coupled.

"""
Largest change of the last coupling pass, relative to the largest inflow.
"""
const ACCEPTED = 1e-4

"""
A prediction makes no more pass that would change Q(L) by less, relative to the largest inflow.
"""
const SETTLED = 1e-9

"""
Parameters whose derivatives are computed together, at most.
"""
const TOGETHER = 8

"""
Vessels that are remembered.
"""
const VESSELS = 256

"""
    value_and_jacobian(closure, parameters)

The closure's value (z, time, case), and its Jacobian (parameter, z, time, case) by forward
mode.
"""
function value_and_jacobian(closure, parameters::Vector{Float64})
    value = closure(parameters)
    chunk = ForwardDiff.Chunk(min(length(parameters), TOGETHER))
    settings = ForwardDiff.JacobianConfig(closure, parameters, chunk)
    jacobian = ForwardDiff.jacobian(closure, parameters, settings)
    return value, reshape(permutedims(jacobian), :, size(value)...)
end

"""
    LossesClosure(flow, area_undeformed, z, period, config)

p − p(L), dyn/cm², (z, time, case), of a flow that is known everywhere, as a function of the
losses' parameters.
"""
struct LossesClosure
    flow::Array{Float64, 3}
    flow_rate::Array{Float64, 3}
    area_undeformed::Matrix{Float64}
    z::Vector{Float64}
    physics::Physics
end

function LossesClosure(flow, area_undeformed, z, period, config::ClosureConfig)
    harmonics, flow_rate = Harmonics(size(flow, 2), period), similar(flow)
    for case in axes(flow, 3)
        flow_rate[:, :, case] = rate(harmonics, flow[:, :, case])
    end
    return LossesClosure(flow, flow_rate, area_undeformed, z, config.physics)
end

function (closure::LossesClosure)(parameters::Vector{T}) where {T}
    (; flow, flow_rate, area_undeformed, z, physics) = closure
    pressure = similar(flow, T)
    over_cases(size(flow, 3)) do parts
        for part in parts, case in part
            c = Coefficients(parameters, area_undeformed[:, case], z, physics)
            @views drop!(pressure[:, :, case], c, flow[:, :, case], flow_rate[:, :, case], z)
        end
    end
    return pressure
end

"""
    AreaClosure(pressure, area_undeformed, z, config)

S, cm², (z, time, case), under a pressure that is known everywhere, as a function of the
wall's parameters.
"""
struct AreaClosure
    pressure::Array{Float64, 3}
    area_undeformed::Matrix{Float64}
    z::Vector{Float64}
    law::String
end

AreaClosure(pressure, area_undeformed, z, config::ClosureConfig) =
    AreaClosure(pressure, area_undeformed, z, config.wall.law)

function (closure::AreaClosure)(parameters::Vector{T}) where {T}
    (; pressure, area_undeformed, z, law) = closure
    area = similar(pressure, T)
    over_cases(size(pressure, 3)) do parts
        for part in parts, case in part
            s_u = area_undeformed[:, case]
            loads = pressure[:, :, case] .- parameters[end]
            moved = displacement(parameters, loads, s_u, z, law)
            area[:, :, case] .= π .* (sqrt.(s_u ./ π) .+ moved) .^ 2
        end
    end
    return area
end

"""
    FlowClosure(outlet, losses, wall, inflow, area_undeformed, points, z, period, config)

Q, mL/s, (point, time, case), of all coupled, as a function of the correction's parameters.
`points` are positions in z.
"""
struct FlowClosure
    outlet::OutletLaw
    wall::Vector{Float64}
    vessels::Vector{VesselModes}
    inflow::Matrix{Float64}
    points::Vector{Int}
    harmonics::Harmonics
    settings::CorrectionClosure
end

function FlowClosure(
    outlet, losses, wall, inflow, area_undeformed, points, z, period, config::ClosureConfig,
)
    vessels = Vessels(wall, losses, z, config)
    harmonics = Harmonics(size(inflow, 1), period)
    return FlowClosure(
        OutletLaw(outlet, size(inflow, 1), period),
        wall,
        [vessels(view(area_undeformed, :, case)) for case in axes(area_undeformed, 2)],
        inflow,
        points,
        harmonics,
        config.correction,
    )
end

function (closure::FlowClosure)(parameters::Vector{T}) where {T}
    (; outlet, wall, vessels, inflow, points, harmonics, settings) = closure
    flow = Array{T}(undef, length(points), size(inflow)...)
    over_cases(size(inflow, 2), CASES_TOGETHER) do parts
        together, in_z = Together(T, harmonics), similar(first(vessels).flow)
        for part in parts
            @views here, q, no_shift = vessels[part], inflow[:, part], zeros(length(part))
            found = couple!(
                together, outlet, wall, parameters, no_shift, here, q, harmonics, settings,
            )
            for (case, coupled, vessel) in zip(part, found, here)
                at_mean!(in_z, vessel.flow, vessel.flow_slope, coupled.mean_pressure)
                flow[:, :, case] .= in_z[points, :] * coupled.flow
            end
        end
    end
    return flow
end

"""
    Vessels(wall, losses, z, config)

Makes the [`VesselModes`](@ref) of a vessel, S_u (z), and remembers those of the last few:
many waveforms usually share few vessels. Threads may share it.
"""
struct Vessels
    wall::Vector{Float64}
    losses::Vector{Float64}
    z::Vector{Float64}
    config::ClosureConfig
    known::Dict{Vector{Float64}, VesselModes}
    lock::ReentrantLock
end

function Vessels(wall, losses, z, config)
    known = Dict{Vector{Float64}, VesselModes}()
    return Vessels(copy(wall), copy(losses), copy(z), config, known, ReentrantLock())
end

function (vessels::Vessels)(area_undeformed::AbstractVector{Float64})
    (; wall, losses, z, config, known) = vessels
    found = @lock vessels.lock get(known, area_undeformed, nothing)
    found === nothing || return found
    area = Vector(area_undeformed)
    made = VesselModes(wall, losses, area, z, config.wall.law, config.physics)
    @lock vessels.lock begin
        length(known) < VESSELS || empty!(known)
        known[area] = made
    end
    return made
end

# What the last prediction made, for the next one of the same model.
const LAST_VESSELS = Ref(Vessels(Float64[], Float64[], Float64[], ClosureConfig()))
const LAST_HARMONICS = Ref((NaN, Harmonics(2, 1.0)))

function remembered_vessels(wall, losses, z, config::ClosureConfig)
    last = LAST_VESSELS[]
    same =
        (last.wall, last.losses, last.z) == (wall, losses, z) &&
        (last.config.wall, last.config.physics) == (config.wall, config.physics)
    same || (LAST_VESSELS[] = Vessels(wall, losses, z, config))
    return LAST_VESSELS[]
end

"""
    Room(harmonics, n_points)

Room for [`CASES_TOGETHER`](@ref) cases and their fields.
"""
struct Room{T <: Together}
    harmonics::Harmonics
    together::T
    fields::FieldsRoom
end

Room(harmonics::Harmonics, n_points::Integer) = Room(
    harmonics, Together(Float64, harmonics), FieldsRoom(n_points, harmonics.n_times),
)

# Of the last prediction, one for each thread; the first is there for its type.
const FREE_ROOMS = [Room(Harmonics(2, 1.0), 2)]
const FREE_ROOMS_LOCK = ReentrantLock()

function take_room(harmonics::Harmonics, n_points)
    fits(room) = room.harmonics === harmonics && size(room.fields.in_z, 1) == n_points
    @lock FREE_ROOMS_LOCK begin
        filter!(fits, FREE_ROOMS)
        isempty(FREE_ROOMS) || return pop!(FREE_ROOMS)
    end
    return Room(harmonics, n_points)
end

give_back(room::Room) = @lock FREE_ROOMS_LOCK push!(FREE_ROOMS, room)

function remembered_harmonics(n_times, period)
    last_period, last = LAST_HARMONICS[]
    (period, n_times) == (last_period, last.n_times) && return last
    harmonics = Harmonics(n_times, period)
    LAST_HARMONICS[] = (period, harmonics)
    return harmonics
end

"""
    predict_closures!(
        flow, area, pressure, parameters, shift, inflow, area_undeformed, z, period, config,
    )

Write flow, area and pressure, (z, time, case), mL/s, cm² and dyn/cm², of every case on its
own.

# Arguments

  - `parameters`: vectors of outlet, losses, wall and correction.
  - `shift`: of the correction's logit, (case).
  - `inflow`: Q(z=0, t), mL/s, (time, case).
  - `area_undeformed`: S_u, cm², (z, case).
  - `z`, `period`: points, cm, and length of the cycle, s.
  - `config`: a [`ClosureConfig`](@ref).

# Throws

`SolveError` if the coupling passes of a case do not converge.
"""
function predict_closures!(
    flow, area, pressure, parameters, shift, inflow, area_undeformed, z, period,
    config::ClosureConfig,
)
    outlet_parameters, losses, wall, correction = parameters
    n_times, n_cases = size(inflow)
    harmonics = remembered_harmonics(n_times, period)
    outlet = OutletLaw(outlet_parameters, n_times, period)
    vessels = remembered_vessels(wall, losses, z, config)
    # Stronger waves need more passes: those of like strength end theirs together.
    order = sortperm(vec(maximum(abs, inflow; dims = 1)); rev = true)
    settles = fill(false, n_cases)
    over_cases(n_cases, CASES_TOGETHER) do parts
        room = take_room(harmonics, length(z))
        for part in parts
            cases = view(order, part)
            here = [vessels(view(area_undeformed, :, case)) for case in cases]
            @views found = couple!(
                room.together, outlet, wall, correction, shift[cases], here,
                inflow[:, cases],
                harmonics, config.correction, SETTLED,
            )
            for (case, coupled, vessel) in zip(cases, found, here)
                settles[case] = coupled.change <= ACCEPTED * coupled.largest_inflow
                @views fields!(
                    flow[:, :, case], area[:, :, case], pressure[:, :, case], coupled, vessel,
                    room.fields,
                )
            end
        end
        give_back(room)
    end
    failed = findfirst(!, settles)
    failed === nothing || throw(unsettled(failed, config.correction.passes))
    return nothing
end

unsettled(case, passes) = SolveError(
    "Flow, area and pressure of case $(case - 1) do not settle in $passes coupling passes. " *
    "Check the units of inflow and area (mL/s, cm²); a stronger waveform or a longer " *
    "vessel needs more passes (correction.passes).",
)
