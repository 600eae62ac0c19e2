"""
Solve the momentum equation as the paper states it: the state is Q, Lux evaluates the network,
and OrdinaryDiffEq controls the steps and interpolates. `extra_terms`, a function of Q, S and
∂S/∂z, is added to the network.
"""
function flow_by_library(
    parameters, stage, columns; inflow = data.inflow, extra_terms = (q, s, slope) -> zero(q),
)
    model = chain(flow_widths(stage), stage.activation)
    ps, st = lux_parameters(model, parameters)
    area = data.area[:, :, columns]
    area_slope = PCNDECore.derivative_along_z(area, z)
    function f!(dq, q, _, position)
        i, share = PCNDECore.interval(z, position)
        here(a) = (1 - share) .* a[i, :, :] .+ share .* a[i + 1, :, :]
        s = here(area)
        dq .= first(Lux.apply(model, [q; s], ps, st)) .+ extra_terms(q, s, here(area_slope))
        return nothing
    end
    equation = ODEProblem(f!, inflow[:, columns], (z[1], z[end]))
    solution = SciMLBase.solve(
        equation, Tsit5();
        dt = PCNDECore.initial_step(stage, z), adaptive = isnothing(stage.steps),
        abstol = stage.atol, reltol = stage.rtol, controller = StepControl(), saveat = z,
    )
    return permutedims(stack(solution.u), (3, 1, 2)), solution.stats
end

const tight = (rtol = 1e-11, atol = 1e-13, max_steps = 4096)

@testset "flow" begin
    for (stage, rtol) in (
        # The error estimate of a step is a small difference of large numbers: its round-off
        # changes the step size, and with it the error where S has kinks.
        FlowStage() => 1e-7,
        FlowStage(; rtol = 1e-12, atol = 1e-14, max_steps = 16384) => 1e-8,
        FlowStage(hidden = [5, 7], activation = "gelu", first_step = 1.7) => 1e-10,
        # More than `max_steps`, which does not matter here.
        FlowStage(steps = 7, max_steps = 5) => 1e-12,
    )
        parameters = glorot(flow_widths(stage), MersenneTwister(1))
        problem = flow_problem(stage)
        @test integrate!(problem, parameters)
        joint, stats = flow_by_library(parameters, stage, 1:n_cases)
        flow =
            permutedims(reshape(residual!(problem), n_times, n_cases, :), (3, 1, 2)) .+
            data.flow
        @test abs(problem.trajectory.count - stats.naccept) <= 0.1 * stats.naccept
        @test flow ≈ joint rtol = rtol
        @test value!(problem, parameters) ≈ sum(abs2, joint .- data.flow) / length(flow)

        # The result of a case does not depend on the other cases.
        separate = solve_flow(parameters, data.inflow, data.area, z, stage)
        for case in 1:n_cases
            one = case:case
            @test separate[:, :, one] ≈ flow_by_library(parameters, stage, one)[1] rtol = rtol
            @test separate[:, :, one] ==
                  solve_flow(parameters, data.inflow[:, one], data.area[:, :, one], z, stage)
        end
    end
    # S is linear in z here. With kinks, a change of the parameters would move steps across
    # kinks, which finite differences would include.
    taper = range(1.0, 0.6, n_points) .* data.area[1:1, :, :]
    for stage in (
        FlowStage(; tight...),
        FlowStage(; tight..., hidden = [3], activation = "gelu", loss = "sum"),
    )
        problem = FlowProblem(copy(data.inflow), taper, data.flow, z, stage)
        parameters = glorot(flow_widths(stage), MersenneTwister(2))
        check_gradient(problem, parameters; rtol = 1e-6)
    end
    # Equal steps do not depend on the parameters.
    stage = FlowStage(steps = 9)
    check_gradient(
        flow_problem(stage),
        glorot(flow_widths(stage), MersenneTwister(2));
        rtol = 1e-6,
    )
end

@testset "flow: weights" begin
    weight = range(0.5, 2.0, n_cases)
    for loss in ("mean", "sum")
        stage = FlowStage(; steps = 9, loss)
        parameters = glorot(flow_widths(stage), MersenneTwister(3))
        problem = set_weight!(flow_problem(stage), weight)
        squares = (solve_flow(parameters, data.inflow, data.area, z, stage) .- data.flow) .^ 2
        total = sum(weight .* vec(sum(squares; dims = (1, 2))))
        expected = loss == "sum" ? total : total / (n_times * n_points * sum(weight))
        @test value!(problem, parameters) ≈ expected rtol = 1e-12
        check_gradient(problem, parameters; rtol = 1e-6)
        # Equal weights restore the unweighted loss.
        set_weight!(problem, ones(n_cases))
        @test value!(problem, parameters) == value!(flow_problem(stage), parameters)
    end
    areas = (data.area_undeformed, data.area)
    other = fourier_area_problem(data.flow, areas..., 0.8, z, FourierAreaStage(terms = 8))
    @test set_weight!(other, ones(n_cases)) === other
    @test_throws ArgumentError set_weight!(other, weight)
end

@testset "flow: hot loop" begin
    stage = FlowStage()
    parameters = glorot(flow_widths(stage), MersenneTwister(1))
    problem = flow_problem(stage)
    gradient = similar(parameters)
    value_and_gradient!(gradient, problem, parameters)
    @test @inferred(value!(problem, parameters)) isa Float64
    @test @inferred(value_and_gradient!(gradient, problem, parameters)) isa Float64
    rate, u = problem.rate, problem.norm.state_before
    du = similar(u)
    allocated(f, du, u) = @allocated f(du, u, nothing, 1.3)
    allocated(rate, du, u)
    @test allocated(rate, du, u) == 0
    norm_allocated(f, u) = @allocated f(u, 0.0)
    norm_allocated(problem.norm, du)
    @test norm_allocated(problem.norm, du) == 0
    slope = PCNDECore.derivative_along_z(data.flow, z)
    area_rate = PCNDECore.AreaRate(ones(n_points), zeros(n_points), slope, 0.05)
    s = copy(data.area_undeformed)
    allocated(area_rate, similar(s), s)
    @test allocated(area_rate, similar(s), s) == 0
end

@testset "flow: divergence" begin
    stage = FlowStage(max_steps = 20)
    parameters = glorot(flow_widths(stage), MersenneTwister(1))
    problem = flow_problem(stage)
    for broken in (fill(NaN, length(parameters)), 1e200 .* parameters)
        @test value!(problem, broken) == Inf
        @test value_and_gradient!(similar(parameters), problem, broken) == Inf
        @test_throws SolveError solve_flow(broken, data.inflow, data.area, z, stage)
        @test_throws SolveError fit(problem, broken, Optimizer(), 3)
    end
    # A failed solve does not affect the next one.
    fresh = value!(flow_problem(stage), parameters)
    @test value!(problem, parameters) == fresh
end
