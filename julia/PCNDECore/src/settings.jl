# Settings, one struct per group. Names, meanings and defaults are those of the Python
# package's configuration, which validates them.

"""
Blood, wall and stenosis, CGS: g/cm³, poise, dyn/cm², cm.
"""
Base.@kwdef struct Physics
    density::Float64 = 1.06
    viscosity::Float64 = 0.04
    young_modulus::Float64 = 1.5e7
    wall_thickness::Float64 = 0.05
    reference_pressure::Float64 = 133_322.0
    stenosis_length::Float64 = 0.5
    stenosis_position::Float64 = 2.0
    turbulent_coefficient::Float64 = 1.52
end

"""
`Optim.BFGS` with `LineSearches.BackTracking`.
"""
Base.@kwdef struct Optimizer
    initial_step_norm::Float64 = 0.01
    sufficient_decrease::Float64 = 1e-4
    shrink_most::Float64 = 0.1
    shrink_least::Float64 = 0.5
    max_backtracks::Int = 1000
    gradient_tolerance::Float64 = 1e-8
end

"""
Momentum equation. `terms` are added to the network: `"friction"`, `"convection"` and
`"inertia"`. `first_step` is in cm; with `nothing`, it is the first spacing of the grid. With
`steps`, that many equal steps replace the adaptive ones.
"""
Base.@kwdef struct FlowStage
    terms::Vector{String} = String[]
    hidden::Vector{Int} = [8, 8, 8, 8]
    activation::String = "tanh"
    rtol::Float64 = 1e-3
    atol::Float64 = 1e-6
    first_step::Union{Nothing, Float64} = nothing
    max_steps::Int = 256
    steps::Union{Nothing, Int} = nothing
    loss::String = "mean"
end

"""
Momentum equation in time, with `steps` steps between time points.
"""
Base.@kwdef struct TemporalFlowStage
    hidden::Vector{Int} = [8, 8, 8, 8]
    activation::String = "tanh"
    time_input::Bool = false
    steps::Int = 1
end

"""
Continuity equation in time. The loss is that of the last of the `cycles`.
"""
Base.@kwdef struct IntermediateAreaStage
    cycles::Int = 3
end

"""
Periodic area. `anchor` selects the time point of Ŝ from which it starts; `frequency` and
`sides` select variants of the published code.
"""
Base.@kwdef struct FourierAreaStage
    anchor::String = "last_time_point"
    terms::Int = 10
    frequency::String = "harmonic"
    sides::String = "two"
end

"""
First pressure stage.
"""
Base.@kwdef struct TemporalPressureStage
    hidden::Vector{Int} = [2, 2]
    activation::String = "tanh"
    pressure_drop_input::String = "normalized"
end

"""
Second pressure stage.
"""
Base.@kwdef struct SpatialPressureStage
    form::String = "continuous"
end

"""
All settings, in the same groups as in Python.
"""
Base.@kwdef struct Config
    physics::Physics = Physics()
    optimizer::Optimizer = Optimizer()
    flow::FlowStage = FlowStage()
    intermediate_area::IntermediateAreaStage = IntermediateAreaStage()
    fourier_area::FourierAreaStage = FourierAreaStage()
    temporal_pressure::TemporalPressureStage = TemporalPressureStage()
    spatial_pressure::SpatialPressureStage = SpatialPressureStage()
    temporal_flow::TemporalFlowStage = TemporalFlowStage()
end

"""
Wall of the preset `physics`; `law` is `"membrane"` or `"local"`.
"""
Base.@kwdef struct WallClosure
    law::String = "membrane"
end

"""
Correction of the preset `physics`: widths of the hidden layers, and largest number of coupling
passes.
"""
Base.@kwdef struct CorrectionClosure
    hidden::Vector{Int} = Int[]
    passes::Int = 8
end

"""
Settings of the preset `physics` that its equations need.
"""
Base.@kwdef struct ClosureConfig
    physics::Physics = Physics()
    wall::WallClosure = WallClosure()
    correction::CorrectionClosure = CorrectionClosure()
end
