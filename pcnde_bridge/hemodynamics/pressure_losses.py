"""Published formulas of the pressure drop along a stenosis.

The form of Seeley and Young in the paper is

    Δp = ρ·Q²/S_D²·K_v/Re + K_t·ρ·Q²/(2·S_D²)·(S_D/S_s − 1)²,   K_v = 32·(L_s/D₀)·(S_D/S_s)²

with S_D and D₀ the area and diameter of the healthy vessel upstream, S_s the
smallest area and L_s the length of the stenosis, and Re = ρ·|Q|·D₀/(S_D·μ).
:func:`unsteady_pressure_drop` adds the inertia of Young and Tsai.  :func:`profile_pressure_drop`
and :func:`unsteady_profile_pressure_drop` integrate the friction over the area instead.

Only arithmetic operators and ``abs`` are used, so that every function takes
numpy and JAX arrays alike, of any shapes that broadcast.  Units are CGS.
"""

from typing import Any

from pcnde_bridge.data.stenosis import diameter


def viscous_coefficient(area_healthy: Any, area_throat: Any, length: Any) -> Any:
    """Return the dimensionless coefficient K_v = 32·(L_s/D₀)·(S_D/S_s)².

    Parameters
    ----------
    area_healthy, area_throat : array, shape (...)
        S_D and S_s, cm².
    length : array, shape (...)
        L_s, cm.
    """
    return 32.0 * length / diameter(area_healthy) * (area_healthy / area_throat) ** 2


def effective_length(length: Any, area_throat: Any) -> Any:
    """Return Seeley and Young's own length in K_v, 0.83·L_s + 1.64·D_s, cm.

    The paper prints L_s alone; svOneDSolver uses this length.

    Parameters
    ----------
    length : array, shape (...)
        L_s, cm.
    area_throat : array, shape (...)
        S_s, cm², with diameter D_s.
    """
    return 0.83 * length + 1.64 * diameter(area_throat)


def viscous_drop(
    flow: Any, area_healthy: Any, area_throat: Any, length: Any, viscosity: float = 0.04
) -> Any:
    """Return the viscous part ρ·Q²/S_D²·K_v/Re of the pressure drop, dyn/cm².

    One Q and the density cancel against Re.  The remaining form, K_v·μ·Q/(S_D·D₀), is
    defined at rest and changes sign with the flow.  It is Poiseuille's drop in a
    tube of the throat's area.

    Parameters
    ----------
    flow : array, shape (...)
        Q, mL/s.
    area_healthy, area_throat, length : array, shape (...)
        S_D, S_s (cm²) and L_s (cm).
    viscosity : float
        μ, poise.
    """
    k_v = viscous_coefficient(area_healthy, area_throat, length)
    return k_v * viscosity * flow / (area_healthy * diameter(area_healthy))


def turbulent_drop(
    flow: Any,
    area_healthy: Any,
    area_throat: Any,
    density: float = 1.06,
    turbulent_coefficient: float = 1.52,
) -> Any:
    """Return the turbulent part K_t·ρ·Q·|Q|/(2·S_D²)·(S_D/S_s − 1)² of the drop, dyn/cm².

    The paper prints Q².  Q·|Q| is the same for forward flow, and opposes reversed
    flow instead of driving it.

    Parameters
    ----------
    flow : array, shape (...)
        Q, mL/s.
    area_healthy, area_throat : array, shape (...)
        S_D and S_s, cm².
    density : float
        ρ, g/cm³.
    turbulent_coefficient : float
        K_t.
    """
    dynamic_pressure = 0.5 * density * flow * abs(flow) / area_healthy**2
    return turbulent_coefficient * dynamic_pressure * (area_healthy / area_throat - 1.0) ** 2


def pressure_drop(
    flow: Any,
    area_healthy: Any,
    area_throat: Any,
    length: Any,
    density: float = 1.06,
    viscosity: float = 0.04,
    turbulent_coefficient: float = 1.52,
) -> Any:
    """Return the pressure drop Δp along a stenosis, dyn/cm²: viscous plus turbulent part.

    Parameters
    ----------
    flow : array, shape (...)
        Q, mL/s; a negative flow gives a negative drop.
    area_healthy, area_throat : array, shape (...)
        S_D and S_s, cm².
    length : array, shape (...)
        L_s, cm.
    density, viscosity : float
        ρ (g/cm³) and μ (poise).
    turbulent_coefficient : float
        K_t.

    Returns
    -------
    array, shape (...)
        Drop, broadcast over all arguments; a numpy or JAX array as the arguments.
    """
    return viscous_drop(flow, area_healthy, area_throat, length, viscosity) + turbulent_drop(
        flow, area_healthy, area_throat, density, turbulent_coefficient
    )


