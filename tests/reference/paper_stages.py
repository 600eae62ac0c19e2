"""Reference outputs of the paper's stages, from NumPy and SciPy alone.

Equations: section 2.4 and 3.6 of Csala et al. (2024), as in docs/theory.md.  Ordinary
differential equations are solved by the explicit Runge–Kutta method of order 8.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

PERIOD, N_TIMES, N_POINTS, CYCLES, TERMS, PASSES = 0.8, 16, 13, 3, 6, 3
TERMS_OF_FLOW = ("friction", "convection", "inertia")
FLOW_WIDTHS = (2 * N_TIMES, 6, 5, N_TIMES)
PRESSURE_WIDTHS = (4 * N_POINTS, 3, N_POINTS)
TEMPORAL_WIDTHS = (N_POINTS + 1, 6, N_POINTS)

DENSITY, VISCOSITY = 1.06, 0.04
YOUNG_MODULUS, THICKNESS = 1.5e7, 0.05
P_REF, K_T = 133_322.0, 1.52
STENOSIS_LENGTH, STENOSIS_POSITION = 0.5, 2.0


def integrate(rate, start, end, state):
    """Solve dy/dx = rate(x, y) from start to end at the tightest tolerance."""
    found = solve_ivp(rate, (start, end), state, method="DOP853", rtol=1e-13, atol=1e-15)
    assert found.success
    return found.y[:, -1]


def network(parameters, widths, x):
    """Evaluate a dense network with tanh between its layers; weights are column by column."""
    for i, (n_in, n_out) in enumerate(pairwise(widths)):
        weights, parameters = parameters[: n_in * n_out], parameters[n_in * n_out :]
        bias, parameters = parameters[:n_out], parameters[n_out:]
        x = weights.reshape(n_out, n_in, order="F") @ x + bias
        if i < len(widths) - 2:
            x = np.tanh(x)
    return x


def weights_of(widths, rng):
    """Draw weights and biases of a network, in its layout."""
    return np.concatenate([rng.normal(size=n * m + m) / np.sqrt(n) for n, m in pairwise(widths)])


def slope(values, z):
    """Second-order derivative in z, along the last axis."""
    return np.gradient(values, z, axis=-1, edge_order=2)


def flow(parameters, inflow, area, z, terms=()):
    """Integrate ∂Q/∂z = f(Q, S) and physics terms of one case from point to point; (time, z)."""
    area_slope, nu = slope(area, z), VISCOSITY / DENSITY
    delta = 1 / 3
    found = [inflow]
    for k in range(len(z) - 1):

        def rate(at, q, k=k):
            share = (at - z[k]) / (z[k + 1] - z[k])
            s = (1 - share) * area[:, k] + share * area[:, k + 1]
            change = network(parameters, FLOW_WIDTHS, np.concatenate([q, s]))
            if "friction" in terms:
                change = change - 8 * np.pi * nu / (2 * (1 + delta))
            if "convection" in terms:
                s_z = (1 - share) * area_slope[:, k] + share * area_slope[:, k + 1]
                change = change + q / s * s_z / 2
            if "inertia" in terms:
                q_t = (np.roll(q, -1) - np.roll(q, 1)) / (2 * PERIOD / N_TIMES)
                change = change - s / q * q_t / (2 * (1 + delta))
            return change

        found.append(integrate(rate, z[k], z[k + 1], found[-1]))
    return np.stack(found, axis=1)


def intermediate_area(parameters, flow, area_undeformed, z):
    """Integrate ∂Ŝ/∂t = −â ∂Q/∂z + b̂ over the cycles, Q linear between time points; (time, z)."""
    a, b = np.split(parameters, 2)
    q_z, step = slope(flow, z), PERIOD / N_TIMES
    found = [area_undeformed]
    for i in range(CYCLES * N_TIMES - 1):
        before, after = q_z[i % N_TIMES], q_z[(i + 1) % N_TIMES]

        def rate(t, _, before=before, after=after):
            return -a * (before + t / step * (after - before)) + b

        found.append(integrate(rate, 0.0, step, found[-1]))
    return np.array(found)


def fourier_area(parameters, flow, initial_area, z):
    """Sum the series S_n = −a/(iω_n) ∂Q_n/∂z, S₀ = Ŝ(t=0) − Σ S_n + b; (time, z)."""
    a, b = np.split(parameters, 2)
    time = np.arange(N_TIMES) * PERIOD / N_TIMES
    area = np.zeros_like(flow, dtype=complex)
    for n in range(-TERMS + 1, TERMS):
        if n == 0:
            continue
        omega = 2 * np.pi * n / PERIOD
        q_n = (flow * np.exp(-1j * omega * time)[:, None]).mean(axis=0)
        s_n = -a / (1j * omega) * slope(q_n, z)
        area += s_n * (np.exp(1j * omega * time)[:, None] - 1)
    return area.real + initial_area + b


def pressure_drop(flow, area_undeformed, k_t):
    """Seeley and Young's drop, its turbulent part with the sign of the flow."""
    s_d, s_s = area_undeformed[0], area_undeformed.min()
    d_0 = np.sqrt(4 * s_d / np.pi)
    k_v = 32 * STENOSIS_LENGTH / d_0 * (s_d / s_s) ** 2
    reynolds = DENSITY * np.abs(flow) * d_0 / (s_d * VISCOSITY)
    viscous = DENSITY * flow * np.abs(flow) / s_d**2 * k_v / reynolds
    turbulent = k_t * DENSITY * flow * np.abs(flow) / (2 * s_d**2) * (s_d / s_s - 1) ** 2
    return viscous + turbulent


