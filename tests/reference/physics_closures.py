"""Reference outputs of the closures of preset ``physics``, from NumPy and SciPy alone.

Equations: docs/closures.md.  Wall and losses are solved without any grid, as a boundary
value problem and as initial value problems with Gauss's quadrature, and again on the grid.
There S_u changes by a constant factor per length in each interval, the friction follows the
trapezoidal rule, and layer, jet and the wall shear stress's memory are solved exactly.  The
coupled prediction uses the grid's points and time points, but none of the engines'
simplifications: areas follow from the whole displacement, and losses from the flow and its
rate at every point.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid, solve_bvp, solve_ivp
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
# The losses scale the pressure, but for the growth of layer and jet and the jet's momentum.
LOSSES = np.array([1.2, 1.1, 0.9, 1.3, 1.25, 0.95, 1.15, 0.04, 2.0, 0.7])
# Friction jumps where a flow separates; without it the grid's errors are smaller.
FRICTIONLESS = LOSSES * [0, 1, 1, 1, 1, 1, 0, 1, 1, 1]
SCALES_PRESSURE = np.array([1, 1, 1, 0, 0, 1, 1, 0, 0, 1], dtype=bool)
SHEAR = np.array([0.6, 0.1, 0.2, 0.3, 0.25, 0.15, 0.7, 1.4, 0.8])
STRAIGHT, FILLED_POWER = 1e-3, 8
REYNOLDS, FLOWS = 60.0, np.array([0.5, 2.0, 8.0])
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


class Losses(NamedTuple):
    """Parameters of the losses."""

    friction: float
    inertia: float
    core: float
    growth: float
    momentum: float
    recovery: float
    jet_friction: float
    spread: float
    viscous_spread: float
    lag: float


EXACT = {"method": "DOP853", "dense_output": True, "rtol": 1e-11, "atol": 1e-13}


def mean_speed(d):
    """Return m(d) and its derivative."""
    return 1 - 2 * d / 3 + d**2 / 6, -2 / 3 + d / 3


def layer_rate(d, slope, viscous):
    """d' of the layer, with (ln S_u)' and c_g·4πν/Q, from the momentum of the cross-section.

    (k·U²·S)' = U·U'·S + friction of the core less that of the wall, with U = Q/(S·m): all terms
    with d' are on the left.
    """
    m, m_d = mean_speed(d)
    k, k_d = 1 - 14 * d / 15 + 4 * d**2 / 15, -14 / 15 + 8 * d / 15
    energy_d = (k_d * m - 2 * k * m_d) / m**3
    return ((k - 1) / m**2 * slope + viscous / m * (d**6 - 1 / d)) / (energy_d + m_d / m**3)


def basis(x):
    return np.array([x, x**2 / (1 + x), x**2])


def reference_flow(blockage):
    ends = radius(np.array([0.0, LENGTH]), blockage)[0]
    return REYNOLDS / 2 * np.pi * VISCOSITY / DENSITY * np.sqrt((ends**2).mean())


def drop_per_length(s, s_z, at_throat, filled, flow, p, attached, accelerated, mixed):
    """Weight friction by the share that the flow fills, and the acceleration where it narrows.

    Without a slope a vessel is straight, but not at its throat.
    """
    separated = p.jet_friction * 8 * np.pi * VISCOSITY * flow / s**2
    straight = np.where(at_throat, 1e-30, STRAIGHT**2 * np.pi * s)
    share = np.where(s_z < 0, s_z**2 / (s_z**2 + straight), 0) * filled**FILLED_POWER
    friction = filled * attached + (1 - filled) * separated
    return share * accelerated + (1 - share) * mixed + friction


def march(flow, throat, blockage, p):
    """Layer and jet of a flow towards larger z: densities of its drop and of its lag, and kinks.

    The vessel is that of the script, moved to ``throat``.
    """
    viscosity = np.pi * VISCOSITY / DENSITY / flow

    def vessel(z):
        r, slope = radius(z - throat + THROAT, blockage)
        return np.pi * r**2, 2 * np.pi * r * slope

    def filled_radius(z):
        r, slope = radius(z - throat + THROAT, blockage)
        return r / np.sqrt(p.momentum), slope / np.sqrt(p.momentum)

    def d_rate(z, d):
        s, s_z = vessel(z)
        return layer_rate(d, s_z / s, 4 * p.growth * viscosity)

    def developed(z, d):
        return d[0] - 1 if z > throat else -1.0

    developed.terminal = True
    layer = solve_ivp(d_rate, (0, LENGTH), [1.0], events=developed, **EXACT)
    assert layer.success
    assert layer.y.min() > 0.02
    until = layer.t[-1]

    def thickness(z):
        return np.where(z < until, layer.sol(np.minimum(z, until))[0], 1.0)

    def excess(z):
        r, slope = filled_radius(z)
        return slope - p.spread - p.viscous_spread * viscosity * r

    def jet_rate(z, y):
        r, _ = y
        return [p.spread + p.viscous_spread * viscosity * r, np.pi * r**2]

    def fills(z, y):
        return y[0] - filled_radius(z)[0] if z > begin + 1e-3 else -1.0

    fills.terminal = True
    begin = end = LENGTH
    search = np.linspace(throat, LENGTH, 10_001)
    if excess(search).max() > 0:
        begin = brentq(excess, throat, search[excess(search).argmax()], xtol=1e-14)
        start = [filled_radius(begin)[0], 0.0]
        jet = solve_ivp(jet_rate, (begin, LENGTH), start, events=fills, **EXACT)
        assert jet.success
        end = jet.t[-1]

    def densities(z):
        s, s_z = vessel(z)
        d = thickness(z)
        m, m_d = mean_speed(d)
        speed = flow / (s * m)
        d_z = np.where(z < until, d_rate(z, d), 0)
        speed_z = -speed * (s_z / s + m_d / m * d_z)
        attached = p.friction * 4 * np.pi * VISCOSITY * speed * d**6 / s
        inside = (z > begin) & (z < end)
        inverse, inverse_z = p.momentum / s, -p.momentum * s_z / s**2
        (r, filled), (volume, lag) = np.ones((2, *z.shape)), np.zeros((2, *z.shape))
        if inside.any():
            r[inside], volume[inside] = jet.sol(z[inside])
            area, area_z = np.pi * r**2, 2 * np.pi * r * jet_rate(z, (r, 0))[0]
            jet_inverse_z = -area_z / area**2
            behind = (jet_inverse_z - inverse_z) * volume + (1 / area - inverse) * area
            lag = np.where(inside, -2 * p.lag * DENSITY / s * behind, 0)
            inverse_z = np.where(inside, jet_inverse_z, inverse_z)
            filled = np.where(inside, p.momentum * area / s, 1)
        mixed = p.recovery * DENSITY * flow**2 / s * inverse_z
        terms = attached, p.core * DENSITY * speed * speed_z, mixed
        return drop_per_length(s, s_z, np.abs(z - throat) < WIDTH / 4, filled, flow, p, *terms), lag

    return densities, [until, begin, end, throat]


def losses(q, d, blockage, loss):
    """p − p(L) of the flow Q = q(t) − x(z)·d(t), x = z/L + sin(πz/L)/10; (time, z)."""
    p = Losses(*loss)
    q_0 = reference_flow(blockage)
    sign = np.sign(q[0])
    # A reversed flow sees the vessel from the outlet.
    throat = THROAT if sign > 0 else LENGTH - THROAT
    marched = [march(x * q_0, throat, blockage, p) for x in FLOWS]
    kinks = np.concatenate([kinks for _, kinks in marched])
    kinks = kinks if sign > 0 else LENGTH - kinks
    breaks = np.unique(np.concatenate([Z, kinks]))
    nodes, weights = np.polynomial.legendre.leggauss(12)
    until = np.zeros((N_TIMES, N_POINTS))
    for a, b in pairwise(breaks):
        z = (a + b) / 2 + (b - a) / 2 * nodes
        x = z / LENGTH + np.sin(np.pi * z / LENGTH) / 10
        flow, flow_rate = (f[:, None] - g[:, None] * x for f, g in ((q, d), (rate(q), rate(d))))
        assert (sign * flow > 0).all()
        of_flows = [densities(z if sign > 0 else LENGTH - z) for densities, _ in marched]
        factors = np.linalg.solve(basis(FLOWS).T, [drop for drop, _ in of_flows])
        density = sign * np.einsum("iz,itz->tz", factors, basis(sign * flow / q_0))
        density += of_flows[1][1] * flow_rate
        density += p.inertia * DENSITY / area_undeformed(z, blockage) * flow_rate
        piece = (b - a) / 2 * density @ weights
        until[:, (a + b) / 2 < Z] += piece[:, None]
    return until[:, -1:] - until


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


def layer_on_grid(s, viscosity, p):
    """Return d at the points, where ln S_u changes linearly in each interval."""
    thickness = [1.0]
    for h, slope in zip(np.diff(Z), np.diff(np.log(s)) / np.diff(Z), strict=True):
        viscous = 4 * p.growth * viscosity

        def developed(_, d):
            return d[0] - 1

        developed.terminal, developed.direction = True, 1
        if thickness[-1] == 1 and layer_rate(1.0, slope, viscous) >= 0:
            thickness.append(1.0)
            continue
        found = solve_ivp(
            lambda _, d, slope=slope, viscous=viscous: layer_rate(d, slope, viscous),
            (0, h),
            thickness[-1:],
            events=developed,
            **EXACT,
        )
        assert found.y.min() > 0.02
        thickness.append(1.0 if found.t[-1] < h else found.y[0, -1])
    return np.array(thickness)


def jet_on_grid(s, viscosity, p):
    """Return the area of the jet, and whether the flow fills the vessel."""
    h, rate = Z[1] - Z[0], p.viscous_spread * viscosity
    filled_area = s / p.momentum
    area, is_filled = filled_area.copy(), np.ones(N_POINTS, dtype=bool)
    for i in range(1, N_POINTS):
        r = np.sqrt(area[i - 1] / np.pi)
        grown = np.pi * (r * np.exp(rate * h) + p.spread * np.expm1(rate * h) / rate) ** 2
        if grown < filled_area[i]:
            area[i], is_filled[i] = grown, False
    return area, is_filled


def interval_drops(s, flow, p):
    """Drop and lag of a flow towards larger z in each interval."""
    h, viscosity = Z[1] - Z[0], np.pi * VISCOSITY / DENSITY / flow
    d = layer_on_grid(s, viscosity, p)
    area, is_filled = jet_on_grid(s, viscosity, p)
    filled_area, volume = s / p.momentum, np.zeros(N_POINTS)
    for i in np.flatnonzero(~is_filled):
        before = 0.0 if is_filled[i - 1] else area[i - 1]
        volume[i] = volume[i - 1] + h * (before + area[i]) / 2
    speed = flow / (s * mean_speed(d)[0])
    attached = p.friction * 4 * np.pi * VISCOSITY * speed * d**6 / s
    separated = p.jet_friction * 8 * np.pi * VISCOSITY * flow / s**2
    filled = area / filled_area
    friction = filled * attached + (1 - filled) * separated
    friction, filled, straight = (
        (f[1:] + f[:-1]) / 2 for f in (friction, filled, STRAIGHT * np.sqrt(np.pi * s))
    )
    per_area = (1 / s[1:] + 1 / s[:-1]) / 2
    mixed = p.recovery * DENSITY * flow**2 * per_area * np.diff(1 / area)
    accelerated = p.core * DENSITY / 2 * np.diff(speed**2)
    slope = np.zeros(N_POINTS)
    slope[1:-1] = (s[2:] - s[:-2]) / (2 * h)
    falls, rises = (np.maximum(f, 0)[1:] + np.maximum(f, 0)[:-1] for f in (-slope, slope))
    steep = falls + rises
    share = falls * steep / (steep**2 + straight**2) * filled**FILLED_POWER
    drop = share * accelerated + (1 - share) * mixed + h * friction
    lag = -2 * p.lag * DENSITY * per_area * np.diff((1 / area - 1 / filled_area) * volume)
    return drop, lag


def grid_losses(blockage, loss):
    """Return a function of the flow (time, z): p − p(L) on the grid."""
    p, s, q_0 = Losses(*loss), area_undeformed(Z, blockage), reference_flow(blockage)
    factors, lags = [], []
    for sign in (1, -1):
        of_flows = [interval_drops(s[::sign], x * q_0, p) for x in FLOWS]
        drops = np.array([drop[::sign] for drop, _ in of_flows])
        factors.append(np.linalg.solve(basis(FLOWS).T, drops))
        lags.append(of_flows[1][1][::sign])

    def drop(flow):
        flow_rate = rate(flow)
        x, middle_rate = ((f[:, 1:] + f[:, :-1]) / 2 for f in (flow / q_0, flow_rate))
        steady = np.einsum("itz,iz->tz", basis(np.abs(x)), factors[0])
        back = np.einsum("itz,iz->tz", basis(np.abs(x)), factors[1])
        pieces = np.where(x > 0, steady + lags[0] * middle_rate, -back + lags[1] * middle_rate)
        until = cumulative_trapezoid(p.inertia * DENSITY / s * flow_rate, Z, initial=0)
        until[:, 1:] += np.cumsum(pieces, axis=1)
        return until[:, -1:] - until

    return drop


# ---- wall shear stress ---------------------------------------------------------------


def relaxed(source, length):
    """Solve y' = (source − y)/length, with the source linear in each interval."""
    y = [0.0]
    for i, h in enumerate(np.diff(Z)):
        middle = (length[i] + length[i + 1]) / 2

        def slope(x, y, i=i, h=h, middle=middle):
            return (source[i] + x / h * (source[i + 1] - source[i]) - y) / middle

        y.append(solve_ivp(slope, (0, h), y[-1:], **EXACT).y[0, -1])
    return np.array(y)


