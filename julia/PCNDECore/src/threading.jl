"""
    CaseBatches(n_cases, batch_size)

Iterator over ranges of at most `batch_size` cases that make up `1:n_cases`. Threads share
one iterator: each takes the next range, so that a delayed thread leaves more to the others.
"""
struct CaseBatches
    next::Threads.Atomic{Int}
    n_cases::Int
    batch_size::Int
end

function CaseBatches(n_cases::Integer, batch_size::Integer)
    return CaseBatches(Threads.Atomic{Int}(1), n_cases, batch_size)
end

Base.IteratorSize(::Type{CaseBatches}) = Base.SizeUnknown()
Base.eltype(::Type{CaseBatches}) = UnitRange{Int}

function Base.iterate(batches::CaseBatches, _ = nothing)
    first = Threads.atomic_add!(batches.next, batches.batch_size)
    first > batches.n_cases && return nothing
    return first:min(first + batches.batch_size - 1, batches.n_cases), nothing
end

"""
    threaded_batches(work, n_cases, batch_size = 1)

Call `work(batches)` once in each of Julia's threads at the same time. Together, the calls
iterate over all [`CaseBatches`](@ref). An exception in `work` is rethrown after all threads
have ended.
"""
function threaded_batches(work, n_cases::Integer, batch_size::Integer = 1)
    batches = CaseBatches(n_cases, batch_size)
    n_tasks = min(Threads.nthreads(), cld(n_cases, batch_size))
    # A single thread runs without Julia's scheduler.
    n_tasks == 1 && return work(batches)
    tasks = [Threads.@spawn work(batches) for _ in 1:n_tasks]
    # Wait for all tasks, even after an error: they write into the caller's memory.
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
    # Throw the original exception instead of a TaskFailedException.
    failed === nothing || throw(tasks[failed].exception)
    return nothing
end
