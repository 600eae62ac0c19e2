using PCNDECore:
    ClosureConfig, CorrectionClosure, Harmonics, LossCoefficients, Spectra, analyze!, closure,
    displacement, hidden_share!, jet_area, layer_rate, layer_thickness, predict_closures!,
    pressure_drop!, solve_banded!, spatial_modes, synthesize!, temporal_modes
using PCNDECore.ForwardDiff: derivative

"""
Real and imaginary parts of the response of a Windkessel.
"""
function windkessel(r1, r2, compliance, distal_pressure; period = 1.0)
    omega = 2π .* (0:(n_times ÷ 2)) ./ period
    impedance = r1 .+ r2 ./ (1 .+ im .* omega .* r2 .* compliance)
    source = [n_times * distal_pressure; zeros(n_times ÷ 2)]
    return reshape([reinterpret(Float64, impedance); reinterpret(Float64, complex(source))], :, 2, 1)
end

const outlet = windkessel(1e5, 0.0, 0.0, 5e3)
const losses = [1.2, 1.1, 0.9, 1.3, 1.25, 0.95, 1.15, 0.06, 2.0, 0.7]
const wall = [1e6, 0.45, 0.2, 1.0, 2e3]
const shear = [0.6, 0.1, 0.2, 0.3, 0.25, 0.15, 0.7, 1.4, 0.8]
const correction = [1.3; 0.8; 1e6; 1.0; randn(MersenneTwister(5), 17)]
const here = [Float64(i == j) for i in 1:n_points, j in 1:n_points]
const with_hidden = ClosureConfig(correction = CorrectionClosure(hidden = [4]))
function predicted(
    θ = correction;
    cases = 1:n_cases, config = with_hidden, law = outlet, tube = wall, period = 1.0,
)
    results = ntuple(_ -> Array{Float64}(undef, n_points, n_times, length(cases)), 4)
    inputs = data.inflow[:, cases], data.area_undeformed[:, cases]
    parameters, shift = (law, losses, tube, θ, shear), zeros(length(cases))
    predict_closures!(results..., parameters, shift, inputs..., z, here, period, config)
    return results
end

"""
∂f/∂t of a periodic signal, exact for its Fourier series.
"""
function time_derivative(harmonics, signal)
    spectra = Spectra(Float64, harmonics, 1)
    spectra.signals .= signal
    analyze!(spectra, harmonics)
    (; real, imaginary) = spectra
    # iω·(a + ib) = −ωb + iωa.
    real[:, :], imaginary[:, :] = .-harmonics.omega .* imaginary, harmonics.omega .* real
    synthesize!(spectra, harmonics)
    return vec(spectra.signals)
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
        @test time_derivative(harmonics, signal) ≈ slope
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

@testset "boundary layer and jet" begin
    rate(d) = layer_rate(d, 0.7, 0.3)[1]
    for d in (0.05, 0.4, 0.95)
        @test layer_rate(d, 0.7, 0.3)[2] ≈ derivative(rate, d)
    end
    s_u = data.area_undeformed[:, 3]
    @test layer_thickness(fill(0.125, n_points), z, 0.2) == ones(n_points)
    layer = layer_thickness(s_u, z, 0.2)
    @test layer[1] == 1 && all(0.02 .<= layer .<= 1)
    @test 9 <= argmin(layer) <= 11 && issorted(layer[13:end])
    # Inviscid flow thins the layer to its limit in a strong narrowing.
    @test minimum(layer_thickness(range(1, 0.01, n_points), z, 0.0)) == 0.02
    # The method is of second order.
    fine = collect(range(0.0, 4.0, 16 * (n_points - 1) + 1))
    area(points) = 0.125 .* (1 .- 0.6 .* exp.(-((points .- 2) ./ 0.4) .^ 2))
    errors = map((2, 4)) do factor
        points = fine[1:(16 ÷ factor):end]
        exact = layer_thickness(area(fine), fine, 0.2)[1:(16 ÷ factor):end]
        norm(layer_thickness(area(points), points, 0.2) .- exact) / sqrt(length(points))
    end
    @test errors[2] < errors[1] / 3 && errors[1] < 0.01
    jet = jet_area(s_u, z, 1.25, 0.06, 0.03)
    @test all(jet .<= s_u ./ 1.25 .* (1 + 1e-12))
    @test jet[1:11] == s_u[1:11] ./ 1.25 && any(jet .< 0.9 .* s_u ./ 1.25)
    @test jet_area(s_u, z, 1.25, 1e3, 0.0) == s_u ./ 1.25
