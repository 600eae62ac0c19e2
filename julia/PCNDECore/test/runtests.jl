using PCNDECore
using PCNDECore:
    Config, FlowProblem, FlowStage, FourierAreaStage, InverseHessian, IntermediateAreaStage,
    Network, Objective, Optimizer, Physics, PhysicsTerms, ReferenceFlow, SolveError,
    SpatialPressure, SpatialPressureStage, StepControl, TemporalFlow, TemporalFlowStage,
    TemporalPressure, TemporalPressureStage, adjoint_gradient, chain, fit, forward_gradient,
    fourier_area_problem, integrate!, intermediate_area_problem, layout, nested_parameters,
    physics_terms, reference_solution, residual!, set_weight!, solve, solve_flow,
    solve_intermediate_area, solve_temporal_flow, value!, value_and_gradient!
# Dependencies are taken from PCNDECore, so that the tests run in every project that contains
# it, even if the project has its dependencies only indirectly.
using PCNDECore: BackTracking, I, Lux, ODEProblem, Optim, SciMLBase, Tsit5, dot, mul!, norm
using PCNDECore.Random: MersenneTwister
using Test

const n_points, n_times, n_cases = 21, 20, 3
const z = collect(range(0.0, 4.0, n_points))

"""
Smooth synthetic cases: inflow (time, case), area (z, time, case), flow, S_u.
"""
function cases()
    t = (0:(n_times - 1)) ./ n_times
    inflow = [1 + 0.2 * n * sin(2π * x + n) + 0.1 * cos(4π * x) for x in t, n in 1:n_cases]
    bump = exp.(-((z .- 2) ./ 0.4) .^ 2)
    area_undeformed = reduce(hcat, [0.125 .* (1 .- 0.2 * n .* bump) for n in 1:n_cases])
    flow = [
        inflow[k, n] * (1 - 0.05 * z[i] / 4 * sin(2π * t[k])) for
        i in 1:n_points, k in 1:n_times, n in 1:n_cases
    ]
    area = [
        area_undeformed[i, n] * (1 + 0.02 * inflow[k, n]) for
        i in 1:n_points, k in 1:n_times, n in 1:n_cases
    ]
    return (; inflow, area, flow, area_undeformed)
end

const data = cases()

glorot(widths, rng) = reduce(
    vcat,
    [
        [
            sqrt(6 / (widths[i] + widths[i + 1])) .*
            (2 .* rand(rng, widths[i] * widths[i + 1]) .- 1)
            0.1 .* randn(rng, widths[i + 1])
        ] for i in 1:(length(widths) - 1)
    ],
)

"""
Lux's parameters and states of a flat parameter vector.
"""
function lux_parameters(model, parameters)
    nested, states = Lux.setup(MersenneTwister(0), model)
    return nested_parameters(layout(nested), parameters), states
end

flow_widths(stage) = [2 * n_times; stage.hidden; n_times]
flow_problem(stage) = FlowProblem(copy(data.inflow), data.area, data.flow, z, stage)

"""
Compare the gradient of an objective with central differences along random directions.
"""
function check_gradient(objective, parameters; rtol, step = 1e-5)
    gradient = similar(parameters)
    value_and_gradient!(gradient, objective, parameters)
    rng = MersenneTwister(3)
    for _ in 1:3
        direction = randn(rng, length(parameters))
        ahead = value!(objective, parameters .+ step .* direction)
        behind = value!(objective, parameters .- step .* direction)
        @test dot(gradient, direction) ≈ (ahead - behind) / 2step rtol = rtol
    end
end

@testset "PCNDECore" begin
    include("network.jl")
    include("flow.jl")
    include("reference.jl")
    include("physics_terms.jl")
    include("temporal_flow.jl")
    include("area.jl")
    include("pressure.jl")
    include("fit.jl")
    include("predict.jl")
    include("closures.jl")
    include("bridge.jl")
    include("hygiene.jl")
end
