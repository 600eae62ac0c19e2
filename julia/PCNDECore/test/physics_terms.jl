const all_terms = ["friction", "convection", "inertia"]
const term_sets = ([[term] for term in all_terms]..., all_terms)

# With the full amplitude, the inertia term creates a shock.
const small_inflow = 1 .+ 0.05 .* (data.inflow .- 1)

"""
Physics terms as the paper states them.
"""
function physics_terms_by_formula(terms, period)
    kinematic_viscosity = Physics().viscosity / Physics().density
    function extra_terms(q, s, slope)
        rise = (circshift(q, -1) .- circshift(q, 1)) ./ (2 * period / n_times)
        return ("friction" in terms) .* (-8π * kinematic_viscosity / (2 * (1 + 1 / 3))) .+
               ("convection" in terms) .* (q ./ s .* slope ./ 2) .-
               ("inertia" in terms) .* (s ./ q .* rise ./ (2 * (1 + 1 / 3)))
    end
    return extra_terms
end

with_terms(stage; inflow = small_inflow, area = data.area) = FlowProblem(
    copy(inflow), area, data.flow, z, stage, physics_terms(Config(; flow = stage), 0.8),
)

"""
Parameters whose network balances the friction: the inertia term is singular where Q = 0.
"""
function sustained_parameters(stage)
    parameters = 0.3 .* glorot(flow_widths(stage), MersenneTwister(1))
    parameters[(end - n_times + 1):end] .= 0.35
    return parameters
end

@testset "physics terms" begin
    for terms in term_sets
        # Round-off decides the steps at kinks of S and with them the error, here up to 5000 times
        # the solver's relative tolerance.
        for (solver, rtol) in (
            (; rtol = 1e-13, atol = 1e-15, max_steps = 4096) => 1e-8, (; steps = 30) => 1e-12,
        )
            stage = FlowStage(; terms, hidden = [5, 4], solver...)
            parameters = sustained_parameters(stage)
            given = physics_terms(Config(; flow = stage), 0.8)
            extra_terms = physics_terms_by_formula(terms, 0.8)
            joint, _ = flow_by_library(
                parameters, stage, 1:n_cases; inflow = small_inflow, extra_terms,
            )
            problem = with_terms(stage)
            @test value!(problem, parameters) ≈
                  sum(abs2, joint .- data.flow) / length(joint)
            separate = solve_flow(parameters, small_inflow, data.area, z, stage, given)
            @test separate ≈ joint rtol = rtol
            @test separate[:, :, 2:2] == solve_flow(
                parameters, small_inflow[:, 2:2], data.area[:, :, 2:2], z, stage, given,
            )
        end
        stage = FlowStage(; terms, hidden = [5, 4], steps = 9)
        check_gradient(with_terms(stage), sustained_parameters(stage); rtol = 1e-6)
        # The gradient treats adaptive steps as fixed; without kinks of S they do not matter.
        stage = FlowStage(; terms, hidden = [4], activation = "gelu", loss = "sum", tight...)
        taper = range(1.0, 0.9, n_points) .* data.area[1:1, :, :]
        problem = with_terms(stage; area = taper)
        check_gradient(problem, sustained_parameters(stage); rtol = 1e-5)
    end
end

@testset "physics terms: closed forms" begin
    solved(terms, area, bias) =
        let stage = FlowStage(; terms, hidden = [2], tight...)
            parameters = zeros(2 * n_times * 2 + 2 + 3 * n_times)
            parameters[(end - n_times + 1):end] .= bias
            given = physics_terms(Config(; flow = stage), 1.0)
            solve_flow(parameters, small_inflow, area, z, stage, given)
        end
    at_inlet = reshape(small_inflow, 1, n_times, n_cases)
    constant = 0.5 - 3π * 0.04 / 1.06
    @test solved(["friction"], data.area, 0.5) ≈ at_inlet .+ constant .* z rtol = 1e-12
    # ∂Q/∂z = ½ Q ∂(log S)/∂z.
    taper = range(1.0, 0.5, n_points) .* data.area[1:1, :, :]
    @test solved(["convection"], taper, 0.0) ≈ at_inlet .* sqrt.(taper ./ taper[1:1, :, :]) rtol =
        1e-10
    # If Q is constant in time, it is constant along z.
    steady = ones(n_times, n_cases)
    stage = FlowStage(; terms = ["inertia"], hidden = [2])
    terms = physics_terms(Config(; flow = stage), 1.0)
    zero_network = zeros(2 * n_times * 2 + 2 + 3 * n_times)
    @test solve_flow(zero_network, steady, data.area, z, stage, terms) == ones(size(data.area))
    signal = reshape(sinpi.(2 .* (0:(n_times - 1)) ./ n_times), :, 1)
    change = PCNDECore.time_derivative!(similar(signal), signal, 2.0)
    # Central differences of a sine: a cosine, times the sinc of the spacing.
    expected = cospi.(2 .* (0:(n_times - 1)) ./ n_times) .* sinpi(2 / n_times) .* n_times ./ 2
    @test vec(change) ≈ expected
end

@testset "physics terms: hot loop, divergence, settings" begin
    stage = FlowStage(; terms = all_terms)
    problem = with_terms(stage)
    parameters = sustained_parameters(stage)
    gradient = similar(parameters)
    @test @inferred(value!(problem, parameters)) isa Float64
    @test @inferred(value_and_gradient!(gradient, problem, parameters)) isa Float64
    rate, u = problem.terms, problem.norm.state_before
    du = similar(u)
    allocated(rate, du, u) = @allocated rate(du, u, nothing, 1.3)
    allocated(rate, du, u)
    @test allocated(rate, du, u) == 0
    norm_allocated(norm, u) = @allocated norm(u, 0.0)
    norm_allocated(problem.norm, du)
    @test norm_allocated(problem.norm, du) == 0
    fresh = value!(problem, parameters)
    # Q reaches zero, where the inertia term is singular.
    sinking = [zeros(length(parameters) - n_times); fill(-0.5, n_times)]
    for broken in (fill(NaN, length(parameters)), sinking)
        @test value!(problem, broken) == Inf
        @test value_and_gradient!(gradient, problem, broken) == Inf
        @test_throws SolveError solve_flow(
            broken, small_inflow, data.area, z, stage, PhysicsTerms(0.0, 0.0, 0.375, 0.8),
        )
    end
    @test value!(problem, parameters) == fresh
    @test_throws ArgumentError flow_problem(stage)
    given = physics_terms(Config(; flow = stage), 0.8)
    @test_throws ArgumentError solve_flow(
        parameters, small_inflow, data.area, z, FlowStage(), given,
    )
    config = PCNDECore.config("flow.terms = [\"inertia\", \"friction\"]\nphysics.density = 2.0")
    @test physics_terms(config, 0.8) == PhysicsTerms(-3π * 0.04 / 2, 0.0, 0.375, 0.8)
    @test isnothing(physics_terms(PCNDECore.config("flow.terms = []"), 0.8))
    Θ = [parameters sinking]
    inputs = (small_inflow, data.area)
    config = Config(; flow = stage)
    losses = PCNDECore.losses("flow", Θ, inputs, data.flow, z, 0.8, config)
    @test losses == [fresh, Inf]
    @test solve("flow", parameters, inputs, z, 0.8, config) ==
          solve_flow(parameters, small_inflow, data.area, z, stage, given)
end
