# Preset `physics`: value and Jacobian of each closure for its fit, and the coupled prediction.

"""
Largest allowed change of the last coupling pass, relative to the largest inflow.
"""
const CHANGE_LIMIT = 1e-4

"""
Change of Q(L), relative to the largest inflow, below which a prediction needs no further pass.
"""
const PASS_TOLERANCE = 1e-9

"""
Largest number of parameters whose derivatives are computed at the same time: the losses have ten.
"""
const MAX_CHUNK = 10

"""
Largest number of vessels in a cache.
"""
const MAX_CACHED_VESSELS = 256

"""
    value_and_jacobian(closure, parameters)

Value of the closure (z, time, case), and its Jacobian (parameter, z, time, case) by
forward-mode differentiation.
"""
function value_and_jacobian(closure, parameters::Vector{Float64})
    value = closure(parameters)
    chunk = ForwardDiff.Chunk(length(parameters), MAX_CHUNK)
    settings = ForwardDiff.JacobianConfig(closure, parameters, chunk)
    jacobian = ForwardDiff.jacobian(closure, parameters, settings)
    return value, reshape(permutedims(jacobian), :, size(value)...)
end

"""
    LossesClosure(flow, flow_rate, area_undeformed, z, config)

p − p(L), dyn/cm², (z, time, case), of a known flow and its derivative ∂Q/∂t, mL/s and mL/s², as
a function of the parameters of the losses. The time points are arbitrary.

# Fields

  - `flow`, `flow_rate`: Q and ∂Q/∂t, (z, time, case).
  - `vessels`: S_u of the different vessels, cm², (z) each.
  - `vessel_of`: number of each case's vessel.
  - `z`, `physics`: points, cm, and a [`Physics`](@ref).
"""
struct LossesClosure
    flow::Array{Float64, 3}
    flow_rate::Array{Float64, 3}
    vessels::Vector{Vector{Float64}}
    vessel_of::Vector{Int}
    z::Vector{Float64}
    physics::Physics
end

function LossesClosure(flow, flow_rate, area_undeformed, z, config::ClosureConfig)
    areas = collect.(eachcol(area_undeformed))
    vessels = unique(areas)
    return LossesClosure(flow, flow_rate, vessels, indexin(areas, vessels), z, config.physics)
end

function (closure::LossesClosure)(parameters::Vector{T}) where {T}
    (; flow, flow_rate, vessels, vessel_of, z, physics) = closure
    coefficients = Vector{LossCoefficients{T}}(undef, length(vessels))
    threaded_batches(length(vessels)) do batches
        for batch in batches, vessel in batch
            coefficients[vessel] = LossCoefficients(parameters, vessels[vessel], z, physics)
        end
    end
    pressure = similar(flow, T)
    threaded_batches(size(flow, 3)) do batches
        for batch in batches, case in batch
            @views pressure_drop!(
                pressure[:, :, case], coefficients[vessel_of[case]], flow[:, :, case],
                flow_rate[:, :, case], z,
            )
        end
    end
    return pressure
end

"""
    AreaClosure(pressure, area_undeformed, z, config)

S, cm², (z, time, case), under a known pressure, as a function of the wall parameters.
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
    threaded_batches(size(pressure, 3)) do batches
        for batch in batches, case in batch
            s_u = area_undeformed[:, case]
            loads = pressure[:, :, case] .- parameters[end]
            radial = displacement(parameters, loads, s_u, z, law)
            area[:, :, case] .= π .* (sqrt.(s_u ./ π) .+ radial) .^ 2
        end
    end
    return area
end

"""
    ShearClosure(losses, flow, flow_rate, area_undeformed, z, config)

