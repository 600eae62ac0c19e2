# Every stage is run once on small arrays when the package is precompiled, through the
# calls that Python makes, so that the first real call does not wait for the compiler.

@setup_workload begin
    n_points, n_times, n_cases = 7, 24, 2
    z = collect(range(0.0, 4.0, n_points))
    wave = [1 + 0.1 * sin(2π * t / n_times + n) for t in 1:n_times, n in 1:n_cases]
    flow = repeat(reshape(wave, 1, n_times, n_cases), n_points)
    area_undeformed = fill(0.12, n_points, n_cases)
    area_undeformed[4, :] .= 0.06
    area = repeat(reshape(area_undeformed, n_points, 1, n_cases), 1, n_times)
    @compile_workload begin
        settings = config(
            """
            flow.hidden = [2, 2]
            flow.rtol = 0.001
            temporal_pressure.hidden = [2, 2]
            temporal_pressure.activation = "tanh"
            """,
        )
        inputs = (
            "flow" => (wave, area),
            "intermediate_area" => (flow, area_undeformed),
            "fourier_area" => (flow, area_undeformed),
            "temporal_pressure" => (flow, area, area_undeformed),
            "spatial_pressure" => (flow, flow, area_undeformed),
        )
        for (stage, arrays) in inputs
            parameters = if stage == "flow"
                fill(0.01, length(Network(chain([2 * n_times, 2, 2, n_times], "tanh"))))
            elseif stage == "temporal_pressure"
                fill(0.01, length(Network(chain([4 * n_points, 2, 2, n_points], "tanh"))))
            elseif stage == "spatial_pressure"
                ones(2 + 2 * n_times)
            else
                ones(2 * n_points)
            end
            solve(stage, parameters, arrays, z, 1.0, settings)
            loss_and_gradient(stage, parameters, arrays, flow, z, 1.0, settings)
            fit(stage, parameters, arrays, flow, z, 1.0, settings, 2, (_, _) -> nothing)
        end
        versions()
    end
end
