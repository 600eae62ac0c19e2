"""Reference outputs of the closures of preset ``physics``, from NumPy and SciPy alone.

Equations: docs/closures.md.  Wall and losses are solved without any grid, as a boundary
value problem and by adaptive quadrature, and again on the grid.  The coupled prediction
uses the grid's points and time points, but none of the engines' simplifications: areas
follow from the whole displacement, and losses from the flow at every point.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.integrate import cumulative_trapezoid, quad_vec, solve_bvp
from scipy.optimize import brentq, newton_krylov
from scipy.special import expit

LENGTH, PERIOD, N_POINTS, N_TIMES = 4.0, 0.8, 41, 32
Z = np.linspace(0.0, LENGTH, N_POINTS)
TIME = np.arange(N_TIMES) * PERIOD / N_TIMES
DENSITY, VISCOSITY = 1.06, 0.04
HEALTHY, WIDTH, THROAT = 0.125, 0.4, 1.8  # Gaussian stenoses: cm², cm, cm
BLOCKAGES = np.array([0.3, 0.6])
HIDDEN = 4

OUTLET = np.array([2.0e4, 8.0e4, 1.0e-6, 5.0e3])
LOSSES = np.array([1.2, 1.1, 0.9, 0.06])
MEMBRANE = np.array([1.0e6, 0.45, 0.2, 1.0, 2.0e3])
LOCAL = np.array([1.0e6, 0.5, 2.0e3])


def radius(z, blockage):
    """Return the undeformed radius and its derivative in z."""
    bump = np.exp(-(((z - THROAT) / WIDTH) ** 2))
    r = np.sqrt(HEALTHY / np.pi * (1 - blockage * bump))
    return r, HEALTHY / np.pi * blockage * bump * (z - THROAT) / WIDTH**2 / r


def area_undeformed(z, blockage):
    return np.pi * radius(z, blockage)[0] ** 2


def rate(signal):
    """Differentiate periodic signals (time, ...) by their Fourier series."""
    i_omega = 2j * np.pi / PERIOD * np.arange(N_TIMES // 2 + 1)
    i_omega[-1] = 0.0  # the harmonic of alternating signs has no slope at the time points
    spectrum = np.fft.rfft(signal, axis=0)
    return np.fft.irfft((i_omega * spectrum.T).T, n=N_TIMES, axis=0)


# ---- pressure losses -----------------------------------------------------------------


def inverse_jet_slope(z, blockage, spread):
    """d(1/A_j)/dz at z of a flow towards larger z, and where the jet begins and ends."""
    steepest = brentq(
        lambda at: radius(at + 1e-5, blockage)[1] - radius(at - 1e-5, blockage)[1],
        THROAT + 0.1 * WIDTH,
        THROAT + 2 * WIDTH,
    )
    begin = brentq(lambda at: radius(at, blockage)[1] - spread, THROAT, steepest, xtol=1e-14)
    r_0 = radius(begin, blockage)[0]

    def gap(at):
        return radius(at, blockage)[0] - r_0 - spread * (at - begin)

    end = brentq(gap, begin + 1e-3, LENGTH, xtol=1e-14)
    r, slope = radius(z, blockage)
    jet = begin < z < end
    r, slope = (r_0 + spread * (z - begin), spread) if jet else (r, slope)
    return -2 * slope / (np.pi * r**3), (begin, end)


def losses(q, d, blockage):
    """p − p(L) of the flow Q = q(t) − x(z)·d(t), x = z/L + sin(πz/L)/10; (time, z)."""
    friction, inertia, convection, spread = LOSSES

    def densities(z):
        s, x = area_undeformed(z, blockage), z / LENGTH + np.sin(np.pi * z / LENGTH) / 10
        forward, _ = inverse_jet_slope(z, blockage, spread)
        # Seen from the outlet the vessel is mirrored about its throat.
        back, _ = inverse_jet_slope(2 * THROAT - z, blockage, spread)
        smooth = np.array([1.0, -x])
        square = np.array([1.0, -2 * x, x**2])
        return np.concatenate(
            [
                friction * 8 * np.pi * VISCOSITY / s**2 * smooth,
                inertia * DENSITY / s * smooth,
                convection * DENSITY / s * forward * square,
                convection * DENSITY / s * -back * square,
            ]
        )

    _, ends = inverse_jet_slope(0.0, blockage, spread)
    kinks = (*ends, *(2 * THROAT - np.array(ends)))
    pieces = [
        quad_vec(densities, a, b, epsabs=1e-11, epsrel=1e-11, points=kinks)[0]
        for a, b in pairwise(Z)
    ]
    in_z = np.append(np.cumsum(pieces[::-1], axis=0)[::-1], np.zeros((1, 10)), axis=0)
    squares = np.array([q * q, q * d, d * d])
    forward = q - d / 2 > 0
    in_t = np.concatenate([[q, d, rate(q), rate(d)], squares * forward, squares * ~forward])
    return in_t.T @ in_z.T


# ---- wall ----------------------------------------------------------------------------


def membrane(loads, blockage):
    """Radial displacements (load, z) of the clamped membrane under loads(z), dyn/cm².

    Stationary energy: d(r·(N t + k γ n))/ds = N_θ e_r + f r u_z e_z − r p/K n, with the
    strains ε_s = t·du/ds, ε_θ = u_r/r, γ = n·du/ds, and N = ε_s + ν ε_θ, N_θ = ε_θ + ν ε_s.
    """
    stiffness, nu, shear, support, _ = MEMBRANE

    def solve(load):
        def slopes(z, y):
            u_z, u_r, force_z, force_r = y
            r, r_z = radius(z, blockage)
            ds = np.hypot(1, r_z)
            cos, sin = 1 / ds, r_z / ds  # t = (cos, sin), n = (−sin, cos)
            around = u_r / r
            along = (force_z * cos + force_r * sin) / r - nu * around
            across = (-force_z * sin + force_r * cos) / (shear * r)
            p = load(z) / stiffness
            return ds * np.array(
                [
                    along * cos - across * sin,
                    along * sin + across * cos,
                    support * r * u_z + r * p * sin,
                    around + nu * along - r * p * cos,
                ]
            )

        def clamped(left, right):
            return np.array([left[0], left[1], right[0], right[1]])

        z = np.linspace(0.0, LENGTH, 2001)
        found = solve_bvp(slopes, clamped, z, np.zeros((4, z.size)), tol=1e-11, max_nodes=200_000)
        assert found.success
        return found.sol(Z)[1]

    return np.array([solve(load) for load in loads])


LOADS = (lambda z: 1e5 * (1 - z / 8), lambda z: 2e4 * np.sin(2 * z + 0.3))


# ---- all coupled ---------------------------------------------------------------------


def membrane_matrix(blockage):
    """Matrix from p − p₀ at the points to u_r there: linear elements, two Gauss points."""
    stiffness, nu, shear, support, _ = MEMBRANE
    r = radius(Z, blockage)[0]
    matrix, load = np.zeros((2 * N_POINTS, 2 * N_POINTS)), np.zeros((2 * N_POINTS, N_POINTS))
    for i in range(N_POINTS - 1):
        h = np.hypot(Z[i + 1] - Z[i], r[i + 1] - r[i])
        t = np.array([Z[i + 1] - Z[i], r[i + 1] - r[i]]) / h
        n = np.array([-t[1], t[0]])
        dofs = slice(2 * i, 2 * i + 4)
        for x in (0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3)):
            r_x = (1 - x) * r[i] + x * r[i + 1]
            strains = np.array(
                [
                    np.append(-t, t) / h,
                    np.array([0, 1 - x, 0, x]) / r_x,
                    np.append(-n, n) / h,
                    [1 - x, 0, x, 0],
                ]
            )
            law = np.diag([1, 1, shear, support])
            law[0, 1] = law[1, 0] = nu
            matrix[dofs, dofs] += stiffness * r_x * h / 2 * strains.T @ law @ strains
            virtual = np.append((1 - x) * n, x * n)
            load[dofs, i : i + 2] += r_x * h / 2 * np.outer(virtual, [1 - x, x])
    displacement = np.zeros_like(load)
    displacement[2:-2] = np.linalg.solve(matrix[2:-2, 2:-2], load[2:-2])
    return displacement[1::2]


def drop_on_grid(flow, blockage, loss):
    """p − p(L) (time, z) of a flow on the grid: trapezoidal rule, jets interval by interval."""
    friction, inertia, convection, spread = loss
    s = area_undeformed(Z, blockage)

    def inverse_jet(s_u):
        r = np.sqrt(s_u / np.pi)
        for i in range(1, N_POINTS):
            r[i] = min(r[i], r[i - 1] + spread * (Z[1] - Z[0]))
        return 1 / (np.pi * r**2)

    middle = (flow[:, 1:] + flow[:, :-1]) / 2
    forward, back = np.diff(inverse_jet(s)), np.diff(inverse_jet(s[::-1])[::-1])
    jets = convection * DENSITY * (1 / s[1:] + 1 / s[:-1]) / 2 * middle**2
    jets = jets * np.where(middle > 0, forward, back)
    smooth = friction * 8 * np.pi * VISCOSITY / s**2 * flow + inertia * DENSITY / s * rate(flow)
    until = cumulative_trapezoid(smooth, Z, initial=0)
    until[:, 1:] += np.cumsum(jets, axis=1)
    return until[:, -1:] - until


def hidden_share(correction, pressure_rate, flow, shift):
    """g = c·sigmoid(network(u, y) + shift), each input over its scale."""
    _, ceiling, u_scale, y_scale = correction[:4]
    first, bias, last = np.split(correction[4:-1], [2 * HIDDEN, 3 * HIDDEN])
    x = np.stack([pressure_rate / u_scale, flow / y_scale], axis=1)
    logit = np.tanh(x @ first.reshape(2, HIDDEN) + bias) @ last + correction[-1]
    return ceiling * expit(logit + shift)


def coupled(inflow, blockage, shift, loss, correction):
    """Solve ∂Q/∂z = −κ(1 − g)∂S/∂t with wall, losses and outlet; flow, area, pressure."""
    r_1, r_2, compliance, p_d = OUTLET
    kappa, p_0 = correction[0], MEMBRANE[-1]
    omega = 2 * np.pi / PERIOD * np.arange(N_TIMES // 2 + 1)
    impedance = r_1 + r_2 / (1 + 1j * omega * r_2 * compliance)
    impedance[-1] = impedance[-1].real
    to_wall, r = membrane_matrix(blockage), radius(Z, blockage)[0]

    # Passive linear tube: all of the vessel has the outlet's pressure.
    volume = np.trapezoid(2 * np.pi * r * to_wall.sum(axis=1), Z)
    i_omega = 1j * omega
    i_omega[-1] = 0.0
    passive = np.fft.rfft(inflow) / (1 + kappa * volume * i_omega * impedance)
    passive_rate = np.fft.irfft(i_omega * impedance * passive, n=N_TIMES)
    g = hidden_share(correction, passive_rate, np.fft.irfft(passive, n=N_TIMES), shift)

    def fields(flow):
        outlet = np.fft.irfft(impedance * np.fft.rfft(flow[:, -1]), n=N_TIMES) + p_d
        pressure = outlet[:, None] + drop_on_grid(flow, blockage, loss)
        return np.pi * (r + (pressure - p_0) @ to_wall.T) ** 2, pressure

    def residual(flow):
        area, _ = fields(flow)
        filling = cumulative_trapezoid(rate(area), Z, initial=0)
        return inflow[:, None] - kappa * (1 - g)[:, None] * filling - flow

    start = np.repeat(inflow[:, None], N_POINTS, axis=1)
    flow = newton_krylov(residual, start, f_tol=1e-11, inner_maxiter=60)
    return flow, *fields(flow)


def compute():
    """Return inputs, parameters and outputs by name."""
    rng = np.random.default_rng(20240918)
    phase = 2 * np.pi * TIME / PERIOD
    correction = np.concatenate([[1.3, 0.8, 1.0e6, 1.0], rng.normal(size=17)])
    q = 1.3 + 0.5 * np.cos(phase) + 0.2 * np.sin(2 * phase) + 0.1 * np.cos(3 * phase + 1)
    d = 0.1 * np.sin(phase) + 0.05 * np.cos(2 * phase)
    x = Z / LENGTH + np.sin(np.pi * Z / LENGTH) / 10
    signs = (1, -1)  # the second case flows backwards
    moved = [membrane(LOADS, b) for b in BLOCKAGES]
    loads = np.array([load(Z) for load in LOADS])
    in_time = np.stack([1 + 0.3 * np.cos(phase), np.sin(phase)], axis=1)
    r = radius(Z, BLOCKAGES[:, None])[0]
    local = r * (r / r[:, :1]) ** LOCAL[1] / LOCAL[0]
    inflow = 1.2 + np.array([0.3, 0.6])[:, None] * (q - q.mean())
    shift = np.array([0.4, -0.7])
    cases = list(zip(inflow, BLOCKAGES, shift, strict=True))
    outputs = {}
    flows = np.array([s * (q[:, None] - x * d[:, None]) for s in signs])
    outputs["losses_on_grid"] = np.array(
        [drop_on_grid(q, b, LOSSES) for q, b in zip(flows, BLOCKAGES, strict=True)]
    )
    on_grid = np.array([in_time @ loads @ membrane_matrix(b).T for b in BLOCKAGES])
    outputs["membrane_area_on_grid"] = np.pi * (r[:, None] + on_grid) ** 2
    for name, loss in (("coupled", LOSSES), ("coupled_weak", LOSSES * [1e-4, 1e-4, 1e-4, 1])):
        found = [coupled(*case, loss, correction) for case in cases]
        for i, quantity in enumerate(("flow", "area", "pressure")):
            outputs[f"{name}_{quantity}"] = np.array([case[i] for case in found])
    return {
        "z": Z,
        "period": PERIOD,
        "area_undeformed": area_undeformed(Z, BLOCKAGES[:, None]),
        "geometry": np.array([HEALTHY, THROAT, WIDTH]),
        "blockage": BLOCKAGES,
        "parameters_outlet": OUTLET,
        "parameters_losses": LOSSES,
        "parameters_wall": MEMBRANE,
        "parameters_local": LOCAL,
        "parameters_correction": correction,
        "inflow": inflow,
        "shift": shift,
        "losses_inflow": np.array([sign * q for sign in signs]),
        "losses_stored": np.array([sign * d for sign in signs]),
        "losses": np.array(
            [losses(s * q, s * d, b) for s, b in zip(signs, BLOCKAGES, strict=True)]
        ),
        "loads": loads,
        "loads_in_time": in_time,
        "membrane_area": np.pi * (r[:, None] + in_time @ np.array(moved)) ** 2,
        "local_area": np.pi * (r[:, None] + local[:, None] * (in_time @ loads)) ** 2,
        **outputs,
    }
