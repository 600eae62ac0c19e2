"""
Solve the stages one after the other.
"""
function by_stages(parameters, period, passes, config)
    run(k, stage, inputs...) = solve(stage, parameters[k], inputs, z, period, config)
    start = data.area_undeformed
    flow, area = data.flow, repeat(reshape(start, n_points, 1, n_cases), 1, n_times)
    anchor = Dict("undeformed" => 1, "last_cycle" => 2 * n_times + 1)
    for _ in 1:passes
        flow = run(1, "flow", data.inflow, area)
        intermediate = run(2, "intermediate_area", flow, start)
        time_point = get(anchor, config.fourier_area.anchor, 3 * n_times)
        area = run(3, "fourier_area", flow, intermediate[:, time_point, :])
    end
    temporal = run(4, "temporal_pressure", flow, area, start)
    relative = run(5, "spatial_pressure", temporal, flow, start)
    return flow, area, relative .* config.physics.reference_pressure
end

@testset "predict equals the consecutive stages" begin
    rng = MersenneTwister(1)
    parameters = (
        glorot(flow_widths(FlowStage()), rng), 0.01 .* randn(rng, 2 * n_points),
        0.01 .* randn(rng, 2 * n_points),
        0.1 .* glorot([4 * n_points, 2, 2, n_points], rng),
        rand(rng, 2 + 2 * n_times),
    )
    run(cases, parameters, config) = PCNDECore.predict(
        parameters, data.inflow[:, cases], data.area_undeformed[:, cases], z, 0.8, 3, config,
    )
    for anchor in ("undeformed", "last_cycle", "last_time_point"),
        form in ("continuous", "printed"),
        # S has a kink at every point, where the error estimate of a step is too small: solves
        # whose adaptive steps differ by round-off differ by up to 100 times the tolerance.
        # With equal steps, only the round-off itself remains.
        (flow, rtol) in ((FlowStage(; tight...), 1e-8), (FlowStage(steps = 13), 1e-12))

        config = Config(;
            flow,
            fourier_area = FourierAreaStage(; anchor, terms = 8),
            spatial_pressure = SpatialPressureStage(; form),
        )
        result = run(1:n_cases, parameters, config)
        for (array, expected) in zip(result, by_stages(parameters, 0.8, 3, config))
            @test array ≈ expected rtol = rtol
        end
        # The result of a case does not depend on the other cases.
        @test all(run(2:2, parameters, config) .== map(a -> a[:, :, 2:2], result))
    end
    without = (parameters[1:3]..., Float64[], Float64[])
    result, expected = (run(1:n_cases, θ, Config()) for θ in (without, parameters))
    @test result[1:2] == expected[1:2] && result[3] === nothing
    broken = (fill(NaN, length(parameters[1])), parameters[2:5]...)
    @test_throws SolveError run(1:n_cases, broken, Config())
    @test size.(run(1:0, parameters, Config())) == ntuple(_ -> (n_points, n_times, 0), 3)
end

@testset "threaded batches" begin
    for n in (0, 1, 2, 7), batch_size in (1, 3, 7, 9)
        seen = zeros(Int, n)
        PCNDECore.threaded_batches(n, batch_size) do batches
            for batch in batches
                @test batch == first(batch):min(first(batch) + batch_size - 1, n)
                seen[batch] .+= 1
            end
        end
        @test all(==(1), seen)
    end
    @test_throws SolveError PCNDECore.threaded_batches(_ -> throw(SolveError("no")), 5)
end

@testset "streaming copy" begin
    source = randn(MersenneTwister(1), 60)
    # Every offset in a cache line, for both arrays, with and without complete lines between.
    for n in 0:25, at in 1:8, from in 1:8
        target = fill(NaN, 40)
        PCNDECore.streaming_copy!(
            view(target, at:(at + n - 1)),
            view(source, from:(from + n - 1)),
        )
        @test target[at:(at + n - 1)] == source[from:(from + n - 1)]
        @test count(isnan, target) == 40 - n
    end
    @test_throws DimensionMismatch PCNDECore.streaming_copy!(zeros(3), zeros(4))
end

@testset "thin matrix product" begin
    rng = MersenneTwister(3)
    for n in (5, 8, 9, 16, 21), n_columns in (1, 3, 4, 7, 20), n_sums in (1, 9)
        a, b, c = randn(rng, n, 12), randn(rng, 12, 25), fill(NaN, n, 22)
        @views PCNDECore.thin_matmul!(
            c[:, 2:(n_columns + 1)], a[:, 1:n_sums], b[3:(n_sums + 2), 5:(n_columns + 4)],
        )
        expected = a[:, 1:n_sums] * b[3:(n_sums + 2), 5:(n_columns + 4)]
        @test c[:, 2:(n_columns + 1)] ≈ expected rtol = 1e-13
        @test all(isnan, c[:, 1]) && all(isnan, c[:, (n_columns + 2):end])
    end
    for sizes in (((9, 4), (9, 3), (2, 4)), ((9, 4), (8, 3), (3, 4)), ((9, 4), (9, 3), (3, 5)))
        @test_throws DimensionMismatch PCNDECore.thin_matmul!(zeros.(sizes)...)
    end
end
