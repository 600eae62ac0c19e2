# Static checks of the package; they run where Aqua and ExplicitImports are installed.

@testset "Aqua" begin
    if Base.find_package("Aqua") === nothing
        @info "Aqua is not installed: its checks are skipped"
        @test_skip Aqua.test_all(PCNDECore)
    else
        @eval using Aqua
        # The last check would need a registry for its new environment.
        Aqua.test_all(PCNDECore; persistent_tasks = false)
    end
end
