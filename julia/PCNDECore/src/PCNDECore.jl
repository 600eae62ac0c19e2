"""
The performance core of `pcnde_bridge`: physics-constrained coupled neural
differential equations for blood flow in one vessel, after Csala, Mohan, Livescu
and Arzani (2024).

Five stages, each of which can be solved, judged and fitted:

| stage                                    | file                   |
|:-----------------------------------------|:-----------------------|
| momentum, a neural ODE in z              | `flow.jl`              |
| continuity in time, over some cycles     | `intermediate_area.jl` |
| periodic area by Fourier series          | `fourier_area.jl`      |
| pressure from a network, at each instant | `temporal_pressure.jl` |
| constant–tanh–constant pressure in z     | `spatial_pressure.jl`  |

and what studies compare with the first: the same with terms of the 1D momentum equation
beside the network, in `physics_terms.jl`, and the momentum equation in time, in
`temporal_flow.jl`.

Every array is float64 with the indices (z, time, case), in CGS units; every
stage's parameters are one flat vector. `predict.jl` runs all stages of a trained model,
`bridge.jl` holds what Python calls. The preset `physics` has its equations in `closures/`.
"""
module PCNDECore

using ForwardDiff: ForwardDiff, Dual
using LinearAlgebra: LinearAlgebra, Adjoint, I, axpy!, dot, mul!, norm, rmul!
using LineSearches: BackTracking, LineSearchException, MoreThuente
using Lux: Lux, Chain, Dense
using NLSolversBase: NLSolversBase, OnceDifferentiable
using NNlib: NNlib
using Optim: Optim, BFGS, LBFGS
using OrdinaryDiffEqCore: OrdinaryDiffEqCore
using OrdinaryDiffEqTsit5: Tsit5
using PrecompileTools: @compile_workload, @setup_workload
using Random: Random
using SIMD: Vec, vload, vstore, vstorent
using SciMLBase: SciMLBase, ODEProblem, init, step!
using SciMLLogging: SciMLLogging
using TOML: TOML

include("settings.jl")
include("network.jl")
include("step_control.jl")
include("tableau.jl")
include("objective.jl")
include("over_cases.jl")
include("past_cache.jl")
include("short_sums.jl")
include("flow_gradient_room.jl")
include("flow.jl")
include("flow_gradient.jl")
include("physics_terms.jl")
include("temporal_flow.jl")
include("slope.jl")
include("linear_area.jl")
include("intermediate_area.jl")
include("fourier_area.jl")
include("stenosis.jl")
include("temporal_pressure.jl")
include("spatial_pressure.jl")
include("predict.jl")
include("inverse_hessian.jl")
include("fit.jl")
include("lbfgs.jl")
include("closures/quadrature.jl")
include("closures/wall.jl")
include("closures/losses.jl")
include("closures/correction.jl")
include("closures/coupling.jl")
include("closures/closures.jl")
include("bridge.jl")
include("precompile.jl")

end
