# Comparison of PCNDECore's discrete adjoint with the adjoints of SciMLSensitivity, on one batch
# of the paper's size (12 cases, 100 time points, 101 points).
#
# ForwardDiffSensitivity is not included: with 2724 parameters, one gradient takes minutes.
# The environment needs SciMLSensitivity and Zygote in addition to PCNDECore:
# julia --project=… benchmark/adjoints.jl

using PCNDECore
using PCNDECore: FlowProblem, FlowStage, StepControl, value!, value_and_gradient!
using SciMLSensitivity, Zygote
using LinearAlgebra
using OrdinaryDiffEqTsit5: ODEProblem, Tsit5
using Random: MersenneTwister
using SciMLBase: solve

"""
Evaluate the network as a plain function of a flat parameter vector, for automatic
differentiation.
"""
function network(p, q, s, widths)
    offset, x = 0, q
    for i in 1:(length(widths) - 1)
        n_in, n_out = widths[i], widths[i + 1]
        weight = reshape(p[(offset + 1):(offset + n_in * n_out)], n_out, n_in)
        offset += n_in * n_out
        bias = p[(offset + 1):(offset + n_out)]
        offset += n_out
        # Flow and area are separate: ReverseDiff cannot stack tracked and untracked arrays.
        n = size(q, 1)
        x =
            i > 1 ? weight * x .+ bias :
            weight[:, 1:n] * q .+ weight[:, (n + 1):end] * s .+ bias
        if i < length(widths) - 1
            x = tanh.(x)
        end
    end
    return x
end

"""
    compare(inflow, area, target, z, parameters; stage = FlowStage())

Print the time of each gradient and its difference from ours; the arrays are those of
`FlowProblem`.
"""
function compare(inflow, area, target, z, parameters; stage = FlowStage())
    n_times = size(inflow, 1)
    widths = [2 * n_times; stage.hidden; n_times]
    truth = reshape(permutedims(target, (2, 3, 1)), :, length(z))
    # ReverseDiff needs a vector as state, and a position of any type.
    function f(q, p, position)
        i = clamp(searchsortedlast(z, position), 1, length(z) - 1)
        share = (position - z[i]) / (z[i + 1] - z[i])
        s = (1 - share) .* area[i, :, :] .+ share .* area[i + 1, :, :]
        return vec(network(p, reshape(q, n_times, :), s, widths))
    end
    function loss(p, sensealg)
        equation = ODEProblem{false}(f, vec(inflow), (z[1], z[end]), p)
        solution = solve(
            equation, Tsit5();
            dt = z[2] - z[1], reltol = stage.rtol, abstol = stage.atol,
            controller = StepControl(), saveat = z, sensealg,
        )
        return sum(abs2, Array(solution) .- truth) / length(truth)
    end
    problem = FlowProblem(copy(inflow), area, target, z, stage)
    reference = similar(parameters)
    value_and_gradient!(reference, problem, parameters)
    report(name, seconds, gradient) = println(
        rpad(name, 44), lpad(round(1e3 * seconds; sigdigits = 3), 9), " ms   difference ",
        round(norm(gradient - reference) / norm(reference); sigdigits = 2),
    )
    report("loss alone", best(() -> value!(problem, parameters)), reference)
    gradient = similar(parameters)
    seconds = best(() -> value_and_gradient!(gradient, problem, parameters))
    report("discrete adjoint, preallocated VJP", seconds, gradient)
    zygote = ZygoteVJP()
    for (name, sensealg) in (
        "GaussAdjoint, Zygote" => GaussAdjoint(autojacvec = zygote),
        "InterpolatingAdjoint, Zygote" => InterpolatingAdjoint(autojacvec = zygote),
        "QuadratureAdjoint, Zygote" => QuadratureAdjoint(autojacvec = zygote),
        "InterpolatingAdjoint, ReverseDiff" =>
            InterpolatingAdjoint(autojacvec = ReverseDiffVJP()),
        "GaussAdjoint, ReverseDiff" => GaussAdjoint(autojacvec = ReverseDiffVJP()),
        # Discretize, then optimize: through the steps of the solver.
        "ReverseDiffAdjoint" => ReverseDiffAdjoint(),
    )
        try
            run() = only(Zygote.gradient(p -> loss(p, sensealg), parameters))
            gradient = run()
            report(name, best(run; times = 2), gradient)
        catch error
            println(rpad(name, 44), " fails: ", first(sprint(showerror, error), 100))
        end
        flush(stdout)
    end
    return nothing
end

function best(run; times = 20)
    run()
    return minimum(@elapsed(run()) for _ in 1:times)
end

if abspath(PROGRAM_FILE) == @__FILE__
    n_points, n_times, n_cases = 101, 100, 12
    z = collect(range(0.0, 4.0, n_points))
    t = (0:(n_times - 1)) ./ n_times
    inflow = [1.2 + 0.05 * n * sin(2π * x) + 0.02 * n * cos(4π * x) for x in t, n in 1:n_cases]
    bump = exp.(-((z .- 2) ./ 0.25) .^ 2)
    area = [0.125 * (1 - 0.05 * n * bump[i]) for i in 1:n_points, _ in t, n in 1:n_cases]
    target =
        [inflow[k, n] * (1 - 0.01 * z[i]) for i in 1:n_points, k in 1:n_times, n in 1:n_cases]
    rng, widths = MersenneTwister(0), [200, 8, 8, 8, 8, 100]
    parameters = reduce(
        vcat,
        [
            [
                sqrt(6 / (widths[i] + widths[i + 1])) .*
                (2 .* rand(rng, widths[i] * widths[i + 1]) .- 1)
                zeros(widths[i + 1])
            ] for i in 1:5
        ],
    )
    for stage in (FlowStage(), FlowStage(rtol = 1e-9, atol = 1e-11))
        println("rtol ", stage.rtol)
        compare(inflow, area, target, z, parameters; stage)
    end
end
