@testset "hygiene" begin
    if Base.find_package("Aqua") === nothing
        @info "Aqua is not installed: its checks are left out"
        @test_skip Aqua.test_all(PCNDECore)
    else
        @eval using Aqua
        # The fresh environment of the last check needs a registry.
        Aqua.test_all(PCNDECore; persistent_tasks = false)
    end
end
