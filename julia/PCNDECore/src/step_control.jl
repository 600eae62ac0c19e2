# Step size control of the adaptive solves.

const BETA_1, BETA_2 = 7 / 50, 2 / 25
const SAFETY, SHRINK, GROW = 0.9, 0.2, 10.0
const FIRST_ERROR = 1e-4

"""
    StepControl()

Hairer and Wanner's proportional–integral controller (Solving Ordinary Differential
Equations II, section IV.2) with the constants of DifferentialEquations.jl for `Tsit5`. The suite's
controller increases the first step by up to 10 000 in some versions and approximates powers,
so that two engines, or two versions, would take different steps.
"""
struct StepControl <: OrdinaryDiffEqCore.AbstractController end

mutable struct StepControlCache <: OrdinaryDiffEqCore.AbstractControllerCache
    EEst::Float64 # error estimate of the current step; the name is the suite's
    previous::Float64
end

function OrdinaryDiffEqCore.setup_controller_cache(
    alg, cache, ::StepControl, ::Type{E}, disco_probs,
) where {E}
    return StepControlCache(1.0, FIRST_ERROR)
end

# The suite divides the step size by the result if the step is accepted.
function OrdinaryDiffEqCore.stepsize_controller!(integrator, cache::StepControlCache, alg)
    factor = SAFETY * cache.previous^BETA_2 / cache.EEst^BETA_1
    return inv(clamp(factor, SHRINK, GROW))
end

function OrdinaryDiffEqCore.step_accept_controller!(integrator, cache::StepControlCache, alg, q)
    cache.previous = max(cache.EEst, FIRST_ERROR)
    return integrator.dt / q
end

function OrdinaryDiffEqCore.step_reject_controller!(integrator, cache::StepControlCache, alg)
    factor = SAFETY / cache.EEst^BETA_1
    # With an error of NaN, the step is reduced as far as allowed.
    return integrator.dt *= isnan(factor) ? SHRINK : max(factor, SHRINK)
end

function OrdinaryDiffEqCore.reinit_controller!(
    integrator::SciMLBase.DEIntegrator, cache::StepControlCache,
)
    cache.EEst, cache.previous = 1.0, FIRST_ERROR
    return nothing
end
