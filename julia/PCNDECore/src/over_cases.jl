"""
    over_cases(work, n_cases)

Call `work(cases)` with ranges that make up `1:n_cases`, one for each of Julia's threads
and all at the same time; what one of them throws is thrown on.
"""
function over_cases(work, n_cases::Integer)
    each = max(1, cld(n_cases, Threads.nthreads()))
    ranges = collect(Iterators.partition(1:n_cases, each))
    # With one thread nothing is left to Julia's scheduler.
    length(ranges) == 1 && return work(only(ranges))
    tasks = [Threads.@spawn work(cases) for cases in ranges]
    try
        foreach(wait, tasks)
    catch error
        # What was thrown in the task, not that a task failed.
        throw(error isa TaskFailedException ? error.task.exception : error)
    end
    return nothing
end
