"""
Performance core of `pcnde_bridge`: physics-constrained coupled neural differential equations
for blood flow in one vessel, after Csala, Mohan, Livescu and Arzani (2024).

Each of the five stages can be solved, evaluated and fitted:

| stage                                    | file                   |
|:-----------------------------------------|:-----------------------|
| momentum, a neural ODE in z              | `flow.jl`              |
| continuity in time, over several cycles  | `intermediate_area.jl` |
| periodic area by Fourier series          | `fourier_area.jl`      |
| pressure from a network, per time point  | `temporal_pressure.jl` |
| constant–tanh–constant pressure in z     | `spatial_pressure.jl`  |

Studies compare the first stage with two alternatives: `physics_terms.jl` adds terms of the 1D
momentum equation to the network, and `temporal_flow.jl` integrates the equation in time.

Every array is float64 with the indices (z, time, case), in CGS units. The parameters of each
stage are one flat vector. `predict.jl` runs all stages of a trained model; `bridge.jl` has the
functions that Python calls. The equations of the preset `physics` are in `closures/`.
`reference.jl` is the first stage by the libraries alone, against which it is tested.
"""
module PCNDECore

using Base.Broadcast: ArrayStyle, Broadcasted
using ForwardDiff: ForwardDiff, Dual
using LinearAlgebra: LinearAlgebra, Adjoint, I, axpy!, dot, mul!, norm, rmul!
using LineSearches: BackTracking, LineSearchException
using Lux: Lux, Chain, Dense
using NLSolversBase: NLSolversBase, OnceDifferentiable
using NNlib: NNlib
using Optim: Optim, BFGS
using OrdinaryDiffEqCore: OrdinaryDiffEqCore, PIController
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
include("threading.jl")
include("streaming_copy.jl")
include("thin_matmul.jl")
include("flow_gradient_workspace.jl")
include("flow.jl")
include("flow_gradient.jl")
include("physics_terms.jl")
include("temporal_flow.jl")
include("derivative_along_z.jl")
include("linear_area.jl")
include("intermediate_area.jl")
include("fourier_area.jl")
include("stenosis.jl")
include("temporal_pressure.jl")
include("spatial_pressure.jl")
include("predict.jl")
include("inverse_hessian.jl")
include("fit.jl")
include("reference.jl")
include("closures/quadrature.jl")
include("closures/wall.jl")
include("closures/boundary_layer.jl")
include("closures/losses.jl")
include("closures/wall_shear_stress.jl")
include("closures/correction.jl")
include("closures/coupling.jl")
include("closures/fields.jl")
include("closures/closures.jl")
include("state.jl")
include("bridge.jl")
include("self_check.jl")
include("precompile.jl")

end
