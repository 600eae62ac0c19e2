# All coupling passes and the pressure, case by case.
#
# The flow is Q = Q_in + [W b]·H(z) (see flow.jl). Both area equations are linear in it; they
# act on z through H and on t through [W b] alone, so that
#
#     S = s₀(z) + Σ_k c_k(z)·B_k(t),   c = −a·∂H/∂z,   B = Fourier integral of [W b].
#
# The passes therefore need no array over time and space; only the result does. It equals the
# result of the five stages, one after the other, to round-off.

"""
    predict(parameters, inflow, area_undeformed, z, period, passes, config)

`(flow, area, pressure)`, (z, time, case), mL/s, cm² and dyn/cm². The result of a case does
not depend on the other cases. Without parameters of the pressure stages, the pressure is
`nothing`.

# Arguments

  - `parameters`: flat vectors of the five stages, in their order.
  - `inflow`: Q(z=0, t), mL/s, (time, case).
  - `area_undeformed`: S_u, cm², (z, case).
  - `z`, `period`: points, cm, and cycle length, s.
  - `passes`: number of times that flow and area are solved, one after the other.
  - `config`: a [`Config`](@ref) without physics terms.

# Throws

`SolveError` if a case cannot be integrated.
"""
function predict(parameters, inflow, area_undeformed, z, period, passes, config::Config)
    n_times, n_cases, n_points = size(inflow, 1), size(inflow, 2), length(z)
    flow, area, pressure = (zeros(n_points, n_times, n_cases) for _ in 1:3)
    has_pressure = !isempty(parameters[4])
    threaded_batches(n_cases) do batches
        workspace = PredictionWorkspace(parameters, n_times, z, period, config)
        for batch in batches, case in batch
            single = case:case
            q, s, p = @views flow[:, :, single], area[:, :, single], pressure[:, :, single]
            q_in = view(inflow, :, single)
            start = view(area_undeformed, :, single)
            couple!(q, s, workspace, q_in, start, passes) || throw(divergence(case))
            has_pressure && predict_pressure!(p, workspace, parameters[5], q, s, start)
        end
    end
    return flow, area, has_pressure ? pressure : nothing
end

"""
    PredictionWorkspace(parameters, n_times, z, period, config)

Data that all cases share, and work arrays for one case.

# Fields

  - `a_hat`, `b_hat`, `a`, `b`: corrections of both area equations, (z).
  - `in_time`: [W b]ᵀ, (state, time).
  - `fourier`: B, s, (state, time).
  - `until_anchor`: integral of [W b] up to the anchor, s, (state); `elapsed`: its time, s.
  - `area_to_layer`, `coefficients_to_layer`: maps from s₀ and c to the first layer.
  - `hidden`, `slope`, `coefficients`: H, ∂H/∂z and c, (z, state).
  - `steady`: s₀, (z).
"""
struct PredictionWorkspace{P <: FlowProblem, T}
    physics::Physics
    temporal_stage::TemporalPressureStage
    flow::P
    temporal::T                     # `nothing` without pressure stages
    spatial::SpatialPressure
    a_hat::Vector{Float64}
    b_hat::Vector{Float64}          # cm²/s
    a::Vector{Float64}
    b::Vector{Float64}              # cm²
    in_time::Matrix{Float64}
    fourier::Matrix{Float64}        # s
    until_anchor::Vector{Float64}   # s
    elapsed::Float64                # s
    area_to_layer::Vector{Float64}  # (first hidden)
    coefficients_to_layer::Matrix{Float64}  # (first hidden, state)
    hidden::Matrix{Float64}
    slope::Matrix{Float64}
    coefficients::Matrix{Float64}
    steady::Vector{Float64}
end

function PredictionWorkspace(parameters, n_times, z, period, config::Config)
    flow, intermediate, fourier_area, temporal, spatial = parameters
    n_points = length(z)
    halves(ab) = (ab[1:n_points], ab[(n_points + 1):end])
    zero_inflow, zero_flow = zeros(n_times, 1), zeros(n_points, n_times, 1)
    problem = FlowProblem(zero_inflow, zero_flow, zero_flow, z, config.flow)
    load!(problem.network, flow)
    first, last = problem.network.matrices[1], problem.network.matrices[end]
    mul!(problem.rate.along, view(first, :, 1:n_times), last)
    from_area = view(first, :, (n_times + 1):(2 * n_times))
    in_time = permutedims(last)
    analysis, synthesis = fourier_integral(n_times, config.fourier_area)
    fourier = period .* (in_time * analysis) * synthesis
    fourier .-= fourier[:, 1]
    until_anchor, elapsed = integral_until_anchor(in_time, period, config)
    unit_vessel = ones(n_points, 1)
    pressure = if isempty(temporal)
        nothing
    else
        settings = (config.physics, config.temporal_pressure)
        stage = TemporalPressure(zero_flow, zero_flow, unit_vessel, zero_flow, settings...)
        load!(stage.network, temporal)
        stage
    end
    drop = SpatialPressure(
        zero_flow, zero_flow, unit_vessel, zero_flow, z, config.physics,
        config.spatial_pressure,
    )
    isempty(spatial) || set_profile!(drop, spatial)
    n_state = size(last, 2)
    return PredictionWorkspace(
        config.physics,
        config.temporal_pressure,
        problem,
        pressure,
        drop,
        halves(intermediate)...,
        halves(fourier_area)...,
        in_time,
        fourier,
        until_anchor,
        elapsed,
        vec(sum(from_area; dims = 2)),
        from_area * fourier',
        zeros(n_points, n_state),
        zeros(n_points, n_state),
        zeros(n_points, n_state),
        zeros(n_points),
    )