def unsteady_pressure_drop(
    flow: Any,
    flow_rate_of_change: Any,
    area_healthy: Any,
    area_throat: Any,
    length: Any,
    density: float = 1.06,
    viscosity: float = 0.04,
    turbulent_coefficient: float = 1.52,
    inertial_coefficient: float = 1.2,
) -> Any:
    """Return the pressure drop of Young and Tsai (1973) in pulsatile flow, dyn/cm².

    It is :func:`pressure_drop` with :func:`effective_length` in K_v, plus the inertia
    K_u·ρ·L_s·(∂Q/∂t)/S_D.  The coefficients are K_v = 32·(0.83·L_s + 1.64·D_s)/D₀·(S_D/S_s)²,
    K_t = 1.52 and K_u = 1.2 (Young and Tsai 1973, J. Biomechanics 6:395 and 6:547; the length
    in K_v is that of Seeley and Young 1976, J. Biomechanics 9:439).

    Parameters
    ----------
    flow : array, shape (...)
        Q, mL/s.
    flow_rate_of_change : array, shape (...)
        ∂Q/∂t, mL/s².
    area_healthy, area_throat : array, shape (...)
        S_D and S_s, cm².
    length : array, shape (...)
        L_s, cm.
    density, viscosity : float
        ρ (g/cm³) and μ (poise).
    turbulent_coefficient, inertial_coefficient : float
        K_t and K_u.

    Returns
    -------
    array, shape (...)
        Drop, broadcast over all arguments.
    """
    effective, blood = effective_length(length, area_throat), (density, viscosity)
    steady = pressure_drop(
        flow, area_healthy, area_throat, effective, *blood, turbulent_coefficient
    )
    return steady + inertial_coefficient * density * length * flow_rate_of_change / area_healthy


def profile_pressure_drop(
    flow: Any,
    resistance: Any,
    area_healthy: Any,
    area_throat: Any,
    density: float = 1.06,
    turbulent_coefficient: float = 1.52,
) -> Any:
    """Return the pressure drop of Mirramezani et al. (2019), dyn/cm².

    Δp = R·Q + K_t·ρ·Q·|Q|/(2·S_D²)·(S_D/S_s − 1)², with Poiseuille's resistance along the vessel,
    R = 8πμ·∫dz/S², for a straight vessel (Mirramezani, Diamond, Litt and Shadden 2019, J. Biomech.
    Eng. 141:031011; Mirramezani and Shadden 2020, Ann. Biomed. Eng. 48:2870).

    Parameters
    ----------
    flow : array, shape (...)
        Q, mL/s.
    resistance : array, shape (...)
        R, dyn·s/cm⁵.
    area_healthy, area_throat : array, shape (...)
        S_D and S_s, cm².
    density : float
        ρ, g/cm³.
    turbulent_coefficient : float
        K_t.

    Returns
    -------
    array, shape (...)
        Drop, broadcast over all arguments.
    """
    expansion = turbulent_drop(flow, area_healthy, area_throat, density, turbulent_coefficient)
    return resistance * flow + expansion


def unsteady_profile_pressure_drop(
    flow: Any,
    flow_rate_of_change: Any,
    mean_flow: Any,
    resistance: Any,
    inertance: Any,
    area_healthy: Any,
    area_throat: Any,
    womersley: Any,
    density: float = 1.06,
) -> Any:
    """Return the pressure drop of Itu et al. (2013) in pulsatile flow, dyn/cm².

    Δp = K_v·R·Q + K_t·ρ·Q·|Q|/(2·S_D²)·(S_D/S_s − 1)² + K_u·L·∂Q/∂t + K_c·R·Q_mean, with
    K_v = 1 + 0.053·(S_s/S_D)·α², K_t = 1.52, K_u = 1.2, K_c = 0.0018·α²,
    R = 8πμ·∫dz/S² and L = ρ·∫dz/S (Itu et al. 2013, Ann. Biomed. Eng. 41:669).

    Parameters
    ----------
    flow : array, shape (...)
        Q, mL/s.
    flow_rate_of_change : array, shape (...)
        ∂Q/∂t, mL/s².
    mean_flow : array, shape (...)
        Mean Q of a cycle, mL/s.
    resistance, inertance : array, shape (...)
        R (dyn·s/cm⁵) and L (dyn·s²/cm⁵).
    area_healthy, area_throat : array, shape (...)
        S_D and S_s, cm².
    womersley : array, shape (...)
        Womersley number α of the healthy vessel, r·(2πρ/(μT))^½.
    density : float
        ρ, g/cm³.

    Returns
    -------
    array, shape (...)
        Drop, broadcast over all arguments.
    """
    oscillation = 0.053 * area_throat / area_healthy * womersley**2
    steady = profile_pressure_drop(flow, resistance, area_healthy, area_throat, density)
    mean = 0.0018 * womersley**2 * resistance * mean_flow
    return steady + oscillation * resistance * flow + 1.2 * inertance * flow_rate_of_change + mean