def temporal_pressure(parameters, flow, area, area_undeformed):
    """p̂* = 1 + E·h/(r₀·p_ref)·g(S, S − S_u, Δp/p_ref, Q) at each time point; (time, z)."""
    scale = YOUNG_MODULUS * THICKNESS / np.sqrt(area_undeformed[0] / np.pi) / P_REF
    drop = pressure_drop(flow, area_undeformed, K_T) / P_REF
    inputs = np.concatenate([area, area - area_undeformed, drop, flow], axis=1)
    return np.array([1 + scale * network(parameters, PRESSURE_WIDTHS, x) for x in inputs])


def spatial_pressure(parameters, temporal, flow, area_undeformed, z, form):
    """p* of the mean of p̂*: constant, tanh around the stenosis, constant; (time, z)."""
    a_1, a_2, (b_1, b_2) = parameters[0], parameters[1], np.split(parameters[2:], 2)
    result = np.empty_like(flow)
    start, length = z[0], z[-1] - z[0]
    for i in range(N_TIMES):
        q = np.interp(STENOSIS_POSITION, z, flow[i])
        drop = pressure_drop(q, area_undeformed, K_T + a_2) / P_REF + b_1[i]
        for k, at in enumerate(z):
            inside = min(max(at, start + length / 3), start + 2 * length / 3)
            step = np.tanh(10 * b_2[i] * (inside - STENOSIS_POSITION))
            if form == "continuous":
                step = step / 2
            elif at <= start + length / 3:
                step = 0.0
            result[i, k] = temporal[i].mean() + a_1 - drop * step
    return result


def temporal_flow(parameters, inflow, initial_flow, steps):
    """Integrate ∂Q/∂t = f(Q, t/T); after each step the inlet's value is Q_in; (time, z)."""
    h = PERIOD / N_TIMES / steps

    def rate(t, q):
        return network(parameters, TEMPORAL_WIDTHS, np.append(q, t / PERIOD))

    q = initial_flow.copy()
    q[0] = inflow[0]
    found = [q]
    for i in range(N_TIMES - 1):
        for j in range(steps):
            t = (i * steps + j) * h
            q = integrate(rate, t, t + h, q)
            share = (j + 1) / steps
            q[0] = (1 - share) * inflow[i] + share * inflow[i + 1]
        found.append(q.copy())
    return np.array(found)