end

"""
    integral_until_anchor(in_time, period, config)

Integral over time of periodic signals (…, time), linear between their samples, from the
start of the first cycle to the time point that anchors the Fourier area, and its time, s. It
replaces the solve of the intermediate area, which is linear in the flow.
"""
function integral_until_anchor(in_time, period, config::Config)
    n_signals, n_times = size(in_time)
    cycles, anchor = config.intermediate_area.cycles, config.fourier_area.anchor
    steps = if anchor == "undeformed"
        0
    elseif anchor == "last_cycle"
        (cycles - 1) * n_times
    else
        cycles * n_times - 1
    end
    spacing = period / n_times
    minus, zero_ = fill(-1.0, n_signals), zeros(n_signals, 1)
    signals = reshape(in_time, n_signals, n_times, 1)
    integral = integrate_area(minus, vec(zero_), zero_, signals, spacing, cycles)
    return integral[:, steps + 1, 1], steps * spacing
end

"""
    couple!(flow, area, workspace, inflow, area_undeformed, passes)

Run all passes of one case; return whether all solves reached the outlet.
"""
function couple!(flow, area, workspace::PredictionWorkspace, inflow, area_undeformed, passes)
    (; in_time, fourier, coefficients, hidden, steady) = workspace
    problem = workspace.flow
    copyto!(problem.inflow, inflow)
    copyto!(steady, area_undeformed)
    fill!(coefficients, 0.0)
    for _ in 1:passes
        set_first_layer!(workspace)
        integrate_steps!(problem) || return false
        permutedims!(hidden, problem.states, (2, 1))
        update_area!(workspace, area_undeformed)
    end
    flow .= vec(inflow)'
    mul!(view(flow,:,:,1), hidden, in_time, 1.0, 1.0)
    area .= steady
    mul!(view(area,:,:,1), coefficients, fourier, 1.0, 1.0)
    return true
end

"""
    set_first_layer!(workspace)

Compute the part of the first layer that does not depend on H, from the area of the last pass.
"""
function set_first_layer!(workspace::PredictionWorkspace)
    (; rate, network, inflow) = workspace.flow
    (first, constant) = network.matrices[1], workspace.flow.workspace.constant
    n_times = size(inflow, 1)
    mul!(constant, view(first, :, 1:n_times), inflow)
    constant .+= view(first, :, 2 * n_times + 1)
    on_grid = view(rate.on_grid,:,1,:)
    mul!(on_grid, workspace.coefficients_to_layer, workspace.coefficients')
    on_grid .+= workspace.area_to_layer .* workspace.steady' .+ constant
    return nothing
end

"""
    update_area!(workspace, area_undeformed)

Solve both area equations: compute s₀ and c from H.
"""
function update_area!(workspace::PredictionWorkspace, area_undeformed)
    (; a_hat, b_hat, a, b, slope, coefficients, steady, elapsed) = workspace
    derivative_along_z!(slope, workspace.hidden, workspace.flow.z)
    coefficients .= .-a .* slope
    mul!(steady, slope, workspace.until_anchor)
    steady .= area_undeformed .- a_hat .* steady .+ b_hat .* elapsed .+ b
    return nothing
end

"""
    predict_pressure!(pressure, workspace, parameters, flow, area, area_undeformed)

Evaluate both pressure stages for one case; `parameters` are those of the second stage.
"""
function predict_pressure!(
    pressure, workspace::PredictionWorkspace, parameters, flow, area, area_undeformed,
)
    (; temporal, spatial, physics, temporal_stage) = workspace
    set_cases!(temporal, flow, area, area_undeformed, physics, temporal_stage)
    relative = reshape(residual!(temporal), size(pressure))
    set_cases!(spatial, relative, flow, area_undeformed)
    evaluate_pressure!(pressure, spatial, parameters)
    pressure .*= physics.reference_pressure
    return nothing
end
