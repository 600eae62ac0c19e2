# Continuity equation ∂Ŝ/∂t = −â(z) ∂Q/∂z + b̂(z), integrated from S_u over several cycles.

"""
    AreaRate

Right-hand side dŜ/dτ (z × case), cm² per sample of the flow, in place and without
allocations. The unit of time is one sample, so that steps end exactly on samples.
"""
struct AreaRate
    a::Vector{Float64}
    b::Vector{Float64}          # cm²/s
    slope::Array{Float64, 3}    # ∂Q/∂z, mL/s/cm, (z, time, case), periodic
    spacing::Float64            # time between samples, s
end

function (rate::AreaRate)(du, u, _, τ)
    (; a, b, slope, spacing) = rate
    n_points, n_times, n_cases = size(slope)
    sample = floor(Int, τ)
    fraction = τ - sample
    before, after = mod(sample, n_times) + 1, mod(sample + 1, n_times) + 1
    @inbounds for n in 1:n_cases
        @simd ivdep for i in 1:n_points
            current = (1 - fraction) * slope[i, before, n] + fraction * slope[i, after, n]
            du[i, n] = spacing * (b[i] - a[i] * current)
        end
    end
    return nothing
end

"""
    integrate_area(a, b, start, slope, spacing, cycles)

Ŝ, cm², (z, cycles·time, case), by Tsit5 with steps from sample to sample, as in the
published code. The flow is linear in time between its samples, so this equals the
trapezoidal rule to round-off.

# Arguments

  - `a`, `b`: corrections, – and cm²/s, (z).
  - `start`: Ŝ at t = 0, cm², (z, case).
  - `slope`: ∂Q/∂z, mL/s/cm, (z, time, case).
  - `spacing`: time between samples, s.
"""
function integrate_area(a, b, start, slope, spacing, cycles)
    n_points, n_times, n_cases = size(slope)
    area = zeros(n_points, cycles * n_times, n_cases)
    last = cycles * n_times - 1
    equation = ODEProblem{true, SciMLBase.FullSpecialize}(
        AreaRate(a, b, slope, spacing), start, (0.0, Float64(last)),
    )
    integrator = init(
        equation,
        Tsit5();
        dt = 1.0,
        adaptive = false,
        maxiters = typemax(Int),
        save_on = false,
        save_start = false,
        save_end = false,
        dense = false,
        verbose = SciMLLogging.None(),
    )
    area[:, 1, :] .= start
    for sample in 1:last
        step!(integrator)
        area[:, sample + 1, :] .= integrator.u
    end
    return area
end

"""
    solve_intermediate_area(parameters, flow, area_undeformed, period, z, stage)

Ŝ, cm², (z, cycles·time, case), for `parameters = [â; b̂]`.

# Arguments

  - `flow`: Q, mL/s, (z, time, case), one cycle.
  - `area_undeformed`: S_u, cm², (z, case).
  - `period`: s.
  - `z`: points, cm.
"""
function solve_intermediate_area(
    parameters, flow, area_undeformed, period, z, stage::IntermediateAreaStage,
)
    n_points = length(z)
    a, b = parameters[1:n_points], parameters[(n_points + 1):end]
    spacing = period / size(flow, 2)
    slope = derivative_along_z(flow, z)
    return integrate_area(a, b, area_undeformed, slope, spacing, stage.cycles)
end

"""
    intermediate_area_problem(flow, area_undeformed, target, period, z, stage)

Squared error of the last cycle, an [`Objective`](@ref). The equation is linear in (â, b̂):
it is integrated once, for â = 1 from zero, and not in the fit.
"""
function intermediate_area_problem(
    flow, area_undeformed, target, period, z, stage::IntermediateAreaStage,
)
    n_points, n_times, _ = size(flow)
    unit = [ones(n_points); zeros(n_points)]
    change = solve_intermediate_area(unit, flow, zero(area_undeformed), period, z, stage)
    samples = ((stage.cycles - 1) * n_times):(stage.cycles * n_times - 1)
    elapsed = collect(period / n_times * samples)
    return LinearArea(area_undeformed, change[:, samples .+ 1, :], elapsed, target)
end
