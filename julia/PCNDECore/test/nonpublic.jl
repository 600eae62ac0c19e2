"""
Names that are documented for users but not exported by their packages.
"""
const DOCUMENTED = (
    # Base, Random, TOML
    Symbol("@preserve"), :ArrayStyle, :BroadcastStyle, :Broadcasted, :IteratorSize,
    :SizeUnknown,
    :default_rng, :parse,
    # ForwardDiff
    :Chunk, :Dual, :JacobianConfig, :gradient, :jacobian, :value,
    # Lux
    :apply, :setup,
    # Optim
    :GradientNorm, :Iterations, :NoObjectiveChange, :NoXChange, :Options, :TerminationCode,
    :g_converged, :iterations, :optimize, :termination_code,
    # SciMLBase
    :DEIntegrator, :FullSpecialize, :successful_retcode,
)

"""
Names of PCNDECore that its extension uses.
"""
const OF_THE_EXTENSION = (:ReferenceFlow, :adjoint_gradient, :reference_loss)

"""
Names of OrdinaryDiffEqCore that it declares public where Julia has the keyword `public`, from 1.11
on. The tested versions are in `self_check.jl`. No other internal name is used.
"""
const PUBLIC_FROM_1_11 = (
    :AbstractController, :AbstractControllerCache, :PIController, :reinit_controller!,
    :setup_controller_cache, :step_accept_controller!, :step_reject_controller!,
    :stepsize_controller!,
)
