"""
Names that are documented for users but not exported by their packages.
"""
const DOCUMENTED = (
    # Base, Random, TOML
    Symbol("@preserve"), :IteratorSize, :SizeUnknown, :default_rng, :parse,
    # ForwardDiff
    :Chunk, :Dual, :JacobianConfig, :jacobian,
    # Lux
    :setup,
    # Optim
    :GradientNorm, :Iterations, :NoObjectiveChange, :NoXChange, :Options, :TerminationCode,
    :termination_code,
    # SciMLBase
    :DEIntegrator, :FullSpecialize, :successful_retcode,
)

"""
Internal names of other packages that PCNDECore uses, by file. A version that was not tested may
change them; `[compat]` excludes such versions of OrdinaryDiffEqCore and Optim.

| package            | used in                                 | versions tested   |
|:-------------------|:----------------------------------------|:------------------|
| OrdinaryDiffEqCore | `step_control.jl`: controller interface | 4.6.1, 4.15.0     |
| Optim              | `inverse_hessian.jl`: BFGS updates      | 2.0.1, 2.2.1      |
| NNlib              | `network.jl`: activations               | 0.9.36            |
| Base               | `inverse_hessian.jl`, `streaming_copy.jl` | 1.10.8, 1.10.11 |
"""
const NONPUBLIC = (
    # OrdinaryDiffEqCore
    :AbstractController, :AbstractControllerCache, :reinit_controller!,
    :setup_controller_cache, :step_accept_controller!, :step_reject_controller!,
    :stepsize_controller!,
    # NNlib
    :deriv_gelu, :fast_act,
    # Base
    :FastContiguousSubArray, :broadcasted, :materialize!,
)