def near_root(x):
    return np.where(x > 0, x / np.sqrt(np.abs(x) + 0.3), 0)


def marched_shear(s, flow, p):
    """Poiseuille's wall shear stress of a flow towards larger z, times 1 and eight terms."""
    h, nu, r, mean = Z[1] - Z[0], VISCOSITY / DENSITY, np.sqrt(s / np.pi), flow / s
    d = layer_on_grid(s, np.pi * nu / flow, p)
    excess = s / (p.momentum * jet_on_grid(s, np.pi * nu / flow, p)[0])
    core, bend, slope = mean / mean_speed(d)[0], np.zeros(N_POINTS), np.zeros(N_POINTS)
    # Differences over two intervals on either side.
    bend[2:-2] = (core[4:] - 2 * core[2:-2] + core[:-4]) / (2 * h) ** 2
    edge = core - 0.6 * r**2 / 8 * bend
    slope[2:-2] = (edge[4:] - edge[:-4]) / (4 * h)
    shear, pohlhausen = edge / (2 * mean * d), (r * d) ** 2 * slope / nu
    up = np.where(pohlhausen > 0, pohlhausen, 0)
    near = 0.005 * (r * d) ** 2 * core / nu
    both, first, second = relaxed(pohlhausen, near), relaxed(up, near), relaxed(up, 0.3 * r)
    third, fifth = relaxed(up, 0.6 * r), relaxed(pohlhausen, 1.2 * r)
    jet = relaxed(near_root(excess - 1), 0.08 * r**2 * mean / nu)
    terms = [
        np.ones(N_POINTS),
        shear * near_root(both),
        near_root(first),
        shear * near_root(second),
        -d * near_root(third),
        near_root(-fifth),
        -d * np.tanh(np.where(both < 0, -both, 0) / 20),
        -np.log(excess),
        -jet,
    ]
    return 4 * VISCOSITY * flow / (np.pi * r**3) * np.array(terms)


