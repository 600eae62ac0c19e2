# Momentum equation with physics terms added to the network (section 3.6),
#
#     ∂Q/∂z = f_θ(Q, S) + N/(2(1+δ)) + ½ (Q/S) ∂S/∂z − (S/Q) ∂Q/∂t / (2(1+δ)),
#
# where each term is optional. δ = 1/3 and N = −8πν are the values of a parabolic profile. S
# and ∂S/∂z are linear between the points of the grid. The solve and its gradient are those
# of `flow.jl` and `flow_gradient.jl`, with the state Q − Q_in, (time, case).

"""
δ of a parabolic velocity profile.
"""
const DELTA = 1 / 3

"""
Factors of the terms; zero for a term that is not in the equation. `friction` is the term
itself, mL/s/cm; `period` is the cycle length, s.
"""
struct PhysicsTerms
    friction::Float64
    convection::Float64
    inertia::Float64
    period::Float64
end

"""
    physics_terms(config, period)

[`PhysicsTerms`](@ref) with the terms in `config.flow.terms`, or `nothing` if it is empty.
"""
function physics_terms(config::Config, period)
    (; terms) = config.flow
    isempty(terms) && return nothing
    friction = -8π * config.physics.viscosity / config.physics.density
    return PhysicsTerms(
        ("friction" in terms) * friction / (2 * (1 + DELTA)),
        ("convection" in terms) / 2,
        ("inertia" in terms) / (2 * (1 + DELTA)),
        period,
    )
end

"""
    TermsRate(terms, layers, inflow, area)

Right-hand side of the momentum equation with terms, (time, case), in place and without
allocations.
"""
struct TermsRate
    terms::PhysicsTerms
    layers::HiddenRate              # of the network, except the last one
    inflow::Matrix{Float64}         # (time, case)
    area::Matrix{Float64}           # (time, case·z)
    area_slope::Matrix{Float64}     # (time, case·z): ∂S/∂z
    flow::Matrix{Float64}           # (time, case): Q, S, ∂S/∂z and ∂Q/∂t at one evaluation
    area_here::Matrix{Float64}
    area_slope_here::Matrix{Float64}
    flow_rate::Matrix{Float64}
    grad_flow_rate::Matrix{Float64} # derivative of the loss with respect to ∂Q/∂t …
    grad_in_time::Matrix{Float64}   # … and its contribution to that with respect to Q
    grad_hidden::Matrix{Float64}    # (hidden + 1, case)
end

function TermsRate(terms::PhysicsTerms, layers::HiddenRate, inflow, area)
    n_cases = size(inflow, 2)
    n_hidden = size(layers.network.matrices[end], 2)
    return TermsRate(
        terms, layers, inflow, area, similar(area), (similar(inflow) for _ in 1:6)...,
        zeros(n_hidden, n_cases),
    )
end

"""
    set_area_slope!(rate, area)

Compute ∂S/∂z of new cases from S (z, time, case).
"""
function set_area_slope!(rate::TermsRate, area)
    shape = (size(rate.inflow)..., size(area, 1))
    slope = derivative_along_z(Array(area), rate.layers.z)
    permutedims!(reshape(rate.area_slope, shape), slope, (2, 3, 1))
    return rate
end

function (rate::TermsRate)(du, u, _, position)
    mul!(du, rate.layers.network.matrices[end], last_hidden!(rate.layers, u, position))
    evaluate_fields!(rate, u, position)
    (; terms, flow, area_here, area_slope_here, flow_rate) = rate
    (; friction, convection, inertia) = terms
    du .+= friction
    iszero(convection) || (du .+= convection .* flow ./ area_here .* area_slope_here)
    # Without this term, the equation is not singular at Q = 0.
    iszero(inertia) || (du .-= inertia .* area_here ./ flow .* flow_rate)
    return nothing
end

"""
    evaluate_fields!(rate, u, position)

Compute Q, ∂Q/∂t, S and ∂S/∂z for a state and a position.
"""
function evaluate_fields!(rate::TermsRate, u, position)
    (; inflow, area, area_slope, flow, area_here, area_slope_here) = rate
    flow .= inflow .+ u
    time_derivative!(rate.flow_rate, flow, rate.terms.period)
    interpolate_grid!(area_here, area, rate.layers.z, position)
    interpolate_grid!(area_slope_here, area_slope, rate.layers.z, position)
    return rate
end

"""
    time_derivative!(derivative, flow, period)

∂Q/∂t, mL/s², of Q (time, case), by periodic central differences. The matrix of the
differences is antisymmetric, so that its transpose is its negative.
"""
function time_derivative!(derivative, flow, period)
    n = size(flow, 1)
    per_difference = n / (2 * period)
    @inbounds for case in axes(flow, 2), t in 1:n
        before, after = t == 1 ? n : t - 1, t == n ? 1 : t + 1
        derivative[t, case] = per_difference * (flow[after, case] - flow[before, case])
    end
    return derivative
end

"""
    terms_vjp!(blocks, problem, number, grad_slope)

[`evaluation_vjp!`](@ref) of the right-hand side with terms; `grad_slope` has the shape (time,
case).
"""
function terms_vjp!(blocks, problem::FlowProblem, number::Int, grad_slope)
    (; network, workspace, inflow) = problem
    rate, last = problem.terms, network.matrices[end]
    (; flow, area_here, area_slope_here, flow_rate, grad_flow_rate, grad_in_time) = rate
    (; convection, inertia, period) = rate.terms
    columns = evaluation_columns(number, size(inflow, 2))
    mul!(blocks[end], grad_slope, view(workspace.activations.after[end], :, columns)', 1.0, 1.0)
    mul!(rate.grad_hidden, last', grad_slope)
    layers_vjp!(problem, number, rate.grad_hidden)

    evaluate_fields!(rate, view(workspace.inputs, :, columns), workspace.positions[number])
    grad_stage = workspace.grad_stage
    if !iszero(convection)
        grad_stage .+= convection .* area_slope_here ./ area_here .* grad_slope
    end
    if !iszero(inertia)
        grad_flow_rate .= .-inertia .* area_here ./ flow .* grad_slope
        grad_stage .-= grad_flow_rate .* flow_rate ./ flow
        grad_stage .-= time_derivative!(grad_in_time, grad_flow_rate, period)
    end
    return nothing
end