Wall shear stress in the direction of z, dyn/cm², (z, time, case), of a known flow and its
derivative ∂Q/∂t, as a function of its parameters. `losses` are the parameters of the losses.
"""
struct ShearClosure
    flow::Array{Float64, 3}
    flow_rate::Array{Float64, 3}
    terms::Vector{ShearTerms}
    reference_flow::Vector{Float64}
    vessel_of::Vector{Int}
end

function ShearClosure(losses, flow, flow_rate, area_undeformed, z, config::ClosureConfig)
    areas = collect.(eachcol(area_undeformed))
    vessels = unique(areas)
    momentum = LossParameters(losses).jet_momentum
    coefficients = [LossCoefficients(losses, s_u, z, config.physics) for s_u in vessels]
    terms = [
        ShearTerms(c, momentum, s_u, z, config.physics) for
        (c, s_u) in zip(coefficients, vessels)
    ]
    reference_flow = [c.reference_flow for c in coefficients]
    return ShearClosure(flow, flow_rate, terms, reference_flow, indexin(areas, vessels))
end

function (closure::ShearClosure)(parameters::Vector{T}) where {T}
    (; flow, flow_rate, terms, reference_flow, vessel_of) = closure
    stress = similar(flow, T)
    threaded_batches(size(flow, 3)) do batches
        for batch in batches, case in batch
            vessel = vessel_of[case]
            @views wall_shear_stress!(
                stress[:, :, case], parameters, terms[vessel], reference_flow[vessel],
                flow[:, :, case], flow_rate[:, :, case],
            )
        end
    end
    return stress
end

"""
    FlowClosure(
        outlets, losses, wall, inflow, area_undeformed, outward, points, z, period, config,
    )

Q, mL/s, (point, time, case), of the coupled equations, as a function of the parameters of the
correction. `outlets` are those of [`outlet_laws`](@ref). `outward` (given, z) interpolates from
z to the given points; `points` are indices of given points.
"""
struct FlowClosure
    outlets::Vector{OutletLaw}
    wall::Vector{Float64}
    vessels::Vector{VesselModes}
    inflow::Matrix{Float64}
    points::Vector{Int}
    harmonics::Harmonics
    settings::CorrectionClosure
end

function FlowClosure(
    outlets, losses, wall, inflow, area_undeformed, outward, points, z, period,
    config::ClosureConfig,
)
    vessels = VesselCache(wall, losses, zeros(N_SHEAR), z, outward, config)
    harmonics = Harmonics(size(inflow, 1), period)
    return FlowClosure(
        outlet_laws(outlets, harmonics, size(inflow, 2)),
        wall,
        [vessels(view(area_undeformed, :, case)) for case in axes(area_undeformed, 2)],
        inflow,
        points,
        harmonics,
        config.correction,
    )
end

function (closure::FlowClosure)(parameters::Vector{T}) where {T}
    (; outlets, wall, vessels, inflow, points, harmonics, settings) = closure
    flow = Array{T}(undef, length(points), size(inflow)...)
    threaded_batches(size(inflow, 2), BATCH_SIZE) do batches
        workspace, in_z = CoupledBatch(T, harmonics), similar(first(vessels).flow)
        for batch in batches
            @views selected, q = vessels[batch], inflow[:, batch]
            coupled_cases = couple!(
                workspace, outlets[batch], wall, parameters, zeros(length(batch)), selected,
                q, harmonics, settings,
            )
            for (case, coupled, vessel) in zip(batch, coupled_cases, selected)
                modes_at_mean!(in_z, vessel.flow, vessel.flow_slope, coupled.mean_pressure)
                flow[:, :, case] .= in_z[points, :] * coupled.flow
            end
        end
    end
    return flow
end

"""
    VesselCache(wall, losses, shear, z, outward, config)

Function that returns the [`VesselModes`](@ref) of a vessel, S_u (z), at the points to which
`outward` (given, z) interpolates, and caches them: many waveforms usually share few vessels.
Threads may share it.
"""
struct VesselCache
    wall::Vector{Float64}
    losses::Vector{Float64}
    shear::Vector{Float64}
    z::Vector{Float64}
    outward::Matrix{Float64}
    config::ClosureConfig
    cached::Dict{Vector{Float64}, VesselModes}
    lock::ReentrantLock
end

function VesselCache(wall, losses, shear, z, outward, config)
    cached = Dict{Vector{Float64}, VesselModes}()
    copies = map(copy, (wall, losses, shear, z, outward))
    return VesselCache(copies..., config, cached, ReentrantLock())
end

VesselCache() = VesselCache(ntuple(_ -> Float64[], 4)..., zeros(0, 0), ClosureConfig())

function (vessels::VesselCache)(area_undeformed::AbstractVector{Float64})
    (; wall, losses, shear, z, outward, config, cached) = vessels
    modes = @lock vessels.lock get(cached, area_undeformed, nothing)
    modes === nothing || return modes
    area = Vector(area_undeformed)
    modes_at_z = VesselModes(wall, losses, shear, area, z, config.wall.law, config.physics)
    new_modes = interpolated(modes_at_z, outward)
    @lock vessels.lock begin
        length(cached) < MAX_CACHED_VESSELS || empty!(cached)
        cached[area] = new_modes
    end
    return new_modes
end

"""
    ClosureWorkspace(harmonics, n_points)