end

"""
Area with a stenosis that narrows slowly and widens quickly.
"""
uneven(z) = [0.125 * (1 - 0.6 * exp(-((x - 2) / (x < 2 ? 0.9 : 0.3))^2)) for x in z]
const fine = collect(range(0.0, 4.0, 201))  # points that resolve it, as those of the engines

@testset "wall shear stress" begin
    s_u = uneven(z)
    flow = repeat([1.0 -1.0 0.5], n_points)
    given = reshape(flow, n_points, 3, 1), fill(4.0, n_points, 3, 1)
    function stress(area, (q, q_rate))
        inputs = losses, q, q_rate, reshape(area, :, 1)
        value, jacobian = closure("wall_shear_stress", shear, inputs, z, 1.0, ClosureConfig())
        none, _ = closure("wall_shear_stress", zero(shear), inputs, z, 1.0, ClosureConfig())
        @test value ≈ none .+ sum(shear .* jacobian; dims = 1)[1, :, :, :]
        return value[:, :, 1]
    end
    radius = sqrt(0.125 / π)
    expected = 0.16 .* flow ./ (π * radius^3) .+ 0.6 * 1.06 / (6π * radius) * 4
    @test stress(fill(0.125, n_points), given) ≈ expected
    there, back = stress(s_u, given), stress(reverse(s_u), map(.-, given))
    @test there ≈ -reverse(back; dims = 1) rtol = 1e-10
    given = losses, ones(201, 1, 1), fill(4.0, 201, 1, 1), reshape(uneven(fine), :, 1)
    value, _ = closure("wall_shear_stress", shear, given, fine, 1.0, ClosureConfig())
    @test maximum(value) > 1.5 * maximum(0.16 ./ sqrt.(uneven(fine) .^ 3 ./ π))
end

