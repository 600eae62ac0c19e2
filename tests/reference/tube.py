"""Reference outputs of the 1D solver, from NumPy and SciPy alone.

The solver's equations in space (module ``pcnde_bridge.hemodynamics.solver``: staggered
finite volumes, harmonic means on the faces) are integrated in time by SciPy's Radau method.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import quad, solve_ivp

N_POINTS, N_TIMES, LENGTH = 21, 20, 4.0
Z = np.linspace(0.0, LENGTH, N_POINTS)
DZ = Z[1] - Z[0]
DENSITY, VISCOSITY, K_T = 1.06, 0.04, 1.52
NU = VISCOSITY / DENSITY
HEALTHY = np.pi * 0.04
BLOCKAGE, THROAT, STENOSIS = 0.5, 1.9, 1.0  # fraction of area, cm, cm
MEAN, COSINE, SINE = 1.2, (0.4, -0.15), (0.2, 0.1)  # inflow, mL/s; the period is 1 s


class Linear:
    """p = 4/3·E·h/r₀·(√(S/S_u) − 1)."""

    stiffness = 4 / 3 * 1.5e7 * 0.05 / 0.2

    def pressure(self, area, undeformed):
        return self.stiffness * (np.sqrt(area / undeformed) - 1)

    def area(self, pressure, undeformed):
        return undeformed * (1 + pressure / self.stiffness) ** 2


class Olufsen:
    """p = 4/3·(k₁·exp(k₂·r₀) + k₃)·(1 − √(S_u/S))."""

    def stiffness(self, undeformed):
        return 4 / 3 * (2e7 * np.exp(-22.53 * np.sqrt(undeformed / np.pi)) + 8.65e5)

    def pressure(self, area, undeformed):
        return self.stiffness(undeformed) * (1 - np.sqrt(undeformed / area))

    def area(self, pressure, undeformed):
        return undeformed / (1 - pressure / self.stiffness(undeformed)) ** 2


CASES = {
    # wall, ζ, factor of L_s and of the throat's diameter in K_v, R, R_d, C, p_d
    "linear": (Linear(), 2.0, (1.0, 0.0), (1.0e5, 0.0, 0.0, 4.0e3)),
    "olufsen": (Olufsen(), 9.0, (0.83, 1.64), (2.0e4, 8.0e4, 1.0e-6, 1.0e3)),
}


def inflow(t):
    angles = 2 * np.pi * np.arange(1, 3) * t
    return MEAN + np.cos(angles) @ COSINE + np.sin(angles) @ SINE


def undeformed():
    """S_u of a tube with the narrowing r = r_min + (r₀ − r_min)·sin²(πx/L_s)."""
    x, r_0 = Z - THROAT, 0.2
    r_min = r_0 * np.sqrt(1 - BLOCKAGE)
    narrowed = r_min + (r_0 - r_min) * np.sin(np.pi * x / STENOSIS) ** 2
    return np.pi * np.where(np.abs(x) <= STENOSIS / 2, narrowed, r_0) ** 2


def harmonic(a, b):
    return 2 / (1 / a + 1 / b)


def losses(area_undeformed, zeta, length_factors):
    """Pressure loss per length around each face at S = S_u, per Q and per Q·|Q|."""
    friction = 2 * np.pi * NU * (zeta + 2)
    throat = HEALTHY * (1 - BLOCKAGE)
    d_0, d_s = np.sqrt(4 / np.pi * np.array([HEALTHY, throat]))
    k_v = 32 * (np.array([STENOSIS, d_s]) @ length_factors) / d_0 * (HEALTHY / throat) ** 2
    viscous_drop = k_v * VISCOSITY / (HEALTHY * d_0) * (zeta + 2) / 4
    turbulent_drop = K_T * DENSITY / (2 * HEALTHY**2) * (HEALTHY / throat - 1) ** 2
    viscous, turbulent = np.zeros(N_POINTS - 1), np.zeros(N_POINTS - 1)
    for face in range(1, N_POINTS):
        left, right = Z[face] - DZ / 2, min(Z[face] + DZ / 2, LENGTH)
        nodes = np.unique([left, Z[face], right])

        def inverse_square(z):
            return np.interp(z, Z, area_undeformed**-2.0)

        mean = quad(inverse_square, left, right, points=nodes[1:-1])[0] / (right - left)
        a, b = np.clip([left, right], THROAT - STENOSIS / 2, THROAT + STENOSIS / 2)
        spread = quad(lambda z: (1 + np.cos(2 * np.pi * (z - THROAT) / STENOSIS)) / STENOSIS, a, b)
        spread = spread[0] / (right - left)
        wall = DENSITY * friction * mean * (1 - (b - a) / (right - left))
        viscous[face - 1] = wall + spread * viscous_drop
        turbulent[face - 1] = spread * turbulent_drop
    return viscous, turbulent


def solve(wall, zeta, length_factors, outlet):
    """Return flow and pressure (time, z) of the third cycle."""
    s_u, n = undeformed(), N_POINTS - 1
    cells, end = (s_u[1:] + s_u[:-1]) / 2, s_u[-1]
    faces = harmonic(cells, np.append(cells[1:], end))
    viscous, turbulent = losses(s_u, zeta, length_factors)
    delta = 1 / (1 + zeta)
    r, r_d, c, p_d = outlet
    width = np.append(np.full(n - 1, DZ), DZ / 2)

    def slopes(t, y):
        area, q, capacitor = y[:n], y[n : 2 * n], y[-1]
        flow = np.append(inflow(t), q)
        p_out = capacitor + r * q[-1]
        behind = np.append(area[1:], wall.area(p_out, end))
        center = (flow[1:] + flow[:-1]) / 2
        momentum = np.append(center**2 / area, q[-1] ** 2 / behind[-1])
        pressure = np.append(wall.pressure(area, cells), p_out)
        s = harmonic(area, behind)
        loss = (viscous + turbulent * np.abs(q)) * q * (faces / s) ** 2
        bend = np.diff(flow, 2) / DZ**2
        q_t = -(1 + delta) * np.diff(momentum) / width
        q_t -= s / DENSITY * (np.diff(pressure) / width + loss)
        q_t += NU * np.append(bend, 0.0)  # neglected at the outlet
        p_t = (q[-1] - (capacitor - p_d) / r_d) / c if c else 0.0
        return np.concatenate([-np.diff(flow) / DZ, q_t, [p_t]])

    times = np.arange(N_TIMES) / N_TIMES
    state = np.concatenate([cells, np.zeros(n), [0.0 if c else p_d]])
    # What a tolerance leaves is forgotten within a cycle.
    for start, tolerance in ((0.0, 1e-6), (1.0, 1e-10), (2.0, 1e-10)):
        scale = np.concatenate([cells, np.ones(n), [1e5]])
        found = solve_ivp(
            slopes,
            (start, start + 1),
            state,
            method="Radau",
            t_eval=np.append(start + times, start + 1),
            rtol=tolerance,
            atol=tolerance * scale,
        )
        assert found.success
        state = found.y[:, -1]
    area, q, capacitor = found.y[:n, :-1].T, found.y[n : 2 * n, :-1].T, found.y[-1, :-1]
    flow = np.column_stack([[inflow(t) for t in times], q])
    p = wall.pressure(area, cells)
    inner = (p[:, 1:] + p[:, :-1]) / 2
    pressure = np.column_stack([1.5 * p[:, 0] - 0.5 * p[:, 1], inner, capacitor + r * q[:, -1]])
    return flow, pressure


def compute():
    """Return inputs and outputs by name."""
    result = {"z": Z, "area_undeformed": undeformed()}
    result["inflow"] = np.array([MEAN, *COSINE, *SINE])
    result["stenosis"] = np.array([BLOCKAGE, THROAT, STENOSIS])
    for name, case in CASES.items():
        result[f"{name}_outlet"] = np.array(case[-1])
        result[f"{name}_flow"], result[f"{name}_pressure"] = solve(*case)
    return result
