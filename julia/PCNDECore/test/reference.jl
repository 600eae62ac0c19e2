@testset "reference: solution, gradient and fit" begin
    # S is linear in z: at its kinks, the order of the solver is reduced.
    taper = range(1.0, 0.6, n_points) .* data.area[1:1, :, :]
    function both(hidden, activation; rtol, atol, max_steps = 4096)
        stage = FlowStage(; hidden, activation, rtol, atol, max_steps)
        problems = (
            type(copy(data.inflow), taper, data.flow, z, stage) for
            type in (ReferenceFlow, FlowProblem)
        )
        return problems..., glorot(flow_widths(stage), MersenneTwister(2))
    end
    reference, fast, parameters = both([8, 8, 8, 8], "tanh"; rtol = 1e-3, atol = 1e-6)
    solution = solve(reference, parameters)
    @test solve_flow(parameters, data.inflow, taper, z, fast.stage) ≈ solution rtol = 1e-6
    for (hidden, activation) in (([3], "tanh"), ([3, 2], "gelu"))
        reference, fast, parameters = both(hidden, activation; rtol = 1e-11, atol = 1e-13)
        solution = solve(reference, parameters)
        @test solve_flow(parameters, data.inflow, taper, z, fast.stage) ≈ solution rtol = 1e-9
        for weight in (ones(n_cases), range(0.5, 2.0, n_cases))
            gradient, expected = similar(parameters), similar(parameters)
            loss = value_and_gradient!(gradient, set_weight!(fast, weight), parameters)
            set_weight!(reference, weight)
            @test loss ≈ value_and_gradient!(expected, reference, parameters) rtol = 1e-9
            @test gradient ≈ expected rtol = 1e-7
        end
    end
    reference, fast, parameters = both([2], "tanh"; rtol = 1e-11, atol = 1e-13)
    result, expected = (fit(p, parameters, Optimizer(), 5) for p in (fast, reference))
    @test result.losses ≈ expected.losses rtol = 1e-8
    @test result.parameters ≈ expected.parameters rtol = 1e-6
    @test expected.message == result.message == "all iterations done"
end

@testset "reference: any Lux model" begin
    stage = FlowStage(steps = 5)
    # A skip connection and a layer without bias, which the kernels do not have.
    model = Lux.Chain(
        Lux.Dense(2 * n_times => 4, tanh),
        Lux.SkipConnection(Lux.Dense(4 => 4, tanh; use_bias = false), +),
        Lux.Dense(4 => n_times),
    )
    problem = ReferenceFlow(model, data.inflow, data.area, data.flow, z, stage)
    count = Lux.parameterlength(model)
    check_gradient(problem, 0.1 .* randn(MersenneTwister(4), count); rtol = 1e-6)
    # The model of zeros has ∂Q/∂z = 0.
    @test solve(problem, zeros(count)) == repeat(reshape(data.inflow, 1, n_times, :), n_points)
end

@testset "reference: failures" begin
    stage = FlowStage(hidden = [2], max_steps = 20)
    problem = ReferenceFlow(data.inflow, data.area, data.flow, z, stage)
    broken = fill(NaN, length(glorot(flow_widths(stage), MersenneTwister(1))))
    @test value!(problem, broken) == Inf
    @test_throws SolveError solve(problem, broken)
    @test_throws SolveError fit(problem, broken, Optimizer(), 2)
    with_terms = FlowStage(terms = ["friction"])
    @test_throws ArgumentError ReferenceFlow(data.inflow, data.area, data.flow, z, with_terms)
end

@testset "reference: SciMLSensitivity" begin
    stage = FlowStage(hidden = [2], rtol = 1e-8, atol = 1e-10, max_steps = 4096)
    taper = range(1.0, 0.6, n_points) .* data.area[1:1, :, :]
    problem = ReferenceFlow(data.inflow, taper, data.flow, z, stage)
    parameters = glorot(flow_widths(stage), MersenneTwister(2))
    if any(name -> Base.find_package(name) === nothing, ("SciMLSensitivity", "Zygote"))
        @info "SciMLSensitivity or Zygote is not installed: adjoint_gradient is not tested"
        @test_throws "Pkg.add" adjoint_gradient(problem, parameters)
    else
        @eval using SciMLSensitivity, Zygote
        gradient = @invokelatest adjoint_gradient(problem, parameters)
        @test gradient ≈ forward_gradient(problem, parameters) rtol = 1e-4
    end
end

@testset "self-check" begin
    @test PCNDECore.self_check() === nothing
    stages = PCNDECore.TIGHT_STAGE, PCNDECore.LOOSE_STAGE
    (problem, parameters), (loose, _) =
        (PCNDECore.self_check_problem(ReferenceFlow, stage) for stage in stages)
    losses = fit(problem, parameters, Optimizer(), 4).losses
    @test PCNDECore.CHECKED_LOSSES ≈ losses rtol = 1e-10
    @test issorted(losses; rev = true) && losses[end] < losses[1] / 2
    ends = [0.0]
    record = SciMLBase.DiscreteCallback(
        (_, position, _) -> (push!(ends, position); false), identity,
    )
    reference_solution(loose, parameters; callback = record)
    @test PCNDECore.CHECKED_STEPS ≈ diff(ends) rtol = 1e-8
end
