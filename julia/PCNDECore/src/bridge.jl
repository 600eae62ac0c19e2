# What Python calls. Every array has the indices (z, time, case), which in Julia's order
# is the same memory as Python's (case, time, z).

"""
    config(toml)

Settings from a TOML text with one table per group; names that Julia does not need are
left out, and what is not given keeps its default.
"""
config(toml::String) = config(Config(), toml)

"""
    closure_config(toml)

[`config`](@ref) of the preset `physics`.
"""
closure_config(toml::String) = config(ClosureConfig(), toml)

function config(default::T, toml::String) where {T}
    given = TOML.parse(toml)
    groups = Any[
        settings(getfield(default, name), get(given, string(name), Dict{String, Any}()))
        for name in fieldnames(T)
    ]
    return T(groups...)
end

function settings(default::T, given::Dict{String, Any}) where {T}
    # Of no particular types, so that the compiler need not wait for what is given.
    values = Any[get(given, string(name), getfield(default, name)) for name in fieldnames(T)]
    return T(values...)
end

"""
    of_python(address, shape...)

Python's float64 array of that shape itself, in Julia's order of indices; to be used no
longer than Python keeps it.
"""
of_python(address::Int, shape::Int...) = unsafe_wrap(Array, Ptr{Float64}(address), shape)

"""
    from_python(address, shape...)

A copy of [`of_python`](@ref), whose memory does not depend on Python.
"""
from_python(address::Int, shape::Int...) = copy(of_python(address, shape...))

"""
    solve(stage, θ, inputs, z, period, config)

A stage's result for every case on its own, (z, time, case).

# Arguments

  - `stage`: `"flow"`, `"intermediate_area"`, `"fourier_area"`, `"temporal_pressure"`,
    `"spatial_pressure"` or `"temporal_flow"`.
  - `θ`: parameters, flat vector.
  - `inputs`: the stage's arrays, in the order of the Python package's `engines.types`.
  - `z`, `period`: points, cm, and length of the cycle, s.
  - `config`: a [`Config`](@ref).
"""
function solve(stage::String, θ, inputs, z, period, config::Config)
    if stage == "flow"
        return solve_flow(θ, inputs..., z, config.flow, physics_terms(config, period))
    elseif stage == "intermediate_area"
        return solve_intermediate_area(θ, inputs..., period, z, config.intermediate_area)
    elseif stage == "temporal_pressure"
        return solve_temporal_pressure(θ, inputs..., config.physics, config.temporal_pressure)
    elseif stage == "temporal_flow"
        return solve_temporal_flow(θ, inputs..., period, config.temporal_flow)
    end
    no_target = zero(first(inputs))
    return solve(problem(stage, inputs, no_target, z, period, config), θ)
end

"""
    loss_and_gradient(stage, θ, inputs, target, z, period, config)

`(loss, gradient)` against `target` (z, time, case); the other arguments are those of
[`solve`](@ref).
"""
function loss_and_gradient(stage::String, θ, inputs, target, z, period, config::Config)
    return loss_and_gradient(problem(stage, inputs, target, z, period, config), θ)
end

# The problem that Python evaluates again and again.
const HELD = Ref{Any}()

"""
    hold(stage, inputs, target, weight, z, period, config)

Keep the problem of [`loss_and_gradient`](@ref) for [`held_loss_and_gradient`](@ref), in
place of the one before; `weight` (case) is that of each case's squares.
"""
function hold(stage::String, inputs, target, weight, z, period, config::Config)
    HELD[] = set_weight!(problem(stage, inputs, target, z, period, config), weight)
    return nothing
end

"""
    held_loss_and_gradient(θ)

[`loss_and_gradient`](@ref) of the problem that is held.
"""
held_loss_and_gradient(θ) = loss_and_gradient(HELD[], θ)

function loss_and_gradient(objective::Objective, θ)
    gradient = similar(θ)
    loss = value_and_gradient!(gradient, objective, θ)
    return loss, gradient
end

