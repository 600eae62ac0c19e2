# What Python calls. Every array has the indices (z, time, case), which in Julia's order
# is the same memory as Python's (case, time, z).

"""
    config(toml)

Settings from a TOML text with one table per group; names that Julia does not need are
left out, and what is not given keeps its default.
"""
function config(toml::String)
    given = TOML.parse(toml)
    groups = fields_from(given, Config) do type, group
        type(; fields_from(setting, group, type)...)
    end
    return Config(; groups...)
end

fields_from(convert_, given, type) = [
    name => convert_(field, given[string(name)]) for
    (name, field) in zip(fieldnames(type), fieldtypes(type)) if haskey(given, string(name))
]

setting(::Type{Vector{Int}}, value) = Vector{Int}(value)
setting(_, value) = value

"""
    solve(stage, parameters, inputs, z, period, config)

A stage's result for every case on its own, (z, time, case).

# Arguments

  - `stage`: `"flow"`, `"intermediate_area"`, `"fourier_area"`, `"temporal_pressure"` or
    `"spatial_pressure"`.
  - `parameters`: flat vector.
  - `inputs`: the stage's arrays, in the order of the Python package's `engines.base`.
  - `z`, `period`: points, cm, and length of the cycle, s.
  - `config`: a [`Config`](@ref).
"""
function solve(stage::String, parameters, inputs, z, period, config::Config)
    θ, points, arrays = owned(parameters), owned(z), map(owned, inputs)
    if stage == "flow"
        inflow, area = arrays
        return solve_flow(θ, inflow, area, points, config.flow)
    elseif stage == "intermediate_area"
        return solve_intermediate_area(θ, arrays..., period, points, config.intermediate_area)
    elseif stage == "temporal_pressure"
        return solve_temporal_pressure(θ, arrays..., config.physics, config.temporal_pressure)
    end
    no_target = zero(first(arrays))
    return solve(problem(stage, arrays, no_target, points, period, config), θ)
end

"""
    loss_and_gradient(stage, parameters, inputs, target, z, period, config)

`(loss, gradient)` against `target` (z, time, case); the other arguments are those of
[`solve`](@ref).
"""
function loss_and_gradient(stage::String, parameters, inputs, target, z, period, config::Config)
    θ = owned(parameters)
    objective = problem(stage, map(owned, inputs), owned(target), owned(z), period, config)
    gradient = similar(θ)
    loss = value_and_gradient!(gradient, objective, θ)
    return loss, gradient
end

"""
    fit(stage, parameters, inputs, target, z, period, config, iterations, on_iteration)

Minimise [`loss_and_gradient`](@ref) from `parameters`: `(parameters, losses, converged,
message)` as of [`fit`](@ref).
"""
function fit(
        stage::String, parameters, inputs, target, z, period, config::Config, iterations,
        on_iteration = nothing,
    )
    objective = problem(stage, map(owned, inputs), owned(target), owned(z), period, config)
    result = fit(objective, owned(parameters), config.optimiser, iterations, on_iteration)
    return values(result)
end

function problem(stage, inputs, target, z, period, config::Config)
    if stage == "flow"
        inflow, area = inputs
        return FlowProblem(inflow, area, target, z, config.flow)
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
    end
    throw(ArgumentError("there is no stage \"$stage\""))
end

# Python's memory may be strided, read-only, or gone when Python wants it back.
owned(array::AbstractArray{Float64, N}) where {N} = Array{Float64, N}(array)

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
