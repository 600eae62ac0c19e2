"""
    State()

Everything that PCNDECore stores between calls: the objective that Python evaluates
repeatedly, and caches and workspaces of the last prediction. Only [`STATE`](@ref) exists in
a process.

# Fields

  - `objective`: an [`Objective`](@ref), or `nothing`.
  - `vessels`: [`VesselCache`](@ref) of the last predicted model.
  - `harmonics`, `period`: [`Harmonics`](@ref) of the last prediction, and its cycle length, s.
  - `workspaces`: free [`ClosureWorkspace`](@ref)s, one per thread of the last prediction.
  - `lock`: protects `workspaces`, which threads share.
"""
mutable struct State{W <: ClosureWorkspace}
    objective::Any
    vessels::VesselCache
    harmonics::Harmonics
    period::Float64
    const workspaces::Vector{W}
    const lock::ReentrantLock
end

function State()
    # The workspace is there for its type; no prediction fits it.
    workspaces = [ClosureWorkspace(Harmonics(2, 1.0), 2)]
    return State(
        nothing, VesselCache(), Harmonics(2, 1.0), NaN, workspaces, ReentrantLock(),
    )
end

"""
The state of this process.
"""
const STATE = State()

"""
    clear!(state)

Remove everything that is stored.
"""
function clear!(state::State)
    state.objective = nothing
    state.vessels, state.harmonics, state.period = VesselCache(), Harmonics(2, 1.0), NaN
    @lock state.lock empty!(state.workspaces)
    return state
end

"""
    cached_vessels!(state, wall, losses, shear, z, outward, config)

[`VesselCache`](@ref) of the last prediction if it had the same parameters, points and
settings; otherwise a new one, which is stored.
"""
function cached_vessels!(
    state::State, wall, losses, shear, z, outward, config::ClosureConfig,
)
    last = state.vessels
    same =
        (last.wall, last.losses, last.shear) == (wall, losses, shear) &&
        (last.z, last.outward) == (z, outward) &&
        (last.config.wall, last.config.physics) == (config.wall, config.physics)
    same || (state.vessels = VesselCache(wall, losses, shear, z, outward, config))
    return state.vessels
end

"""
    cached_harmonics!(state, n_times, period)

[`Harmonics`](@ref) of the last prediction if they are the same, otherwise new ones, which are
stored.
"""
function cached_harmonics!(state::State, n_times, period)
    same = (period, n_times) == (state.period, state.harmonics.n_times)
    same && return state.harmonics
    state.harmonics, state.period = Harmonics(n_times, period), period
    return state.harmonics
end

"""
    acquire_workspace!(state, harmonics, n_points)

Take a free [`ClosureWorkspace`](@ref) for these harmonics and points, or create one.
"""
function acquire_workspace!(state::State, harmonics::Harmonics, n_points)
    fits(workspace) =
        workspace.harmonics === harmonics && size(workspace.fields.in_z, 1) == n_points
    @lock state.lock begin
        filter!(fits, state.workspaces)
        isempty(state.workspaces) || return pop!(state.workspaces)
    end
    return ClosureWorkspace(harmonics, n_points)
end

"""
    release_workspace!(state, workspace)

Return a workspace to the free ones.
"""
release_workspace!(state::State, workspace) =
    @lock state.lock push!(state.workspaces, workspace)