def grid_shear(flow, blockage, loss):
    """Wall shear stress of a flow (time, z) on the grid, forward or backward throughout."""
    p, s, q_0 = Losses(*loss), area_undeformed(Z, blockage), reference_flow(blockage)
    sign = int(np.sign(flow[0, 0]))
    assert (sign * flow > 0).all()
    parameters = np.concatenate([[1.0], SHEAR[1:]])
    steady = [parameters @ marched_shear(s[::sign], x * q_0, p) for x in FLOWS]
    factors = np.linalg.solve(basis(FLOWS).T, steady)[:, ::sign]
    unsteady = SHEAR[0] * DENSITY / (6 * np.sqrt(np.pi * s)) * rate(flow)
    return sign * np.einsum("iz,itz->tz", factors, basis(sign * flow / q_0)) + unsteady


# ---- correction ----------------------------------------------------------------------


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
    drop = grid_losses(blockage, loss)

    # Passive linear tube: all of the vessel has the outlet's pressure.
    volume = np.trapezoid(2 * np.pi * r * to_wall.sum(axis=1), Z)
    i_omega = 1j * omega
    i_omega[-1] = 0.0
    passive = np.fft.rfft(inflow) / (1 + kappa * volume * i_omega * impedance)
    passive_rate = np.fft.irfft(i_omega * impedance * passive, n=N_TIMES)
    g = hidden_share(correction, passive_rate, np.fft.irfft(passive, n=N_TIMES), shift)

    def fields(flow):
        outlet = np.fft.irfft(impedance * np.fft.rfft(flow[:, -1]), n=N_TIMES) + p_d
        pressure = outlet[:, None] + drop(flow)
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
    for name, loss in (("losses", LOSSES), ("frictionless", FRICTIONLESS)):
        outputs[name] = np.array(
            [losses(s * q, s * d, b, loss) for s, b in zip(signs, BLOCKAGES, strict=True)]
        )
    outputs["losses_on_grid"] = np.array(
        [grid_losses(b, LOSSES)(q) for q, b in zip(flows, BLOCKAGES, strict=True)]
    )
    outputs["shear_on_grid"] = np.array(
        [grid_shear(q, b, LOSSES) for q, b in zip(flows, BLOCKAGES, strict=True)]
    )
    on_grid = np.array([in_time @ loads @ membrane_matrix(b).T for b in BLOCKAGES])
    outputs["membrane_area_on_grid"] = np.pi * (r[:, None] + on_grid) ** 2
    weak = np.where(SCALES_PRESSURE, 1e-4 * LOSSES, LOSSES)
    for name, loss in (("coupled", LOSSES), ("coupled_weak", weak)):
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
        "parameters_frictionless": FRICTIONLESS,
        "parameters_weak_losses": weak,
        "parameters_wall": MEMBRANE,
        "parameters_shear": SHEAR,
        "parameters_local": LOCAL,
        "parameters_correction": correction,
        "inflow": inflow,
        "shift": shift,
        "losses_inflow": np.array([sign * q for sign in signs]),
        "losses_stored": np.array([sign * d for sign in signs]),
        "loads": loads,
        "loads_in_time": in_time,
        "membrane_area": np.pi * (r[:, None] + in_time @ np.array(moved)) ** 2,
        "local_area": np.pi * (r[:, None] + local[:, None] * (in_time @ loads)) ** 2,
        **outputs,
    }
