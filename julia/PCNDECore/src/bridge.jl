# Functions that Python calls. Every array has the indices (z, time, case), which in Julia's
# order is the same memory as Python's (case, time, z).

"""
    call(name, arguments...)

Call a function of this module by its name. PythonCall compiles each function that it calls: this
is the only one.
"""
call(name::String, @nospecialize(arguments...)) =
    getfield(@__MODULE__, Symbol(name))(arguments...)

"""
    config(toml)

Read settings from a TOML text with one table per group. Unknown names are ignored, and missing
ones have their defaults.
"""
config(toml::String) = config(Config(), toml)

"""
    closure_config(toml)

Read the settings of the preset `physics`; see [`config`](@ref).
"""
closure_config(toml::String) = config(ClosureConfig(), toml)

function config(default::T, toml::String) where {T}
    values = TOML.parse(toml)
    groups = Any[
        settings(getfield(default, name), get(values, string(name), Dict{String, Any}()))
        for name in fieldnames(T)
    ]
    return T(groups...)
end

function settings(default::T, values::Dict{String, Any}) where {T}
    # The element type is Any, so that nothing is compiled for the types of the values.
    fields = Any[get(values, string(name), getfield(default, name)) for name in fieldnames(T)]
    return T(fields...)
end

"""
    wrap_python_array(address, shape...)

Wrap the memory of a float64 array of Python, with the shape in Julia's order. The result must
not be used after Python releases the array.
"""
wrap_python_array(address::Int, shape::Int...) =
    unsafe_wrap(Array, Ptr{Float64}(address), shape)

"""
    wrap_python_arrays(numbers, dimensions)

Wrap several arrays of Python. `numbers` are the address and the shape of each, one after the
other, and `dimensions` are the numbers of axes.
"""
function wrap_python_arrays(numbers, dimensions)
    position = 0
    return map(dimensions) do n_axes
        address, shape... = numbers[(position + 1):(position + 1 + n_axes)]
        position += 1 + n_axes
        return wrap_python_array(address, shape...)
    end
end

"""
    copy_python_array(address, shape...)

Copy a float64 array of Python into Julia's own memory; see [`wrap_python_array`](@ref).
"""
copy_python_array(address::Int, shape::Int...) = copy(wrap_python_array(address, shape...))

"""
    solve(stage, θ, inputs, z, period, config)

Solve a stage, (z, time, case). The result of a case does not depend on the other cases.

# Arguments

  - `stage`: `"flow"`, `"intermediate_area"`, `"fourier_area"`, `"temporal_pressure"`,
    `"spatial_pressure"`, `"temporal_flow"`, or `"reference_flow"`, a [`ReferenceFlow`](@ref).
  - `θ`: flat parameter vector.
  - `inputs`: arrays of the stage, in the order of the Python package's `engines.types`.
  - `z`, `period`: points, cm, and cycle length, s.
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
    zero_target = stage == "reference_flow" ? zero(last(inputs)) : zero(first(inputs))
    return solve(problem(stage, inputs, zero_target, z, period, config), θ)
end

"""
    loss_and_gradient(stage, θ, inputs, target, z, period, config)

`(loss, gradient)` against `target` (z, time, case); the other arguments are those of
[`solve`](@ref).
"""
function loss_and_gradient(stage::String, θ, inputs, target, z, period, config::Config)
    return loss_and_gradient(problem(stage, inputs, target, z, period, config), θ)
end

"""
    store_objective(stage, inputs, target, weight, z, period, config)

Store the objective of [`loss_and_gradient`](@ref) for [`stored_loss_and_gradient`](@ref); it
replaces the previous one. `weight` (case) is the weight of each case's squares.
"""
function store_objective(stage::String, inputs, target, weight, z, period, config::Config)
    objective = problem(stage, inputs, target, z, period, config)
    STATE.objective = set_weight!(objective, weight)
    return nothing
end

"""
    stored_loss_and_gradient(θ)

[`loss_and_gradient`](@ref) of the stored objective.
"""
stored_loss_and_gradient(θ) = loss_and_gradient(STATE.objective, θ)

function loss_and_gradient(objective::Objective, θ)
    gradient = similar(θ)
    loss = value_and_gradient!(gradient, objective, θ)
    return loss, gradient
end

"""
    losses(stage, Θ, inputs, target, z, period, config)