@testset "losses" begin
    steady, none = ones(n_points, 1), zeros(n_points, 1)
    drop(c, flow, rate = zero(flow); points = z) =
        pressure_drop!(similar(flow), c, flow, rate, points)
    straight = LossCoefficients(losses, fill(0.125, n_points), z, Physics())
    poiseuille = 1.2 * 8π * 0.04 / 0.125^2
    @test drop(straight, 2 .* steady) ≈ 2 * poiseuille .* (4 .- z)
    @test drop(straight, none, steady) ≈ 1.1 * 1.06 / 0.125 .* (4 .- z)
    @test iszero(straight.forward[:, 4])
    # An uneven stenosis and its mirror image.
    s_u = uneven(z)
    there, back = (LossCoefficients(losses, s, z, Physics()) for s in (s_u, reverse(s_u)))
    @test there.forward ≈ -reverse(back.back; dims = 1) rtol = 1e-10
    areas = uneven(fine), reverse(uneven(fine))
    forth, mirrored = (LossCoefficients(losses, s, fine, Physics()) for s in areas)
    for flow in (0.5, 8.0)
        q = fill(flow * forth.reference_flow, 201, 1)
        @test drop(forth, q; points = fine)[1] ≈ -drop(mirrored, -q; points = fine)[1]
        @test drop(forth, q; points = fine)[1] > 1.05 * drop(mirrored, q; points = fine)[1]
    end
    # The interpolation is exact at the flows that are computed.
    named = PCNDECore.LossParameters(losses)
    for ratio in PCNDECore.FLOW_RATIOS
        flow = ratio * there.reference_flow
        viscosity = π * 0.04 / 1.06 / flow
        layer = layer_thickness(s_u, z, 4 * 1.3 * viscosity)
        jet = jet_area(s_u, z, 1.25, 0.06, 2.0 * viscosity)
        pieces = PCNDECore.steady_drop(named, flow, layer, jet, s_u, z, Physics())
        @test drop(there, flow .* steady)[1] ≈ sum(pieces)
    end
    # Products of functions of z and t.
    share = z ./ 4
    in_z = spatial_modes(there, share, z)
    signals(t) = (2 * sin(t), 0.01 * cos(3t))
    for t in (0.7, 4.0)
        inflow = first(signals(t)), 2 * cos(t), -2 * sin(t)
        stored = last(signals(t)), -0.03 * sin(3t), -0.09 * cos(3t)
        modes, rates = temporal_modes(inflow, stored, there.reference_flow)
        flow, rate = (inflow[i] .- share .* stored[i] for i in 1:2)
        @test in_z * collect(modes) ≈ drop(there, flow, rate) rtol = 1e-3
        for (mode, rate) in enumerate(rates)
            function at(time)
                q, d = (
                    (f(time), derivative(f, time), zero(time)) for
                    f in (x -> signals(x)[1], x -> signals(x)[2])
                )
                return temporal_modes(q, d, there.reference_flow)[1][mode]
            end
            @test rate ≈ derivative(at, t) atol = 1e-12
        end
    end
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
    flow, area, pressure, stress = predicted()
    @test flow[1, :, :] == data.inflow
    # Continuity: inflow minus outflow is κ·(1 − g) times the rate of the volume.
    passive, area_0, pressure_0 = predicted([1.3; 0.0; 1e6; 1.0; zeros(17)])
    @test pressure_0[end, :, :] ≈ 1e5 .* passive[end, :, :] .+ 5e3
    volume = PCNDECore.cumulative_integral.(eachslice(area_0; dims = (2, 3)), Ref(z))
    harmonics = Harmonics(n_times, 1.0)
    for n in 1:n_cases
        stored = last.(volume[:, n])
        lost = passive[1, :, n] .- passive[end, :, n]
        @test lost ≈ 1.3 .* time_derivative(harmonics, stored) rtol = 0.05
    end
    @test maximum(abs, flow .- passive) > 1e-3
    @test all(predicted(cases = 2:2) .== map(a -> a[:, :, 2:2], (flow, area, pressure, stress)))
    # Cached data of the last prediction is not used for another model.
    @test maximum(abs, predicted(tube = [2e6; wall[2:end]])[2] .- area) > 1e-4
    @test maximum(abs, predicted(period = 0.5)[1] .- flow) > 1e-3
    @test predicted() == (flow, area, pressure, stress)
    # Outlets with and without a dependence on frequency are computed in two ways.
    for compliance in (0.0, 1e-17)
        same = predicted(law = windkessel(4e4, 6e4, compliance, 5e3))
        @test all(isapprox.(same, (flow, area, pressure, stress); rtol = 1e-11))
    end
    delayed = predicted(law = windkessel(4e4, 6e4, 1e-6, 5e3))
    @test maximum(abs, delayed[1] .- flow) > 1e-3
    # Each case has its own outlet, and the distal pressure varies in time.
    own = repeat(outlet, 1, 1, n_cases)
    own[3, 2, 2] = 1e3 * n_times  # first harmonic of p_d, with the amplitude 2e3
    varying = predicted(law = own)
    @test varying[3][:, :, 1] == pressure[:, :, 1]
    change = varying[3][end, :, 2] .- pressure[end, :, 2]
    change .-= 1e5 .* (varying[1][end, :, 2] .- flow[end, :, 2])
    @test change ≈ 2e3 .* cos.(2π .* (0:(n_times - 1)) ./ n_times) rtol = 1e-4
    few = ClosureConfig(correction = CorrectionClosure(hidden = [4], passes = 1))
    @test_throws SolveError predicted(config = few)
end

@testset "Jacobians are derivatives" begin
    flow, _, pressure = predicted()
    flow_rate = circshift(flow, (0, -1, 0)) .- flow
    s_u = data.area_undeformed
    local_law = ClosureConfig(wall = PCNDECore.WallClosure(law = "local"))
    coupled = (outlet, losses, wall, data.inflow, s_u, here, [5.0, 20.0])
    for (name, θ, inputs, config) in (
        ("losses", losses, (flow, flow_rate, s_u), with_hidden),
        ("losses", losses, (.-flow, flow_rate, s_u), with_hidden),
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
    @test_throws ArgumentError closure(
        "heat",
        losses,
        (flow, flow_rate, s_u),
        z,
        1.0,
        with_hidden,
    )
end