"""
    losses(stage, Θ, inputs, target, z, period, config)

Loss of each of the parameter vectors in the columns of `Θ`, `Inf` where the equation
cannot be integrated; the other arguments are those of [`loss_and_gradient`](@ref).
"""
function losses(stage::String, Θ, inputs, target, z, period, config::Config)
    objective = problem(stage, inputs, target, z, period, config)
    return [value!(objective, Θ[:, k]) for k in axes(Θ, 2)]
end

"""
    fit(stage, θ, inputs, target, z, period, config, iterations, on_iteration)

Minimise [`loss_and_gradient`](@ref) from `θ`: `(parameters, losses, converged,
message)` as of [`fit`](@ref).
"""
function fit(
    stage::String, θ, inputs, target, z, period, config::Config, iterations,
    @nospecialize(on_iteration = nothing),
)
    objective = problem(stage, inputs, target, z, period, config)
    result = fit(objective, θ, config.optimizer, iterations, on_iteration)
    return values(result)
end

function problem(stage, inputs, target, z, period, config::Config)
    if stage == "flow"
        return FlowProblem(
            inputs..., target, z, config.flow, physics_terms(config, period),
        )
    elseif stage == "intermediate_area"
        return intermediate_area_problem(
            inputs..., target, period, z, config.intermediate_area,
        )
    elseif stage == "fourier_area"
        return fourier_area_problem(inputs..., target, period, z, config.fourier_area)
    elseif stage == "temporal_pressure"
        return TemporalPressure(inputs..., target, config.physics, config.temporal_pressure)
    elseif stage == "spatial_pressure"
        return SpatialPressure(inputs..., target, z, config.physics, config.spatial_pressure)
    elseif stage == "temporal_flow"
        return TemporalFlow(inputs..., target, period, config.temporal_flow)
    end
    throw(ArgumentError("there is no stage \"$stage\""))
end

"""
    closure(name, θ, inputs, z, period, config)

`(value, jacobian)` of a closure of the preset `physics` by its parameters `θ`, (z, time,
case) and (parameter, z, time, case).

# Arguments

  - `name`: `"losses"`, `"area"` or `"flow"`.
  - `inputs`: arrays in the order of the Python package's `engines.protocol`; the points'
    positions count from 0.
  - `z`, `period`: points, cm, and length of the cycle, s.
  - `config`: a [`ClosureConfig`](@ref).
"""
function closure(name::String, θ, inputs, z, period, config::ClosureConfig)
    if name == "losses"
        return value_and_jacobian(LossesClosure(inputs..., z, period, config), θ)
    elseif name == "area"
        return value_and_jacobian(AreaClosure(inputs..., z, config), θ)
    elseif name == "flow"
        others..., points = inputs
        return value_and_jacobian(
            FlowClosure(others..., Int.(points) .+ 1, z, period, config), θ,
        )
    end
    throw(ArgumentError("there is no closure \"$name\""))
end

"""
    predict_closures(config, period, numbers...)

[`predict_closures!`](@ref) with Python's own arrays, in the order of that function;
`numbers` are the address and the shape of each. All come in one call, as handing over an
array on its own takes as long as a part of a prediction.
"""
function predict_closures(config::ClosureConfig, period::Float64, numbers::Int...)
    at = 0
    function next(dimensions)
        address, shape... = numbers[(at + 1):(at + 1 + dimensions)]
        at += 1 + dimensions
        return of_python(address, shape...)
    end
    flow, area, pressure = next(3), next(3), next(3)
    parameters = next(1), next(1), next(1), next(1)
    shift, inflow, area_undeformed, z = next(1), next(2), next(2), next(1)
    return predict_closures!(
        flow, area, pressure, parameters, shift, inflow, area_undeformed, z, period, config,
    )
end

"""
    versions()

Versions of Julia and of the packages that compute.
"""
function versions()
    modules = (OrdinaryDiffEqTsit5 = parentmodule(Tsit5), Lux = Lux, Optim = Optim)
    versions = Dict(string(name) => string(pkgversion(m)) for (name, m) in pairs(modules))
    versions["julia"] = string(VERSION)
    versions["PCNDECore"] = string(pkgversion(@__MODULE__))
    return versions
end
