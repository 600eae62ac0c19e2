@testset "pressure" begin
    target = 0.8 .+ 0.1 .* data.flow
    rng = MersenneTwister(1)
    for stage in (
        TemporalPressureStage(), TemporalPressureStage(hidden = [3], activation = "gelu"),
        TemporalPressureStage(pressure_drop_input = "dyn"),
    )
        problem = TemporalPressure(
            data.flow, data.area, data.area_undeformed, target, Physics(), stage,
        )
        parameters = 0.1 .* glorot([4 * n_points; stage.hidden; n_points], rng)
        check_gradient(problem, parameters; rtol = 1e-4, step = 1e-6)
    end
    for form in ("continuous", "printed")
        problem = SpatialPressure(
            target, data.flow, data.area_undeformed, target, z, Physics(),
            SpatialPressureStage(; form),
        )
        parameters = [0.01; 0.1; 0.01 .* randn(rng, n_times); 0.5 .+ rand(rng, n_times)]
        p = solve(problem, parameters)
        third = z .<= 4 / 3
        @test all(≈(p[1, 1, 1]), p[third, 1, 1])
        @test value!(problem, parameters) ≈ sum(abs2, p .- target) / length(p)
        check_gradient(problem, parameters; rtol = 1e-6)
    end
end
