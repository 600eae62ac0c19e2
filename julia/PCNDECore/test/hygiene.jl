# Static checks of the package; they run where Aqua and ExplicitImports are installed.

include("nonpublic.jl")

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

@testset "ExplicitImports" begin
    if Base.find_package("ExplicitImports") === nothing
        @info "ExplicitImports is not installed: its checks are skipped"
        @test_skip ExplicitImports.check_no_implicit_imports(PCNDECore)
    else
        @eval using ExplicitImports
        ignored = VERSION < v"1.11" ? (DOCUMENTED..., PUBLIC_FROM_1_11...) : DOCUMENTED
        @test check_no_implicit_imports(PCNDECore) === nothing
        @test check_no_stale_explicit_imports(PCNDECore) === nothing
        @test check_no_self_qualified_accesses(PCNDECore) === nothing
        @test check_all_explicit_imports_via_owners(PCNDECore) === nothing
        # Lux reexports both from LuxCore.
        @test check_all_qualified_accesses_via_owners(PCNDECore; ignore = (:apply, :setup)) ===
              nothing
        @test check_all_explicit_imports_are_public(PCNDECore; ignore = ignored) === nothing
        @test check_all_qualified_accesses_are_public(PCNDECore; ignore = ignored) === nothing
    end
end
