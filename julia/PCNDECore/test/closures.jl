using PCNDECore:
    ClosureConfig, LossDensities, CorrectionClosure, Harmonics, Spectra, analyze!, closure,
    displacement, hidden_share!, jet_area, predict_closures!, pressure_drop!, solve_banded!,
    synthesize!, time_derivative

const outlet, losses = [1e5, 0.0, 0.0, 5e3], [1.2, 1.1, 0.9, 0.12]
const wall = [1e6, 0.45, 0.2, 1.0, 2e3]
const correction = [1.3; 0.8; 1e6; 1.0; randn(MersenneTwister(5), 17)]
const with_hidden = ClosureConfig(correction = CorrectionClosure(hidden = [4]))
function predicted(
    θ = correction;
    cases = 1:n_cases, config = with_hidden, law = outlet, tube = wall, period = 1.0,
)
    results = ntuple(_ -> Array{Float64}(undef, n_points, n_times, length(cases)), 3)
    inputs = data.inflow[:, cases], data.area_undeformed[:, cases]
    parameters, shift = (law, losses, tube, θ), zeros(length(cases))
    predict_closures!(results..., parameters, shift, inputs..., z, period, config)
    return results
end

@testset "harmonics" begin
    for n in (20, 21)
        t, period = (0:(n - 1)) ./ n, 0.8
        harmonics = Harmonics(n, period)
        signal = 2 .+ cos.(2π .* t) .- 3 .* sin.(6π .* t)
        spectra = Spectra(Float64, harmonics, 2)
        spectra.signals .= [signal reverse(signal)]
        analyze!(spectra, harmonics)
        spectrum = complex.(spectra.real[:, 1], spectra.imaginary[:, 1])
        @test spectrum[[1, 2, 4]] ≈ [2, 1, 3im] && norm(spectrum[5:end]) < 1e-12
        spectra.signals .= 0
        synthesize!(spectra, harmonics)
        @test spectra.signals ≈ [signal reverse(signal)]
        slope = (-2π .* sin.(2π .* t) .- 18π .* cos.(6π .* t)) ./ period
        @test vec(time_derivative(harmonics, permutedims(signal))) ≈ slope
    end
end

@testset "wall" begin
    bands, right = [4.0 5.0 6.0; 1.0 2.0 0.0], [1.0 2.0; 3.0 4.0; 5.0 6.0]
    dense = [4.0 1.0 0.0; 1.0 5.0 2.0; 0.0 2.0 6.0]
    @test dense * solve_banded!(copy(bands), copy(right)) ≈ right
    loads = [1e4 .* sin.(z) 2e4 .* cos.(z)]
    moved = displacement(wall, loads, data.area_undeformed[:, 3], z, "membrane")
    @test iszero(moved[[1, end], :])
    mirrored = displacement(
        wall, reverse(loads; dims = 1), reverse(data.area_undeformed[:, 3]), z, "membrane",
    )
    @test reverse(mirrored; dims = 1) ≈ moved
    # A straight vessel under a uniform load, without transverse shear.
    far = collect(range(0.0, 40.0, 401))
    long = displacement(
        [1e6, 0.0, 1e-4, 1.0, 0.0],
        fill(1e4, 401, 1),
        fill(π, 401),
        far,
        "membrane",
    )
    @test long[201] ≈ 1e4 / 1e6 rtol = 1e-6
    @test displacement([2e6, 1.0, 0.0], loads, fill(π, n_points), z, "local") ≈ loads ./ 2e6
end

@testset "losses" begin
    straight = LossDensities(losses, fill(0.125, n_points), z, Physics())
    @test iszero(straight.jet) && iszero(straight.jet_back)
    steady, none = ones(n_points, 1), zeros(n_points, 1)
    poiseuille = 1.2 * 8π * 0.04 / 0.125^2
    @test pressure_drop!(similar(none), straight, steady, none, z) ≈ poiseuille .* (4 .- z)
    s_u = data.area_undeformed[:, 3]
    jet = jet_area(s_u, diff(z), 0.1)
    @test all(jet .<= s_u .* (1 + 1e-12)) && jet[1:11] == s_u[1:11] && any(jet .< 0.99 .* s_u)
    @test jet_area(s_u, diff(z), 1e3) == s_u
