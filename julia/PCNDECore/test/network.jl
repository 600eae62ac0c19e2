@testset "network: kernels equal Lux" begin
    for activation in keys(PCNDECore.ACTIVATIONS)
        widths = [7, 5, 4, 6]
        parameters = glorot(widths, MersenneTwister(1))
        model = chain(widths, activation)
        network = PCNDECore.load!(Network(model), parameters)
        @test length(network) == length(parameters)
        inputs = randn(MersenneTwister(2), 7, 9)
        expected, _ = Lux.apply(model, inputs, lux_parameters(model, parameters)...)
        activations = PCNDECore.Activations(widths[2:(end - 1)], 9)
        mul!(activations.before[1], network.matrices[1], [inputs; ones(1, 9)])
        PCNDECore.forward!(activations, network, 9)
        @test network.matrices[end] * activations.after[end] ≈ expected rtol = 1e-13
        σ = network.activation
        for x in (-1.3, -0.2, 0.4, 2.1)
            slope = (σ(x + 1e-6) - σ(x - 1e-6)) / 2e-6
            @test PCNDECore.derivative(σ, x, σ(x)) ≈ slope rtol = 1e-8 atol = 1e-9
        end
    end
    @test_throws DimensionMismatch PCNDECore.load!(Network(chain([2, 3, 2], "tanh")), zeros(3))
end
