# Workload of the precompilation: every stage runs once on small arrays, through the functions
# that Python calls and with the types that it passes, so that the first real call need not
# be compiled. The networks have as many layers as the paper's.

@setup_workload begin
    n_points, n_times, n_cases = 7, 24, 2
    z = collect(range(0.0, 4.0, n_points))
    inflow = [1 + 0.1 * sin(2π * t / n_times + n) for t in 1:n_times, n in 1:n_cases]
    flow = repeat(reshape(inflow, 1, n_times, n_cases), n_points)
    area_undeformed = fill(0.12, n_points, n_cases)
    area_undeformed[4, :] .= 0.06
    area = repeat(reshape(area_undeformed, n_points, 1, n_cases), 1, n_times)
    parameters = (
        fill(0.01, length(Network(chain([2 * n_times, 2, 2, 2, 2, n_times], "tanh")))),
        ones(2 * n_points),
        ones(2 * n_points),
        fill(0.01, length(Network(chain([4 * n_points, 2, 2, n_points], "tanh")))),
        ones(2 + 2 * n_times),
        fill(0.01, length(Network(chain([n_points, 2, 2, 2, 2, n_points], "tanh")))),
    )
    inputs = (
        "flow" => (inflow, area),
        "intermediate_area" => (flow, area_undeformed),
        "fourier_area" => (flow, area_undeformed),
        "temporal_pressure" => (flow, area, area_undeformed),
        "spatial_pressure" => (flow, flow, area_undeformed),
        "temporal_flow" => (inflow, flow[:, 1, :]),
    )
    closures = (
        repeat([1e5 0.0; 0.0 0.0], n_times ÷ 2 + 1, 1, 1),
        [1.0, 1.0, 1.0, 1.3, 1.3, 1.2, 1.2, 0.01, 3.5, 0.7],
        [1e6, 0.45, 0.2, 1.0, 0.0], [1.0, 0.1, 1e6, 1.0, 0.0, 0.0, -4.0],
        fill(0.1, N_SHEAR),
    )
    pressure, points = 1e5 .* flow, [1.0, 6.0]
    numbers_of(arrays) = Iterators.flatten((Int(pointer(a)), size(a)...) for a in arrays)
    @compile_workload begin
        for a in (z, inflow, area)
            GC.@preserve a copy_python_array(Int(pointer(a)), size(a)...)
        end
        for activation in keys(ACTIVATIONS), n_layers in (3, 5)
            Network(chain(fill(2, n_layers + 1), activation))
        end
        chosen = config(
            """
            flow.hidden = [2, 2, 2, 2]
            flow.rtol = 0.001
            temporal_pressure.hidden = [2, 2]
            temporal_flow.hidden = [2, 2, 2, 2]
            """,
        )
        for (θ, (stage, arrays)) in zip(parameters, inputs)
            solve(stage, θ, arrays, z, 1.0, chosen)
            loss_and_gradient(stage, θ, arrays, flow, z, 1.0, chosen)
            losses(stage, reshape(θ, :, 1), arrays, flow, z, 1.0, chosen)
            fit(stage, θ, arrays, flow, z, 1.0, chosen, 2, (_, _) -> nothing)
        end
        for θ in (parameters[1:5], (parameters[1:3]..., Float64[], Float64[]))
            predict(θ, inflow, area_undeformed, z, 1.0, 2, chosen)
        end
        with_terms = config("flow.terms = [\"friction\"]\nflow.hidden = [2, 2, 2, 2]")
        θ = first(parameters)
        solve("flow", θ, (inflow, area), z, 1.0, with_terms)
        fit("flow", θ, (inflow, area), flow, z, 1.0, with_terms, 2, (_, _) -> nothing)
        losses("flow", reshape(θ, :, 1), (inflow, area), flow, z, 1.0, with_terms)
        store_objective("flow", (inflow, area), flow, ones(size(flow, 3)), z, 1.0, Config())
        chosen = closure_config("wall.law = \"membrane\"\ncorrection.hidden = []")
        outward = Matrix(1.0I, n_points, n_points)
        at_points = similar(flow, length(points), size(inflow)...)
        coupled = closures[1:3]..., inflow, area_undeformed, outward, points
        for (name, value, θ, given...) in (
            ("losses", flow, closures[2], flow, flow, area_undeformed),
            ("area", flow, closures[3], pressure, area_undeformed),
            ("wall_shear_stress", flow, closures[5], closures[2], flow, flow, area_undeformed),
            ("flow", at_points, closures[4], coupled...),
        )
            found = similar(value), similar(value, length(θ), size(value)...)
            arrays = (found..., θ, given..., z)
            GC.@preserve arrays closure!(name, chosen, 1.0, numbers_of(arrays)...)
        end
        results = ntuple(_ -> similar(flow), 4)
        arrays =
            results..., closures..., zeros(n_cases), inflow, area_undeformed, z, outward
        GC.@preserve arrays predict_closures(chosen, 1.0, numbers_of(arrays)...)
        call("versions")
        self_check()
        clear!(STATE)
    end
end