def model(parameters, inflow, area_undeformed, z):
    """Three passes of flow and area, then the pressure of one case."""
    area = np.repeat(area_undeformed[None], N_TIMES, axis=0)
    for _ in range(PASSES):
        q = flow(parameters["flow"], inflow, area, z)
        intermediate = intermediate_area(parameters["intermediate_area"], q, area_undeformed, z)
        # The cycles end at their last time point, which anchors the series.
        area = fourier_area(parameters["fourier_area"], q, intermediate[-1], z)
    temporal = temporal_pressure(parameters["temporal_pressure"], q, area, area_undeformed)
    pressure = spatial_pressure(
        parameters["spatial_pressure"], temporal, q, area_undeformed, z, "continuous"
    )
    return q, area, P_REF * pressure


def compute():
    """Return inputs, parameters and outputs of three cases by name."""
    rng = np.random.default_rng(20240917)
    z = np.linspace(0.0, 4.0, N_POINTS)
    z = z + 0.03 * np.sin(np.pi * z)
    phase = 2 * np.pi * np.arange(N_TIMES) / N_TIMES
    blockage, swing = np.array([0.0, 0.4, 0.6]), np.array([0.3, -0.5, 1.6])
    undeformed = 0.125 * (1 - blockage[:, None] * np.exp(-(((z - 2) / 0.5) ** 2)))
    wave = np.cos(phase) + 0.4 * np.sin(2 * phase) + 0.2 * np.cos(3 * phase + 1)
    inflow = 1.2 + swing[:, None] * wave
    area = undeformed[:, None] * (1 + 0.04 * np.cos(phase[:, None] - 0.5 * z))
    given_flow = inflow[:, :, None] * (1 - 0.03 * z) + 0.02 * np.sin(phase[:, None] + z)
    parameters = {
        "flow": 0.2 * weights_of(FLOW_WIDTHS, rng),
        "intermediate_area": np.append(1 + 0.1 * rng.normal(size=13), 1e-3 * rng.normal(size=13)),
        "fourier_area": np.append(1 + 0.1 * rng.normal(size=13), 1e-3 * rng.normal(size=13)),
        "temporal_pressure": 0.3 * weights_of(PRESSURE_WIDTHS, rng),
        "spatial_pressure": np.concatenate(
            [[0.03, 0.2], 0.02 * rng.normal(size=16), 1 + 0.2 * rng.normal(size=16)]
        ),
        "temporal_flow": 0.5 * weights_of(TEMPORAL_WIDTHS, rng),
    }
    p = parameters

    def each(function, *arrays):
        return np.array([function(*case) for case in zip(*arrays, strict=True)])

    # The inertia term is infinite where the flow passes zero: two cases, with more inflow.
    terms = each(lambda q, s: flow(p["flow"], q, s, z, TERMS_OF_FLOW), inflow[:2] + 2.0, area[:2])
    temporal = each(
        lambda *case: temporal_pressure(p["temporal_pressure"], *case), given_flow, area, undeformed
    )
    spatial = {
        form: each(
            lambda *case, form=form: spatial_pressure(p["spatial_pressure"], *case, z, form),
            temporal,
            given_flow,
            undeformed,
        )
        for form in ("continuous", "printed")
    }
    whole = [model(p, q, s, z) for q, s in zip(inflow, undeformed, strict=True)]
    return {
        "z": z,
        "period": PERIOD,
        "inflow": inflow,
        "area_undeformed": undeformed,
        "area": area,
        "given_flow": given_flow,
        **{f"parameters_{name}": vector for name, vector in parameters.items()},
        "flow": each(lambda q, s: flow(p["flow"], q, s, z), inflow, area),
        "flow_with_terms": terms,
        "intermediate_area": each(
            lambda q, s: intermediate_area(p["intermediate_area"], q, s, z), given_flow, undeformed
        ),
        "fourier_area": each(
            lambda q, s: fourier_area(p["fourier_area"], q, s, z), given_flow, undeformed
        ),
        "temporal_pressure": temporal,
        **{f"spatial_pressure_{form}": values for form, values in spatial.items()},
        "temporal_flow": each(
            lambda q, s: temporal_flow(p["temporal_flow"], q, s, 4), inflow, given_flow[:, 0]
        ),
        **{
            f"model_{name}": np.array([case[i] for case in whole])
            for i, name in enumerate(("flow", "area", "pressure"))
        },
    }
