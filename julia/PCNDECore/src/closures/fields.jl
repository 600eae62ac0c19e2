# Functions of z of one vessel, and the fields of a case: sums of their products with the
# functions of time of `coupling.jl`.

"""
    VesselModes(wall, loss, shear, area_undeformed, z, law, physics)

Functions of z of one vessel, S_u (z), for the parameters of wall, losses and wall shear stress.
Flow, area, pressure and wall shear stress are sums of their products with the functions of time
in [`CoupledCase`](@ref), with the k = 18 modes of the losses.

# Fields

  - `flow`: 1, and the volumes before z that belong to P, to P² and to the modes, (z, 3 + k).
  - `area`: functions of P², of 1, of P and of the modes, (z, 3 + k): (r_u + u_r)² without the
    products of modes.
  - `pressure`: p₀, 1 and the losses' functions of z, (z, 2 + k).
  - `shear`: wall shear stress for the modes, (z, k).
  - `flow_slope`, `area_slope`: derivatives of the modes' columns of flow and area with
    respect to the mean of P, (z, k).
  - `reference_flow`: Q₀ of the losses, mL/s.
"""
struct VesselModes
    flow::Matrix{Float64}
    area::Matrix{Float64}
    pressure::Matrix{Float64}
    shear::Matrix{Float64}
    flow_slope::Matrix{Float64}
    area_slope::Matrix{Float64}
    reference_flow::Float64
end

function VesselModes(wall, loss, shear, area_undeformed, z, law, physics::Physics)
    radius = sqrt.(area_undeformed ./ π)
    uniform = vec(displacement(wall, ones(length(z), 1), area_undeformed, z, law))
    per_pressure = 2π .* radius .* uniform
    volume = cumulative_integral(per_pressure, z)
    coefficients = LossCoefficients(loss, area_undeformed, z, physics)
    share = volume ./ volume[end]
    pressure = spatial_modes(coefficients, share, z)
    momentum = LossParameters(loss).jet_momentum
    terms = ShearTerms(coefficients, momentum, area_undeformed, z, physics)
    radial = displacement(wall, pressure, area_undeformed, z, law)
    square, one = π .* uniform .^ 2, ones(length(z))
    area, slope = 2π .* radius .* radial, 2π .* uniform .* radial
    integrals(modes) = mapslices(mode -> cumulative_integral(mode, z), modes; dims = 1)
    return VesselModes(
        [one volume cumulative_integral(square, z) integrals(area)],
        [square area_undeformed per_pressure area],
        [wall[end] .* one one pressure],
        shear_modes(shear, terms, share),
        integrals(slope),
        slope,
        coefficients.reference_flow,
    )
end

"""
    interpolated(modes, outward)

[`VesselModes`](@ref) at other points; `outward` (point, z) is the interpolation.
"""
function interpolated(modes::VesselModes, outward)
    (; flow, area, pressure, shear, flow_slope, area_slope, reference_flow) = modes
    at_points = map(
        values -> outward * values, (flow, area, pressure, shear, flow_slope, area_slope),
    )
    return VesselModes(at_points..., reference_flow)
end

"""
    FieldWorkspace(n_points, n_times)

Buffers for some time points of a field, (z, time), and for its functions of z, (z, 3 + k).
"""
struct FieldWorkspace
    field::Matrix{Float64}
    in_z::Matrix{Float64}
end

function FieldWorkspace(n_points::Integer, n_times::Integer)
    block = clamp(BLOCK_LENGTH ÷ n_points, 1, n_times)
    return FieldWorkspace(zeros(n_points, block), zeros(n_points, 3 + N_MODES))
end

"""
Approximate number of values of a field that are computed before they are written; they fit
in the processor's first-level cache.
"""
const BLOCK_LENGTH = 2048

"""
    fields!(flow, area, pressure, shear, coupled, vessel, workspace)

Compute flow (mL/s), area (cm²), pressure and the magnitude of the wall shear stress (dyn/cm²) of
one case, each (z, time), as sums of products of functions of z and of time.
"""
function fields!(
    flow, area, pressure, shear, coupled::CoupledCase, vessel::VesselModes,
    workspace::FieldWorkspace,
)
    # The modes of reversed flow, which are the last ones, are zero without reversed flow.
    n_used = 3 + N_MODES - (coupled.has_reversed_flow ? 0 : N_DIRECTED)
    mean = coupled.mean_pressure
    function write!(field, in_z, in_time, rows; magnitude = false)
        n_times = size(field, 2)
        for time_points in Iterators.partition(1:n_times, size(workspace.field, 2))
            @views block = workspace.field[:, 1:length(time_points)]
            @views thin_matmul!(block, in_z[:, 1:length(rows)], in_time[rows, time_points])
            magnitude && (block .= abs.(block))
            @views streaming_copy!(field[:, time_points], block)
        end
    end
    modes_at_mean!(workspace.in_z, vessel.flow, vessel.flow_slope, mean)
    write!(flow, workspace.in_z, coupled.flow, 1:n_used)
    modes_at_mean!(workspace.in_z, vessel.area, vessel.area_slope, mean)
    write!(area, workspace.in_z, coupled.area, 1:n_used)
    write!(pressure, vessel.pressure, coupled.area, 2:n_used)
    write!(shear, vessel.shear, coupled.area, 4:n_used; magnitude = true)
    return nothing
end

"""
    modes_at_mean!(result, functions, slope, mean)

Evaluate a vessel's functions of z, (z, function), at a mean of P; `slope` (z, mode) is the
derivative of the last functions, which belong to the modes.
"""
function modes_at_mean!(result, functions, slope, mean)
    n_other = size(functions, 2) - size(slope, 2)
    @inbounds for column in axes(functions, 2), i in axes(functions, 1)
        change = column > n_other ? mean * slope[i, column - n_other] : 0.0
        result[i, column] = functions[i, column] + change
    end
    return result
end
