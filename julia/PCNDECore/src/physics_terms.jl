# Momentum equation with physics terms beside the network (section 3.6),
#
#     ∂Q/∂z = f_θ(Q, S) + N/(2(1+δ)) + ½ (Q/S) ∂S/∂z − (S/Q) ∂Q/∂t / (2(1+δ)),
#
# each term on its own option; δ = 1/3 and N = −8πν are those of a parabolic profile. S and
# ∂S/∂z are linear between the grid's points. The solve and its gradient are those of
# `flow.jl` and `flow_gradient.jl`, with Q − Q_in, (time, case), as the state.

"""
δ of a parabolic velocity profile.
"""
const DELTA = 1 / 3

"""
Factors of the terms, zero for one that is not in the equation: `friction` is the term
itself, mL/s/cm, and `period` the length of the cycle, s.
"""
struct PhysicsTerms
    friction::Float64
    convection::Float64
    inertia::Float64
    period::Float64
end

"""
    physics_terms(config, period)

[`PhysicsTerms`](@ref) that `config.flow.terms` names, or `nothing` if it names none.
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

Right-hand side of the momentum equation with terms, (time, case), in place and free of
allocations.
"""
struct TermsRate{F}
    terms::PhysicsTerms
    layers::FlowRate{F}             # of the network, but the last
    inflow::Matrix{Float64}         # (time, case)
    area::Matrix{Float64}           # (time, case·z)
    area_slope::Matrix{Float64}     # (time, case·z): ∂S/∂z
    flow::Matrix{Float64}           # (time, case): Q, S, ∂S/∂z and ∂Q/∂t at one evaluation
    area_here::Matrix{Float64}
    area_slope_here::Matrix{Float64}
    flow_rate::Matrix{Float64}
    by_flow_rate::Matrix{Float64}   # the loss by ∂Q/∂t …
    back_in_time::Matrix{Float64}   # … and what that makes by Q
    by_hidden::Matrix{Float64}      # (hidden + 1, case)
end

function TermsRate(terms::PhysicsTerms, layers::FlowRate, inflow, area)
    n_cases = size(inflow, 2)
    n_hidden = size(layers.network.matrices[end], 2)
    return TermsRate(
        terms, layers, inflow, area, similar(area), (similar(inflow) for _ in 1:6)...,
        zeros(n_hidden, n_cases),
    )
end

"""
    set_area_slope!(rate, area)

∂S/∂z of new cases, from S (z, time, case).
"""
function set_area_slope!(rate::TermsRate, area)
    shape = (size(rate.inflow)..., size(area, 1))
    slope = slope_along_z(Array(area), rate.layers.z)
    permutedims!(reshape(rate.area_slope, shape), slope, (2, 3, 1))
    return rate
end

function (rate::TermsRate)(du, u, _, position)
    mul!(du, rate.layers.network.matrices[end], last_hidden!(rate.layers, u, position))
    come_to!(rate, u, position)
    (; terms, flow, area_here, area_slope_here, flow_rate) = rate
    (; friction, convection, inertia) = terms
    du .+= friction
    iszero(convection) || (du .+= convection .* flow ./ area_here .* area_slope_here)
    # Where it is not in the equation, it is not singular at Q = 0 either.
    iszero(inertia) || (du .-= inertia .* area_here ./ flow .* flow_rate)
    return nothing
end

"""
    come_to!(rate, u, position)

Q, ∂Q/∂t, S and ∂S/∂z of a state and a position.
"""
function come_to!(rate::TermsRate, u, position)
    (; inflow, area, area_slope, flow, area_here, area_slope_here) = rate
    flow .= inflow .+ u
    change_in_time!(rate.flow_rate, flow, rate.terms.period)
    drive!(area_here, area, rate.layers.z, position)
    drive!(area_slope_here, area_slope, rate.layers.z, position)
    return rate
end

"""
    change_in_time!(change, flow, period)

∂Q/∂t, mL/s², by central differences over the cycle, of Q (time, case): antisymmetric, so
that its transpose is its negative.
"""
function change_in_time!(change, flow, period)
    n = size(flow, 1)
    per_difference = n / (2 * period)
    @inbounds for case in axes(flow, 2), t in 1:n
        before, after = t == 1 ? n : t - 1, t == n ? 1 : t + 1
        change[t, case] = per_difference * (flow[after, case] - flow[before, case])
    end
    return change
end

"""
    back_through_terms!(parts, problem, number, by_slope)

[`back!`](@ref) of the right-hand side with terms, `by_slope` (time, case).
"""
function back_through_terms!(parts, problem::FlowProblem, number::Int, by_slope)
    (; network, room, inflow) = problem
    rate, last = problem.terms, network.matrices[end]
    (; flow, area_here, area_slope_here, flow_rate, by_flow_rate, back_in_time) = rate
    (; convection, inertia, period) = rate.terms
    columns = block(number, size(inflow, 2))
    mul!(parts[end], by_slope, view(room.activations.after[end], :, columns)', 1.0, 1.0)
    mul!(rate.by_hidden, last', by_slope)
    back_through_layers!(problem, number, rate.by_hidden)

    come_to!(rate, view(room.inputs, :, columns), room.positions[number])
    change = room.change
    iszero(convection) || (change .+= convection .* area_slope_here ./ area_here .* by_slope)
    if !iszero(inertia)
        by_flow_rate .= .-inertia .* area_here ./ flow .* by_slope
        change .-= by_flow_rate .* flow_rate ./ flow
        change .-= change_in_time!(back_in_time, by_flow_rate, period)
    end
    return nothing
end
