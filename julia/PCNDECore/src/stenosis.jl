# Pressure drop along a stenosis after Seeley and Young (1976), as in the paper.

"""
    drop_coefficients(area_undeformed, physics)

Coefficients `(viscous, turbulent)` of one case's pressure drop, dyn/cm²:

    Δp = viscous·Q + K_t·turbulent·Q·|Q|

The healthy area is that of the first point, the throat's area is the smallest one. One Q of
the paper's viscous term cancels against its Reynolds number. Q·|Q| instead of Q² makes the
loss oppose reversed flow. `area_undeformed` is S_u, cm², (z).
"""
function drop_coefficients(area_undeformed, physics::Physics)
    healthy, throat = first(area_undeformed), minimum(area_undeformed)
    diameter = sqrt(4 / π * healthy)
    k_v = 32 * physics.stenosis_length / diameter * (healthy / throat)^2
    viscous = k_v * physics.viscosity / (healthy * diameter)
    turbulent = 0.5 * physics.density / healthy^2 * (healthy / throat - 1)^2
    return viscous, turbulent
end
