"""
Integrate the flow in time as the paper states it, with Lux, for one case.
"""
function temporal_flow_by_lux(parameters, stage, inflow, initial_flow)
    model = chain(
        [n_points + stage.time_input; stage.hidden; n_points], stage.activation,
    )
    ps, st = lux_parameters(model, parameters)
    f(q, t) = first(Lux.apply(model, stage.time_input ? [q; t] : q, ps, st))
    flow, q = zeros(n_points, n_times), copy(initial_flow)
    flow[:, 1] .= q
    h = 1 / (n_times * stage.steps)
    for number in 1:((n_times - 1) * stage.steps)
        t = (number - 1) * h
        k1 = f(q, t)
        k2 = f(q .+ h / 2 .* k1, t + h / 2)
        k3 = f(q .+ h / 2 .* k2, t + h / 2)
        k4 = f(q .+ h .* k3, t + h)
        q = q .+ h / 6 .* (k1 .+ 2 .* k2 .+ 2 .* k3 .+ k4)
        time_point, substep = fldmod(number, stage.steps)
        fraction = substep / stage.steps
        q[1] = (1 - fraction) * inflow[time_point + 1]
        fraction > 0 && (q[1] += fraction * inflow[time_point + 2])
        substep == 0 && (flow[:, time_point + 1] .= q)
    end
    return flow
end

@testset "flow in time" begin
    initial_flow = data.flow[:, 1, :]
    initial_flow[1, :] .= data.inflow[1, :]
    for stage in (
        TemporalFlowStage(),
        TemporalFlowStage(hidden = [5, 4], activation = "gelu", time_input = true, steps = 3),
    )
        widths = [n_points + stage.time_input; stage.hidden; n_points]
        parameters = glorot(widths, MersenneTwister(1))
        flow = solve_temporal_flow(parameters, data.inflow, initial_flow, 1.0, stage)
        @test flow[1, :, :] == data.inflow
        for case in 1:n_cases
            separate = temporal_flow_by_lux(
                parameters, stage, data.inflow[:, case], initial_flow[:, case],
            )
            @test flow[:, :, case] ≈ separate rtol = 1e-12
        end
        problem = TemporalFlow(data.inflow, initial_flow, data.flow, 1.0, stage)
        @test value!(problem, parameters) ≈ sum(abs2, flow .- data.flow) / length(flow)
        check_gradient(problem, parameters; rtol = 1e-6)
    end
    stage = TemporalFlowStage()
    problem = TemporalFlow(data.inflow, initial_flow, data.flow, 1.0, stage)
    broken = fill(NaN, length(problem.network))
    @test value!(problem, broken) == Inf
    @test value_and_gradient!(similar(broken), problem, broken) == Inf
    @test_throws SolveError solve_temporal_flow(
        broken, data.inflow, initial_flow, 1.0, stage,
    )
end
