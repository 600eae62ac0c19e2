# Check at start-up that the installed libraries behave as the tested ones.

"""
Uses of other packages beyond functions that are called: they are tested with these versions, and
`[compat]` excludes newer ones.

| package            | use                                                          | tested        |
|:-------------------|:-------------------------------------------------------------|:--------------|
| OrdinaryDiffEqCore | `step_control.jl` extends its interface of controllers       | 4.6.1, 4.15.0 |
| Optim              | `inverse_hessian.jl`: how `BFGS` updates and resets a matrix | 2.0.1, 2.2.1  |
"""
const TESTED = ("OrdinaryDiffEqCore" => "4.6.1 and 4.15.0", "Optim" => "2.0.1 and 2.2.1")

# Losses at the start and after each iteration, and lengths of the steps, cm, of
# `self_check_problem`, computed by the reference implementation.
const CHECKED_LOSSES =
    [0.8556676500162, 0.7501579819897, 0.0416682706169, 0.0184999314426, 0.0120398377008]
const CHECKED_STEPS = [1.0, 2.0651138758, 0.9348861242]

"""
    self_check_problem(type, stage)

`(problem, parameters)` of a small flow of the given type of problem.
"""
function self_check_problem(type, stage::FlowStage)
    # Without ranges, which would be compiled at start-up.
    t, z = [0.0, 0.25, 0.5, 0.75], [0.0, 1.0, 2.0, 3.0, 4.0]
    inflow = [1 + 0.2n * sin(2π * x + n) for x in t, n in 1:2]
    # S is linear in z: at its kinks, the error would depend on the steps.
    area = [(0.1 + 0.01n) * (1 - 0.1x) * inflow[k, n] for x in z, k in 1:4, n in 1:2]
    target = [inflow[k, n] * (1 - 0.05x * cos(2π * t[k])) for x in z, k in 1:4, n in 1:2]
    count = length(Network(chain([8; stage.hidden; 4], stage.activation)))
    return type(inflow, area, target, z, stage), [0.5 * sin(k) for k in 1:count]
end

const TIGHT_STAGE = FlowStage(hidden = [3], rtol = 1e-10, atol = 1e-12, max_steps = 4096)
const LOOSE_STAGE = FlowStage(hidden = [3])

"""
    self_check()

Compare a small fit, and the steps of a solution, with stored numbers of the
[`ReferenceFlow`](@ref).

# Throws

`ErrorException` if they differ: a package behaves differently than the tested versions.
"""
function self_check()
    difference = try
        problem, parameters = self_check_problem(FlowProblem, TIGHT_STAGE)
        losses = fit(problem, parameters, Optimizer(), 4).losses
        problem, parameters = self_check_problem(FlowProblem, LOOSE_STAGE)
        integrate!(problem, parameters)
        steps = problem.trajectory.lengths
        if !isapprox(losses, CHECKED_LOSSES; rtol = 1e-8)
            "its losses are $losses, expected are $CHECKED_LOSSES"
        elseif !isapprox(steps, CHECKED_STEPS; rtol = 1e-4)
            "its steps are $steps cm, expected are $CHECKED_STEPS cm"
        end
    catch failure
        sprint(showerror, failure)
    end
    isnothing(difference) && return nothing
    installed = join(("$name $(pkgversion(m))" for (name, m) in libraries()), ", ")
    tested = join(("$name $versions" for (name, versions) in TESTED), ", ")
    return error(
        "the installed libraries do not compute the flow as the tested ones: $difference. " *
        "Installed are $installed; tested are $tested. Install tested versions.",
    )
end

libraries() = ("OrdinaryDiffEqCore" => OrdinaryDiffEqCore, "Optim" => Optim)
