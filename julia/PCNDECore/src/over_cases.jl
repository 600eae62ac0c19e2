"""
    Parts(n, each)

Ranges of `each` numbers that make up `1:n`. Threads share it: whoever iterates takes the next,
so that one which the machine holds up leaves more to the others.
"""
struct Parts
    next::Threads.Atomic{Int}
    n::Int
    each::Int
end

Parts(n::Integer, each::Integer) = Parts(Threads.Atomic{Int}(1), n, each)

Base.IteratorSize(::Type{Parts}) = Base.SizeUnknown()
Base.eltype(::Type{Parts}) = UnitRange{Int}

function Base.iterate(parts::Parts, _ = nothing)
    first = Threads.atomic_add!(parts.next, parts.each)
    first > parts.n && return nothing
    return first:min(first + parts.each - 1, parts.n), nothing
end

"""
    over_cases(work, n_cases, each = 1)

Call `work(parts)` in each of Julia's threads at the same time; the [`Parts`](@ref), ranges of
`each` cases, make up `1:n_cases` over all of them. What one of them throws is thrown on.
"""
function over_cases(work, n_cases::Integer, each::Integer = 1)
    parts = Parts(n_cases, each)
    n_tasks = min(Threads.nthreads(), cld(n_cases, each))
    # With one thread nothing is left to Julia's scheduler.
    n_tasks == 1 && return work(parts)
    tasks = [Threads.@spawn work(parts) for _ in 1:n_tasks]
    # None goes on after this returns or throws: they write into memory of the caller.
    interrupted = nothing
    for task in tasks
        while !istaskdone(task)
            try
                wait(task)
            catch error
                error isa TaskFailedException || (interrupted = error)
            end
        end
    end
    interrupted === nothing || throw(interrupted)
    failed = findfirst(istaskfailed, tasks)
    # What was thrown in the task, not that a task failed.
    failed === nothing || throw(tasks[failed].exception)
    return nothing
end