end

@testset "correction" begin
    u, y = randn(MersenneTwister(1), 2, 9) |> eachrow .|> collect
    g = hidden_share!(zeros(9), correction, u .* 1e6, y, 0.0, [4])
    @test all(0 .< g .< 0.8)
    weights, bias = reshape(correction[5:12], 4, 2), correction[13:16]
    by_hand = [
        0.8 / (
            1 + exp(
                -(correction[17:20]' * tanh.(weights * [u[k], y[k]] .+ bias) + correction[21]),
            )
        )
        for k in 1:9
    ]
    @test g ≈ by_hand
end

@testset "all coupled" begin
    flow, area, pressure = predicted()
    @test flow[1, :, :] == data.inflow
    # Continuity: inflow minus outflow is κ·(1 − g) times the rate of the volume.
    passive, area_0, pressure_0 = predicted([1.3; 0.0; 1e6; 1.0; zeros(17)])
    @test pressure_0[end, :, :] ≈ 1e5 .* passive[end, :, :] .+ 5e3
    volume = PCNDECore.cumulative_integral.(eachslice(area_0; dims = (2, 3)), Ref(z))
    harmonics = Harmonics(n_times, 1.0)
    for n in 1:n_cases
        stored = permutedims(last.(volume[:, n]))
        lost = passive[1, :, n] .- passive[end, :, n]
        @test lost ≈ 1.3 .* vec(time_derivative(harmonics, stored)) rtol = 0.05
    end
    @test maximum(abs, flow .- passive) > 1e-3
    @test all(predicted(cases = 2:2) .== map(a -> a[:, :, 2:2], (flow, area, pressure)))
    # Cached data of the last prediction is not used for another model.
    @test maximum(abs, predicted(tube = [2e6; wall[2:end]])[2] .- area) > 1e-4
    @test maximum(abs, predicted(period = 0.5)[1] .- flow) > 1e-3
    @test predicted() == (flow, area, pressure)
    # Outlets with and without a dependence on frequency are computed in two ways.
    for compliance in (0.0, 1e-17)
        same = predicted(law = [4e4, 6e4, compliance, 5e3])
        @test all(isapprox.(same, (flow, area, pressure); rtol = 1e-11))
    end
    delayed = predicted(law = [4e4, 6e4, 1e-6, 5e3])
    @test maximum(abs, delayed[1] .- flow) > 1e-3
    few = ClosureConfig(correction = CorrectionClosure(hidden = [4], passes = 1))
    @test_throws SolveError predicted(config = few)
end

@testset "Jacobians are derivatives" begin
    flow, _, pressure = predicted()
    s_u = data.area_undeformed
    local_law = ClosureConfig(wall = PCNDECore.WallClosure(law = "local"))
    coupled = (outlet, losses, wall, data.inflow, s_u, [5.0, 20.0])
    for (name, θ, inputs, config) in (
        ("losses", losses, (flow, s_u), with_hidden),
        ("area", wall, (pressure, s_u), with_hidden),
        ("area", [1e6, 0.5, 2e3], (pressure, s_u), local_law),
        ("flow", correction, coupled, with_hidden),
    )
        at(x) = closure(name, x, inputs, z, 1.0, config)
        value, jacobian = at(θ)
        @test size(jacobian) == (length(θ), size(value)...)
        for k in eachindex(θ)
            step = [i == k ? 1e-5 * max(abs(θ[k]), 0.1) : 0.0 for i in eachindex(θ)]
            slope = (at(θ .+ step)[1] .- at(θ .- step)[1]) ./ 2step[k]
            result = selectdim(jacobian, 1, k)
            @test norm(result .- slope) < 1e-5 * norm(slope) + 1e-9 * norm(value) / step[k]
        end
    end
    @test closure("flow", correction, coupled, z, 1.0, with_hidden)[1] ≈ flow[[6, 21], :, :]
    @test_throws ArgumentError closure("heat", losses, (flow, s_u), z, 1.0, with_hidden)
end
