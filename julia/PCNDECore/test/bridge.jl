@testset "bridge" begin
    config = PCNDECore.config(
        "flow.hidden = [3, 3]\nflow.epochs = 7\nflow.rtol = 1e-06\nbatch_size = 12",
    )
    @test config.flow.hidden == [3, 3] && config.flow.rtol == 1e-6
    @test config.physics == Physics()
    address = Int(pointer(data.area))
    area = GC.@preserve data PCNDECore.copy_python_array(address, size(data.area)...)
    @test area == data.area && area !== data.area
    parameters = glorot(flow_widths(config.flow), MersenneTwister(1))
    inputs = (data.inflow, area)
    @test solve("flow", parameters, inputs, z, 1.0, config) ==
          solve_flow(parameters, data.inflow, data.area, z, config.flow)
    loss, gradient =
        PCNDECore.loss_and_gradient("flow", parameters, inputs, data.flow, z, 1.0, config)
    fitted, losses, converged, message =
        fit("flow", parameters, inputs, data.flow, z, 1.0, config, 2)
    @test losses[1] == loss && length(losses) == 3 && length(fitted) == length(gradient)
    @test_throws ArgumentError fit("heat", parameters, inputs, data.flow, z, 1.0, config, 2)
    @test contains(PCNDECore.versions(), "julia = \"$VERSION\"")
end

@testset "closures in place" begin
    rate = zero(data.flow)
    inputs = (data.flow, rate, data.area_undeformed)
    expected = PCNDECore.closure("losses", losses, inputs, z, 1.0, with_hidden)
    found = map(similar, expected)
    arrays = found..., losses, inputs..., z
    GC.@preserve arrays begin
        numbers = Iterators.flatten((Int(pointer(a)), size(a)...) for a in arrays)
        PCNDECore.closure!("losses", with_hidden, 1.0, numbers...)
    end
    @test found == expected
end

@testset "predictions in place" begin
    vectors = outlet, losses, wall, correction, shear
    given = zeros(n_cases), data.inflow, data.area_undeformed, z, here
    expected, result = (Tuple(zeros(n_points, n_times, n_cases) for _ in 1:4) for _ in 1:2)
    PCNDECore.predict_closures!(expected..., vectors, given..., 1.0, with_hidden)
    arrays = result..., vectors..., given...
    GC.@preserve arrays begin
        numbers = Iterators.flatten((Int(pointer(a)), size(a)...) for a in arrays)
        PCNDECore.predict_closures(with_hidden, 1.0, numbers...)
    end
    @test result == expected && all(field -> all(!iszero, field), result)
end