Buffers for [`BATCH_SIZE`](@ref) cases and their fields.
"""
struct ClosureWorkspace{B <: CoupledBatch}
    harmonics::Harmonics
    batch::B
    fields::FieldWorkspace
end

ClosureWorkspace(harmonics::Harmonics, n_points::Integer) = ClosureWorkspace(
    harmonics, CoupledBatch(Float64, harmonics), FieldWorkspace(n_points, harmonics.n_times),
)

"""
    predict_closures!(
        flow, area, pressure, shear, parameters, shift, inflow, area_undeformed, z, outward,
        period, config,
    )

Compute flow, area, pressure and the magnitude of the wall shear stress, (given, time, case),
mL/s, cm² and dyn/cm². The result of a case does not depend on the other cases.

# Arguments

  - `parameters`: outlets, see [`outlet_laws`](@ref), and vectors of losses, wall, correction and
    wall shear stress.
  - `shift`: added to the argument of the correction's sigmoid, (case).
  - `inflow`: Q(z=0, t), mL/s, (time, case).
  - `area_undeformed`: S_u, cm², (z, case).
  - `z`, `outward`: points, cm, at which the equations are solved, and the matrix (given, z)
    that interpolates to the given points.
  - `period`: cycle length, s.
  - `config`: a [`ClosureConfig`](@ref).

# Throws

`SolveError` if the coupling passes of a case do not converge.
"""
function predict_closures!(
    flow, area, pressure, shear, parameters, shift, inflow, area_undeformed, z, outward,
    period, config::ClosureConfig,
)
    outlets, losses, wall, correction, shear_parameters = parameters
    n_times, n_cases = size(inflow)
    harmonics = cached_harmonics!(STATE, n_times, period)
    laws = outlet_laws(outlets, harmonics, n_cases)
    vessels = cached_vessels!(STATE, wall, losses, shear_parameters, z, outward, config)
    # Larger amplitudes need more passes: batches of similar amplitude need similarly many.
    order = sortperm(vec(maximum(abs, inflow; dims = 1)); rev = true)
    converged = fill(false, n_cases)
    threaded_batches(n_cases, BATCH_SIZE) do batches
        workspace = acquire_workspace!(STATE, harmonics, size(outward, 1))
        for batch in batches
            cases = view(order, batch)
            selected = [vessels(view(area_undeformed, :, case)) for case in cases]
            @views coupled_cases = couple!(
                workspace.batch, laws[cases], wall, correction, shift[cases], selected,
                inflow[:, cases], harmonics, config.correction, PASS_TOLERANCE,
            )
            for (case, coupled, vessel) in zip(cases, coupled_cases, selected)
                converged[case] = coupled.change <= CHANGE_LIMIT * coupled.largest_inflow
                @views fields!(
                    flow[:, :, case], area[:, :, case], pressure[:, :, case],
                    shear[:, :, case], coupled, vessel, workspace.fields,
                )
            end
        end
        release_workspace!(STATE, workspace)
    end
    failed = findfirst(!, converged)
    failed === nothing || throw(not_converged(failed, config.correction.passes))
    return nothing
end

not_converged(case, passes) = SolveError(
    "Flow, area and pressure of case $(case - 1) do not settle in $passes coupling passes. " *
    "Check the units of inflow and area (mL/s, cm²); a stronger waveform or a longer " *
    "vessel needs more passes (correction.passes).",
)
