# All coupling passes and the pressure, case by case.
#
# The flow is Q = Q_in + [W b]·H(z) (see flow.jl). Both area equations are linear in it and
# act on z through H and on t through [W b] alone, so that
#
#     S = s₀(z) + Σ_k c_k(z)·B_k(t),   c = −a·∂H/∂z,   B = Fourier integral of [W b].
#
# The passes therefore need no array over time and space; only the result does. It is what
# the five stages give one after the other, but for round-off.

"""
    predict(parameters, inflow, area_undeformed, z, period, passes, config)

`(flow, area, pressure)`, (z, time, case), mL/s, cm² and dyn/cm², of every case on its own;
without parameters of the pressure stages the pressure is `nothing`.

# Arguments

  - `parameters`: flat vectors of the five stages, in their order.
  - `inflow`: Q(z=0, t), mL/s, (time, case).
  - `area_undeformed`: S_u, cm², (z, case).
  - `z`, `period`: points, cm, and length of the cycle, s.
  - `passes`: how often flow and area are solved, one after the other.
  - `config`: a [`Config`](@ref), without physics terms.

# Throws

`SolveError` if a case cannot be integrated.
"""
function predict(parameters, inflow, area_undeformed, z, period, passes, config::Config)
    n_times, n_cases, n_points = size(inflow, 1), size(inflow, 2), length(z)
    flow, area, pressure = (zeros(n_points, n_times, n_cases) for _ in 1:3)
    has_pressure = !isempty(parameters[4])
    over_cases(n_cases) do parts
        room = PredictionRoom(parameters, n_times, z, period, config)
        for part in parts, case in part
            one = case:case
            q, s, p = @views flow[:, :, one], area[:, :, one], pressure[:, :, one]
            in_ = view(inflow, :, one)
            start = view(area_undeformed, :, one)
            couple!(q, s, room, in_, start, passes) || throw(divergence(case))
            has_pressure && press!(p, room, parameters[5], q, s, start)
        end
    end
    return flow, area, has_pressure ? pressure : nothing
end

"""
    PredictionRoom(parameters, n_times, z, period, config)

What the cases share, and room for one of them. In time, (state, time):

  - `in_time`: [W b]ᵀ; `fourier`: B, s.

In space, (z, state): `hidden`, H, its `slope`, and `wave`, c; (z): `steady`, s₀.
"""
struct PredictionRoom{P <: FlowProblem, T}
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
    until_anchor::Vector{Float64}   # (state): integral of [W b] up to the anchor, s
    elapsed::Float64                # time of the anchor, s
    area_to_layer::Vector{Float64}  # (first hidden)
    wave_to_layer::Matrix{Float64}  # (first hidden, state)
    hidden::Matrix{Float64}
    slope::Matrix{Float64}
    wave::Matrix{Float64}
    steady::Vector{Float64}
end

function PredictionRoom(parameters, n_times, z, period, config::Config)
    flow, intermediate, fourier_area, temporal, spatial = parameters
    n_points = length(z)
    halves(ab) = (ab[1:n_points], ab[(n_points + 1):end])
    like_inflow, like_flow = zeros(n_times, 1), zeros(n_points, n_times, 1)
    problem = FlowProblem(like_inflow, like_flow, like_flow, z, config.flow)
    load!(problem.network, flow)
    first, last = problem.network.matrices[1], problem.network.matrices[end]
    mul!(problem.rate.along, view(first, :, 1:n_times), last)
    from_area = view(first, :, (n_times + 1):(2 * n_times))
    in_time = permutedims(last)
    analysis, synthesis = fourier_integral(n_times, config.fourier_area)
    fourier = period .* (in_time * analysis) * synthesis
    fourier .-= fourier[:, 1]
    until_anchor, elapsed = integral_until_anchor(in_time, period, config)
    some_vessel = ones(n_points, 1)
    pressure = if isempty(temporal)
        nothing
    else
        settings = (config.physics, config.temporal_pressure)
        room = TemporalPressure(like_flow, like_flow, some_vessel, like_flow, settings...)
        load!(room.network, temporal)
        room
    end
    drop = SpatialPressure(
        like_flow, like_flow, some_vessel, like_flow, z, config.physics,
        config.spatial_pressure,
    )
    isempty(spatial) || steps!(drop, spatial)
    n_state = size(last, 2)
    return PredictionRoom(
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

Integral over time of periodic signals, linear between their samples (…, time), from the
start of the first cycle to the instant that anchors the Fourier area, and its time, s.
The intermediate area is linear in the flow, so that this takes the place of its solve.
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
    couple!(flow, area, room, inflow, area_undeformed, passes)

All passes of one case; returns whether all solves came to their end.
"""
function couple!(flow, area, room::PredictionRoom, inflow, area_undeformed, passes)
    (; in_time, fourier, wave, hidden, steady) = room
    problem = room.flow
    copyto!(problem.inflow, inflow)
    copyto!(steady, area_undeformed)
    fill!(wave, 0.0)
    for _ in 1:passes
        layer_on_grid!(room)
        march!(problem) || return false
        permutedims!(hidden, problem.states, (2, 1))
        area_after!(room, area_undeformed)
    end
    flow .= vec(inflow)'
    mul!(view(flow,:,:,1), hidden, in_time, 1.0, 1.0)
    area .= steady
    mul!(view(area,:,:,1), wave, fourier, 1.0, 1.0)
    return true
end

"""
    layer_on_grid!(room)

The first layer's part that does not depend on H, from the area of the last pass.
"""
function layer_on_grid!(room::PredictionRoom)
    (; rate, network, inflow) = room.flow
    (first, constant) = network.matrices[1], room.flow.room.constant
    n_times = size(inflow, 1)
    mul!(constant, view(first, :, 1:n_times), inflow)
    constant .+= view(first, :, 2 * n_times + 1)
    on_grid = view(rate.on_grid,:,1,:)
    mul!(on_grid, room.wave_to_layer, room.wave')
    on_grid .+= room.area_to_layer .* room.steady' .+ constant
    return nothing
end

"""
    area_after!(room, area_undeformed)

Both area equations, as s₀ and c, from H.
"""
function area_after!(room::PredictionRoom, area_undeformed)
    (; a_hat, b_hat, a, b, slope, wave, steady, elapsed) = room
    slope_along_z!(slope, room.hidden, room.flow.z)
    wave .= .-a .* slope
    mul!(steady, slope, room.until_anchor)
    steady .= area_undeformed .- a_hat .* steady .+ b_hat .* elapsed .+ b
    return nothing
end

"""
    press!(pressure, room, parameters, flow, area, area_undeformed)

Both pressure stages of one case; `parameters` are those of the second.
"""
function press!(pressure, room::PredictionRoom, parameters, flow, area, area_undeformed)
    (; temporal, spatial, physics, temporal_stage) = room
    set_cases!(temporal, flow, area, area_undeformed, physics, temporal_stage)
    relative = reshape(residual!(temporal), size(pressure))
    set_cases!(spatial, relative, flow, area_undeformed)
    after_steps!(pressure, spatial, parameters)
    pressure .*= physics.reference_pressure
    return nothing
end
