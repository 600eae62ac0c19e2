@testset "L-BFGS" begin
    scale, trials = [1.0, 10.0, 100.0], Vector{Float64}[]
    function bowl(x, result)
        push!(trials, x)
        result[1] = sum(scale .* (x .- 1) .^ 2)
        result[2:end] .= 2 .* scale .* (x .- 1)
        return nothing
    end
    seen = Tuple{Vector{Float64}, Float64}[]
    lbfgs(bowl, zeros(3), 10, 50, (x, loss) -> push!(seen, (x, loss)))
    @test seen[end][1] ≈ ones(3) atol = 1e-7
    @test issorted(last.(seen); rev = true) && length(seen) <= 50
    @test allunique(trials) && trials[1] == zeros(3)
    @test norm(trials[2]) ≈ 1
    empty!(seen)
    lbfgs(bowl, zeros(3), 10, 4, (x, loss) -> push!(seen, (x, loss)))
    @test length(seen) == 4
    @test_throws ErrorException("enough") lbfgs(
        bowl,
        zeros(3),
        10,
        9,
        (_, _) -> error("enough"),
    )
    @test_throws ErrorException("broken") lbfgs(
        (_, _) -> error("broken"),
        zeros(3),
        10,
        9,
        bowl,
    )
    # A region of high loss, like that of the Python package where a loss is not finite: the
    # best step before it is accepted.
    latest = Ref(fill(-40.0, 3))
    function cliff(x, result)
        maximum(x) > 1.5 || return bowl(x, result)
        offset = x .- latest[]
        result[1] = 1e7
        result[2:end] .= offset .* (2e7 / sum(abs2, offset))
        return nothing
    end
    lbfgs(cliff, latest[], 20, 100, (x, _) -> latest[] = x)
    @test latest[] ≈ ones(3) atol = 1e-5
    # A point with another rounding is not evaluated again.
    point = PCNDECore.CachedObjective(bowl, fill(NaN, 3), zeros(4))
    empty!(trials)
    PCNDECore.evaluate!(point, [1 / 3, 0.2, 0.1])
    PCNDECore.evaluate!(point, [nextfloat(1 / 3), 0.2, 0.1])
    @test length(trials) == 1
    PCNDECore.evaluate!(point, [1 / 3 + 1e-9, 0.2, 0.1])
    @test length(trials) == 2
end
