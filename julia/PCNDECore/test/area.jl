@testset "intermediate area" begin
    stage, period = IntermediateAreaStage(), 0.8
    rng = MersenneTwister(1)
    a, b = 0.5 .+ rand(rng, n_points), 0.01 .* randn(rng, n_points)
    parameters = [a; b]
    solved =
        solve_intermediate_area(parameters, data.flow, data.area_undeformed, period, z, stage)
    @test size(solved) == (n_points, stage.cycles * n_times, n_cases)

    # The trapezoidal rule, to round-off.
    spacing = period / n_times
    rate(k, i, n) =
        b[i] - a[i] * PCNDECore.derivative_along_z(data.flow, z)[i, mod1(k, n_times), n]
    for n in 1:n_cases, i in (1, 7, n_points)
        s = data.area_undeformed[i, n]
        for k in 1:(stage.cycles * n_times - 1)
            s += spacing * (rate(k, i, n) + rate(k + 1, i, n)) / 2
            @test solved[i, k + 1, n] ≈ s rtol = 1e-12
        end
    end

    problem =
        intermediate_area_problem(data.flow, data.area_undeformed, data.area, period, z, stage)
    last_cycle = solved[:, (end - n_times + 1):end, :]
    @test solve(problem, parameters) ≈ last_cycle rtol = 1e-12
    @test value!(problem, parameters) ≈ sum(abs2, last_cycle .- data.area) / length(data.area)
    check_gradient(problem, parameters; rtol = 1e-7)
end

@testset "Fourier area" begin
    # The integral of a signal that the series represents is exact.
    t = (0:(n_times - 1)) ./ n_times
    analysis, synthesis = PCNDECore.fourier_integral(n_times, FourierAreaStage(terms = 4))
    integral = (5 .+ cos.(2π .* t) .- 3 .* sin.(6π .* t))' * analysis * synthesis
    @test vec(integral) ≈ sin.(2π .* t) ./ 2π .+ cos.(6π .* t) ./ 2π atol = 1e-14
    rng = MersenneTwister(1)
    for stage in (
        FourierAreaStage(terms = 8),
        FourierAreaStage(terms = 8, sides = "one", frequency = "next"),
    )
        problem =
            fourier_area_problem(data.flow, data.area_undeformed, data.area, 0.8, z, stage)
        parameters = rand(rng, 2 * n_points)
        @test solve(problem, [ones(n_points); zeros(n_points)])[:, 1, :] ≈ data.area_undeformed
        @test value!(problem, parameters) ≈
              sum(abs2, solve(problem, parameters) .- data.area) / length(data.area)
        check_gradient(problem, parameters; rtol = 1e-7)
    end
end