Loss of each parameter vector in the columns of `Θ`; `Inf` where the equation cannot be
integrated. The other arguments are those of [`loss_and_gradient`](@ref).
"""
function losses(stage::String, Θ, inputs, target, z, period, config::Config)
    objective = problem(stage, inputs, target, z, period, config)
    return [value!(objective, Θ[:, k]) for k in axes(Θ, 2)]
end

"""
    fit(stage, θ, inputs, target, z, period, config, iterations, on_iteration)

Minimize [`loss_and_gradient`](@ref) from `θ` and return `(parameters, losses, converged,
message)`; see [`fit`](@ref).
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
    elseif stage == "reference_flow"
        return ReferenceFlow(inputs..., target, z, config.flow)
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

`(value, jacobian)` of a closure of the preset `physics` as a function of its parameters `θ`,
(z, time, case) and (parameter, z, time, case).

# Arguments

  - `name`: `"losses"`, `"area"`, `"wall_shear_stress"` or `"flow"`.
  - `inputs`: arrays in the order of the Python package's `engines.protocol`; indices of
    points start at 0.
  - `z`, `period`: points, cm, and cycle length, s.
  - `config`: a [`ClosureConfig`](@ref).
"""
function closure(name::String, θ, inputs, z, period, config::ClosureConfig)
    haskey(CLOSURES, name) || throw(ArgumentError("there is no closure \"$name\""))
    return value_and_jacobian(CLOSURES[name](inputs, z, period, config), θ)
end

# A table in place of branches. Julia would infer every branch for the inputs of each closure, and
# methods of other packages would invalidate the result.
const CLOSURES = Dict{String, Any}(
    "losses" => (inputs, z, period, config) -> LossesClosure(inputs..., z, config),
    "area" => (inputs, z, period, config) -> AreaClosure(inputs..., z, config),
    "wall_shear_stress" => (inputs, z, period, config) -> ShearClosure(inputs..., z, config),
    "flow" => function (inputs, z, period, config)
        others..., points = inputs
        return FlowClosure(others..., Int.(points) .+ 1, z, period, config)
    end,
)

"""
Numbers of axes of the inputs of each [`closure`](@ref).
"""
const INPUT_AXES = Dict(
    "losses" => (3, 3, 2),
    "area" => (3, 2),
    "wall_shear_stress" => (1, 3, 3, 2),
    "flow" => (3, 1, 1, 2, 2, 2, 1),
)

"""
    closure!(name, config, period, numbers...)

Compute a [`closure`](@ref) with arrays in Python's memory: value and Jacobian, which are written,
θ, the inputs and z. See [`predict_closures`](@ref) for the `numbers`.
"""
function closure!(name::String, config::ClosureConfig, period::Float64, numbers::Int...)
    arrays = wrap_python_arrays(numbers, (3, 4, 1, INPUT_AXES[name]..., 1))
    value, jacobian, θ, inputs..., z = arrays
    found = closure(name, θ, inputs, z, period, config)
    copyto!(value, first(found))
    copyto!(jacobian, last(found))
    return nothing
end

"""
    predict_closures(config, period, numbers...)

Call [`predict_closures!`](@ref) with arrays in Python's memory, in the order of its
arguments. `numbers` are the address and the shape of each array; all are passed in one call,
because passing arrays one by one takes a noticeable share of a prediction's time.
"""
function predict_closures(config::ClosureConfig, period::Float64, numbers::Int...)
    axes_of_parameters, axes_of_inputs = (3, 1, 1, 1, 1), (1, 2, 2, 1, 2)
    arrays = wrap_python_arrays(numbers, (3, 3, 3, 3, axes_of_parameters..., axes_of_inputs...))
    return predict_closures!(arrays[1:4]..., arrays[5:9], arrays[10:14]..., period, config)
end

"""
    versions()

Versions of Julia, PCNDECore and the numerical packages, as TOML.
"""
function versions()
    modules = (; OrdinaryDiffEqTsit5 = parentmodule(Tsit5), Lux, Optim, PCNDECore)
    found = ["$name = \"$(pkgversion(m))\"" for (name, m) in pairs(modules)]
    return join(push!(found, "julia = \"$VERSION\""), "\n")
end
