# The preset `physics`: what its fits need of each closure, and the prediction of all coupled.

"""
Largest change of the last coupling pass, relative to the largest inflow.
"""
const ACCEPTED = 1e-4

"""
Change of Q(L), relative to the largest inflow, below which a prediction's passes end.
"""
const SETTLED = 1e-9

"""
Parameters whose derivatives are computed together, at most.
"""
const TOGETHER = 8

"""
Vessels that are kept at a time by each thread.
"""
const VESSELS = 64

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
    over_cases(size(flow, 3)) do cases
        for case in cases
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
    over_cases(size(pressure, 3)) do cases
        for case in cases
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
    outlet::Vector{Float64}
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
    vessels = vessels_of(wall, losses, z, config)
    return FlowClosure(
        outlet,
        wall,
        [vessels(column) for column in eachcol(area_undeformed)],
        inflow,
        points,
        Harmonics(size(inflow, 1), period),
        config.correction,
    )
end

function (closure::FlowClosure)(parameters::Vector{T}) where {T}
    (; outlet, wall, vessels, inflow, points, harmonics, settings) = closure
    flow = Array{T}(undef, length(points), size(inflow)...)
    over_cases(size(inflow, 2)) do cases
        for case in cases
            q, vessel = inflow[:, case], vessels[case]
            coupled = couple(outlet, wall, parameters, 0.0, vessel, q, harmonics, settings)
            flow[:, :, case] .= q' .+ coupled.volume[points, :] * coupled.storage
        end
    end
    return flow
end

"""
    vessels_of(wall, losses, z, config)

A function from S_u to its [`VesselModes`](@ref) that remembers the last few: many
waveforms usually share few vessels.
"""
function vessels_of(wall, losses, z, config::ClosureConfig)
    known = Dict{Vector{Float64}, VesselModes}()
    return function (area_undeformed)
        length(known) < VESSELS || empty!(known)
        return get!(known, area_undeformed) do
            VesselModes(wall, losses, area_undeformed, z, config.wall.law, config.physics)
        end
    end
end

"""
    predict_closures(parameters, shift, inflow, area_undeformed, z, period, config)

`(flow, area, pressure)`, (z, time, case), mL/s, cm² and dyn/cm², of every case on its own.

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
function predict_closures(
    parameters, shift, inflow, area_undeformed, z, period, config::ClosureConfig,
)
    outlet, losses, wall, correction = parameters
    n_times, n_cases = size(inflow)
    harmonics = Harmonics(n_times, period)
    flow, area, pressure = (Array{Float64}(undef, length(z), n_times, n_cases) for _ in 1:3)
    over_cases(n_cases) do cases
        vessels = vessels_of(wall, losses, z, config)
        for case in cases
            vessel, q = vessels(area_undeformed[:, case]), inflow[:, case]
            coupled = couple(
                outlet, wall, correction, shift[case], vessel, q, harmonics,
                config.correction, SETTLED,
            )
            coupled.change <= ACCEPTED * maximum(abs, q) ||
                throw(unsettled(case, config.correction.passes))
            @views fields!(
                flow[:, :, case], area[:, :, case], pressure[:, :, case],
                coupled, vessel, wall, q,
            )
        end
    end
    return flow, area, pressure
end

unsettled(case, passes) = SolveError(
    "Flow, area and pressure of case $(case - 1) do not settle in $passes coupling passes. " *
    "Check the units of inflow and area (mL/s, cm²); a stiffer wave or a longer vessel needs " *
    "more passes (correction.passes).",
)
