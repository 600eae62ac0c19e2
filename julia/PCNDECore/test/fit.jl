struct Quartic <: Objective
    center::Vector{Float64}
end

PCNDECore.value!(q::Quartic, x) =
    x[1] > 3 ? NaN : sum(abs2, (x .- q.center) .^ 2) + sum(abs2, x)

function PCNDECore.value_and_gradient!(g, q::Quartic, x)
    g .= 4 .* (x .- q.center) .^ 3 .+ 2 .* x
    return value!(q, x)
end

"""
Infinite loss except where its gradient is evaluated.
"""
struct Wall <: Objective end

PCNDECore.value!(::Wall, x) = Inf
PCNDECore.value_and_gradient!(g, ::Wall, x) = (g .= 2 .* x; sum(abs2, x))

"""
Minimize by Optim's dense BFGS with the same settings.
"""
function dense_fit(objective, start, settings, iterations)
    g!(g, x) = (value_and_gradient!(g, objective, x); nothing)
    method = Optim.BFGS(;
        linesearch = BackTracking(order = 3),
        initial_stepnorm = settings.initial_step_norm,
    )
    options = Optim.Options(; iterations, store_trace = true)
    result = Optim.optimize(x -> value!(objective, x), g!, start, method, options)
    return Optim.minimizer(result), Optim.f_trace(result)
end

@testset "fit" begin
    @testset "the sum of outer products equals Optim's dense matrix" begin
        widths = [4 * n_points, 2, 2, n_points]
        network = TemporalPressure(
            data.flow, data.area, data.area_undeformed, 0.8 .+ 0.1 .* data.flow,
            Physics(), TemporalPressureStage(),
        )
        quartic = Quartic(collect(1.0:6))
        for (objective, start, iterations) in (
            (quartic, fill(0.5, 6), 25), (network, glorot(widths, MersenneTwister(1)), 40),
        )
            result = fit(objective, start, Optimizer(), iterations)
            parameters, losses = dense_fit(objective, start, Optimizer(), iterations)
            @test result.losses ≈ losses rtol = 1e-10
            @test result.parameters ≈ parameters rtol = 1e-10
            @test result.losses[end] < result.losses[1]
            @test result.message == "all iterations done" && !result.converged
        end
        # Step sizes of the flow amplify round-off: see the tests of the flow.
        stage = FlowStage()
        start = glorot(flow_widths(stage), MersenneTwister(1))
        result = fit(flow_problem(stage), start, Optimizer(), 5)
        parameters, losses = dense_fit(flow_problem(stage), start, Optimizer(), 5)
        @test result.losses ≈ losses rtol = 1e-9
        @test result.parameters ≈ parameters rtol = 1e-9
    end
    @testset "matrix" begin
        rng = MersenneTwister(1)
        h, dense = InverseHessian(0.3, 4), Matrix(0.3I, 4, 4)
        for factor in (1.2, -0.7)
            a, b = randn(rng, 4), randn(rng, 4)
            mul!(h, a, b', factor, 1)
            dense .+= factor .* a .* b'
        end
        x = randn(rng, 4)
        @test Matrix(h) ≈ dense
        @test mul!(zeros(4), h, x) ≈ dense * x
        h .= InverseHessian(2.0, 4)
        @test Matrix(h) == 2I
    end
    @testset "failing line search" begin
        # The first step is a thousand times too long for one trial; the length of steepest
        # descent is not.
        settings = Optimizer(max_backtracks = 1, initial_step_norm = 1e3)
        result = fit(Quartic(fill(0.5, 2)), [0.3, 0.4], settings, 3)
        @test length(result.losses) == 4 && issorted(result.losses; rev = true)
        @test result.message == "all iterations done" && !result.converged
        stuck = fit(Wall(), [1.0, 2.0], Optimizer(), 3)
        @test stuck.losses == [5.0] && stuck.parameters == [1, 2]
        @test stuck.message == "line search found no lower loss" && !stuck.converged
    end
    @testset "end of a fit" begin
        converged = fit(Quartic(zeros(2)), [1.0, 2.0], Optimizer(), 500)
        @test converged.converged && converged.message in ("gradient tolerance", "no change")
        # The first trial steps are not finite: the line search shortens them.
        far = Optimizer(initial_step_norm = 1e6)
        @test fit(Quartic(fill(-50.0, 2)), [2.9, 0.0], far, 10).losses[end] < 1e7
        seen = Tuple{Int, Float64}[]
        result =
            fit(Quartic(ones(3)), zeros(3), Optimizer(), 4, (k, loss) -> push!(seen, (k, loss)))
        @test first.(seen) == 1:4 && last.(seen) == result.losses[2:end]
        stop(k, _) = k == 2 && error("enough")
        @test_throws ErrorException("enough") fit(
            Quartic(ones(3)),
            zeros(3),
            Optimizer(),
            9,
            stop,
        )
        @test_throws SolveError fit(Quartic(ones(3)), [4.0, 0, 0], Optimizer(), 9)
    end
end
