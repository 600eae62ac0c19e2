# Static checks of the package; they run where Aqua, ExplicitImports and JET are installed.

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
        newer = VERSION < v"1.11" ? PUBLIC_FROM_1_11 : ()
        ignored = (DOCUMENTED..., OF_THE_EXTENSION..., newer...)
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

@testset "JET: hot path" begin
    # What the compiler infers depends on the version of Julia; JET was run on 1.10 and 1.11.
    if Base.find_package("JET") === nothing || VERSION >= v"1.12"
        @info "JET is not installed, or Julia is newer than 1.11: the hot path is not analyzed"
        @test_skip JET.report_opt(value_and_gradient!)
    else
        @eval using JET
        V, M = Vector{Float64}, Matrix{Float64}
        config = PCNDECore.Config()
        undeformed, flow = data.area_undeformed, data.flow
        objectives = [
            PCNDECore.problem(stage, inputs, flow, z, 1.0, config) for (stage, inputs) in (
                "flow" => (data.inflow, data.area),
                "intermediate_area" => (flow, undeformed),
                "fourier_area" => (flow, undeformed),
                "temporal_pressure" => (flow, data.area, undeformed),
                "spatial_pressure" => (flow, flow, undeformed),
                "temporal_flow" => (data.inflow, flow[:, 1, :]),
            )
        ]
        hot_path = Any[(value_and_gradient!, (V, typeof(o), V)) for o in objectives]
        push!(hot_path, (first(objectives).rate, (M, M, Nothing, Float64)))
        # Dynamic dispatch, and calls without a method.
        for (f, types) in hot_path, report in (JET.report_opt, JET.report_call)
            result = @invokelatest report(f, types; target_modules = (PCNDECore,))
            @test isempty(@invokelatest JET.get_reports(result))
        end
    end
end
