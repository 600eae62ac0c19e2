# Reference implementation of the flow's fit from public interfaces of the libraries alone: Lux
# evaluates the network, OrdinaryDiffEq's Tsit5 steps the flow with its own controller, ForwardDiff
# differentiates the loss, and Optim's BFGS with a dense matrix minimizes it. It is the standard
# for the kernels, the reduced state, the discrete adjoint and the implicit inverse Hessian.

using PCNDECore: ForwardDiff

"""
    ReferenceFlow(model, inflow, area, target, z; rtol, atol)

Momentum equation ∂Q/∂z = f_θ(Q, S) with any Lux `Chain` of `Dense` layers as f_θ.

# Fields

  - `inflow`: Q(z=0, t), mL/s, (time, case).
  - `area`, `target`: S, cm², and reference Q, mL/s, (z, time, case).
  - `z`: points, cm.
  - `rtol`, `atol`: tolerances of the solver.
"""
Base.@kwdef struct ReferenceFlow{M}
    model::M
    inflow::Matrix{Float64}
    area::Array{Float64, 3}
    target::Array{Float64, 3}
    z::Vector{Float64}
    rtol::Float64
    atol::Float64
end

"""
    reference_solution(problem, parameters)

Q, mL/s, (z, time, case), of parameters in a flat vector.
"""
function reference_solution(problem::ReferenceFlow, parameters)
    (; model, inflow, area, z, rtol, atol) = problem
    ps, st = lux_parameters(model, parameters)
    function rate(q, _, position)
        i = clamp(searchsortedlast(z, position), 1, length(z) - 1)
        fraction = (position - z[i]) / (z[i + 1] - z[i])
        s = (1 - fraction) .* area[i, :, :] .+ fraction .* area[i + 1, :, :]
        return first(Lux.apply(model, [q; s], ps, st))
    end
    start = eltype(parameters).(inflow)
    equation = ODEProblem{false}(rate, start, (z[1], z[end]))
    solution = SciMLBase.solve(
        equation, Tsit5(); abstol = atol, reltol = rtol, saveat = z, maxiters = 10^5,
    )
    return permutedims(stack(solution.u), (3, 1, 2))
end

"""
    reference_loss(problem, parameters)

Mean squared error of the flow.
"""
reference_loss(problem::ReferenceFlow, parameters) =
    sum(abs2, reference_solution(problem, parameters) .- problem.target) /
    length(problem.target)

"""
    reference_gradient(problem, parameters)

Gradient of [`reference_loss`](@ref) by forward-mode differentiation through the solver.
"""
reference_gradient(problem::ReferenceFlow, parameters) =
    ForwardDiff.gradient(θ -> reference_loss(problem, θ), parameters)

"""
    reference_fit(problem, parameters, settings, iterations)

`(parameters, losses)` of Optim's BFGS with its own dense matrix and line search.
"""
function reference_fit(problem::ReferenceFlow, parameters, settings, iterations)
    method = Optim.BFGS(;
        linesearch = BackTracking(order = 3),
        initial_stepnorm = settings.initial_step_norm,
    )
    options = Optim.Options(; iterations, store_trace = true)
    result = Optim.optimize(
        θ -> reference_loss(problem, θ),
        (gradient, θ) -> copyto!(gradient, reference_gradient(problem, θ)),
        parameters, method, options,
    )
    return Optim.minimizer(result), Optim.f_trace(result)
end

@testset "reference of the flow" begin
    # S is linear in z: at its kinks, the order of the solver is reduced.
    taper = range(1.0, 0.6, n_points) .* data.area[1:1, :, :]
    function both(hidden, activation; rtol, atol, max_steps = 4096)
        stage = FlowStage(; hidden, activation, rtol, atol, max_steps)
        model = chain(flow_widths(stage), activation)
        reference = ReferenceFlow(;
            model, data.inflow, area = taper, target = data.flow, z, rtol, atol,
        )
        parameters = glorot(flow_widths(stage), MersenneTwister(2))
        return reference, FlowProblem(copy(data.inflow), taper, data.flow, z, stage), parameters
    end
    # At the paper's tolerances, both controllers choose other steps.
    reference, fast, parameters = both([8, 8, 8, 8], "tanh"; rtol = 1e-3, atol = 1e-6)
    solution = reference_solution(reference, parameters)
    @test solve_flow(parameters, data.inflow, taper, z, fast.stage) ≈ solution rtol = 1e-3
    for (hidden, activation) in (([3], "tanh"), ([3, 2], "gelu"))
        reference, fast, parameters = both(hidden, activation; rtol = 1e-11, atol = 1e-13)
        solution = reference_solution(reference, parameters)
        @test solve_flow(parameters, data.inflow, taper, z, fast.stage) ≈ solution rtol = 1e-9
        gradient = similar(parameters)
        loss = value_and_gradient!(gradient, fast, parameters)
        @test loss ≈ reference_loss(reference, parameters) rtol = 1e-9
        @test gradient ≈ reference_gradient(reference, parameters) rtol = 1e-7
    end
    reference, fast, parameters = both([2], "tanh"; rtol = 1e-11, atol = 1e-13)
    result = fit(fast, parameters, Optimizer(), 5)
    fitted, losses = reference_fit(reference, parameters, Optimizer(), 5)
    @test result.losses ≈ losses rtol = 1e-8
    @test result.parameters ≈ fitted rtol = 1e-6
end
