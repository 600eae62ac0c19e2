"""Outlets of the 1D solver: linear circuits of resistances and capacitances.

Every circuit has the form p = R·Q + x₀ with the states x of

    E·dx/dt = A·x + B·Q + f(t),

where E is diagonal.  A state of E = 0 has no capacitance.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array, ComplexArray
from pcnde_bridge._utils.validation import all_of, finite_array, listed
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.selection import Positions
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.waveform import Waveform

Pressure = npt.ArrayLike | Waveform | tuple[Waveform, ...]
"""Constant pressure, one for each case, or periodic functions of time, dyn/cm²."""


class Circuit(NamedTuple):
    """Numbers of a circuit with m states, see the module; nested by state, then (case, ...).

    Attributes
    ----------
    resistance : array of shape (case, 1)
        R, dyn·s/cm⁵.
    storage, drive : list of m arrays of shape (case, 1)
        Diagonal of E, and B.
    exchange : list of m lists of m arrays of shape (case, 1)
        A.
    source : list of m arrays of shape (case, 1) or (case, time)
        f(t).
    """

    resistance: Any
    storage: list[Any]
    exchange: list[list[Any]]
    drive: list[Any]
    source: list[Any]


class Outlet(ABC):
    """Outlet of the solver; its fields are resistances, capacitances and pressures."""

    pressures: ClassVar[tuple[str, ...]] = ("distal_pressure",)

    @staticmethod
    @abstractmethod
    def circuit(values: Mapping[str, Any]) -> Circuit:
        """Return the circuit of the values of all fields, (case, 1) or (case, time)."""

    @staticmethod
    def initial_state(values: Mapping[str, Any], pressure: Any) -> list[Any]:
        """Return the states of a circuit at rest at a pressure, dyn/cm², shape (case, 1)."""
        return [pressure]

    @classmethod
    def settling(cls, values: Mapping[str, Any]) -> tuple[Array, Array]:
        """Return total resistance and longest time constant of a circuit, each (case,)."""
        circuit = cls.circuit(values)
        storage, exchange, drive = (
            np.moveaxis(np.array(part)[..., 0], -1, 0)
            for part in (circuit.storage, circuit.exchange, circuit.drive)
        )
        inverse = np.linalg.inv(exchange)
        total = circuit.resistance[:, 0] - np.einsum("cj,cj->c", inverse[:, 0], drive)
        times = np.abs(np.linalg.eigvals(inverse * storage[:, None])).max(axis=1)
        return np.asarray(total), np.asarray(times)

    @property
    def is_common(self) -> bool:
        """Whether all cases have the same values."""
        values = [getattr(self, field.name) for field in fields(self)]  # type: ignore[arg-type]
        return all(np.size(value) == 1 for value in values)

    def select(self, cases: Positions) -> Self:
        """Return the outlet of some of its cases."""

        def some(value: Any) -> Any:
            if np.size(value) == 1:
                return value
            chosen = np.asarray(value)[cases]
            return tuple(chosen) if isinstance(value, tuple) else chosen

        return replace(self, **{f.name: some(getattr(self, f.name)) for f in fields(self)})  # type: ignore

    def to_dict(self) -> dict[str, Any]:
        """Return the name of the class and all fields as numbers, lists and mappings."""
        found = asdict(self)  # type: ignore[call-overload]
        arrays = {k: np.asarray(v).tolist() for k, v in found.items() if not isinstance(v, dict)}
        return {"kind": type(self).__name__, **found, **arrays}

    def response(self, n_cases: int, time: Array, period: float, impedance: Array) -> ComplexArray:
        """Return 𝒵 and p₀ of p = 𝒵·Q + p₀ in a periodic cycle, (case, 2, harmonic).

        The arguments are those of :meth:`values`; the time points, equally spaced, are those of
        the cycle.  The harmonics of p₀, dyn/cm², are those of :func:`numpy.fft.rfft`.
        """
        values = self.values(n_cases, time, period, impedance)
        return periodic_response(self.circuit(values), len(time), period)

    def values(self, n_cases: int, time: Array, period: float, impedance: Array) -> dict[str, Any]:
        """Check the fields and return them for all cases.

        Parameters
        ----------
        n_cases : int
            Number of cases.
        time : array, shape (time,)
            Time points at which the pressures are needed, s.
        period : float
            Length of the cycle, s.
        impedance : array, shape (case,)
            Characteristic impedance ρ·c/S of the vessel's end, dyn·s/cm⁵.

        Returns
        -------
        dict
            Fields, of shape (case, 1), pressures (case, time).

        Raises
        ------
        InputError
            If a value is not finite, a resistance or capacitance is negative, an array has
            neither one value nor one for each case, or a pressure has another period.
        """
        found = {}
        for name in (field.name for field in fields(self)):  # type: ignore[arg-type]
            value = getattr(self, name)
            if name not in self.pressures:
                found[name] = _for_cases(name, value, n_cases, 0.0)[:, None]
            elif isinstance(value, Waveform | tuple) and not np.isscalar(value):
                found[name] = _over_time(name, value, n_cases, time, period)
            else:
                constant = _for_cases(name, value, n_cases, -np.inf)[:, None]
                found[name] = np.broadcast_to(constant, (n_cases, len(time)))
        return found


@dataclass(frozen=True)
class Windkessel(Outlet):
    """Outlet with a resistance, or a three-element Windkessel, and a distal pressure.

    p = R·Q + p_c,  C·dp_c/dt = Q − (p_c − p_d)/R_d.  Without R_d this is the
    resistance outlet p = R·Q + p_d.

    Attributes
    ----------
    resistance : float or array_like, shape (n_cases,)
        R, dyn·s/cm⁵; the proximal one of three elements.
    distal_resistance : float or array_like, shape (n_cases,)
        R_d, dyn·s/cm⁵.
    capacitance : float or array_like, shape (n_cases,)
        C, cm⁵/dyn.
    distal_pressure : float, array_like of shape (n_cases,), Waveform or tuple of Waveform
        p_d, dyn/cm².
    """

    resistance: npt.ArrayLike
    distal_resistance: npt.ArrayLike = 0.0
    capacitance: npt.ArrayLike = 0.0
    distal_pressure: Pressure = 0.0

    def values(self, n_cases: int, time: Array, period: float, impedance: Array) -> dict[str, Any]:
        """Check the fields and return them for all cases; see :class:`Outlet`."""
        found = super().values(n_cases, time, period, impedance)
        if ((found["capacitance"] > 0.0) & (found["distal_resistance"] == 0.0)).any():
            raise InputError(
                "A Windkessel with a capacitance needs a distal_resistance, which is zero; "
                "for two elements use Windkessel(0, R, C)."
            )
        return found

    @staticmethod
    def circuit(values: Mapping[str, Any]) -> Circuit:
        """Return the circuit; its state is p_c."""
        distal = values["distal_resistance"]
        storage = distal * values["capacitance"]
        exchange = [[0.0 * distal - 1.0]]
        return Circuit(
            values["resistance"], [storage], exchange, [distal], [values["distal_pressure"]]
        )


@dataclass(frozen=True)
class CoronaryOutlet(Outlet):
    """Coronary outlet of Kim et al. (2010) with the pressure of the heart muscle.

    Arteries, microcirculation and veins:  p = R_a·Q + p₁,

        C_a·dp₁/dt = Q − (p₁ − p₂)/R_am,   C_im·d(p₂ − p_im)/dt = (p₁ − p₂)/R_am − (p₂ − p_v)/R_v.

    Attributes
    ----------
    arterial_resistance, microvascular_resistance, venous_resistance : float or array_like
        R_a, R_am and R_v, dyn·s/cm⁵, one value or shape (n_cases,).
    arterial_capacitance, intramyocardial_capacitance : float or array_like
        C_a and C_im, cm⁵/dyn.
    intramyocardial_pressure : float, array_like, Waveform or tuple of Waveform
        p_im, dyn/cm²; a waveform's values are pressures.
    venous_pressure : float, array_like, Waveform or tuple of Waveform
        p_v, dyn/cm².

    References
    ----------
    Kim et al. (2010), Annals of Biomedical Engineering 38:3195.
    """

    arterial_resistance: npt.ArrayLike
    microvascular_resistance: npt.ArrayLike
    venous_resistance: npt.ArrayLike
    arterial_capacitance: npt.ArrayLike
    intramyocardial_capacitance: npt.ArrayLike
    intramyocardial_pressure: Pressure
    venous_pressure: Pressure = 0.0

    pressures: ClassVar[tuple[str, ...]] = ("intramyocardial_pressure", "venous_pressure")

    def values(self, n_cases: int, time: Array, period: float, impedance: Array) -> dict[str, Any]:
        """Check the fields and return them for all cases; see :class:`Outlet`."""
        found = super().values(n_cases, time, period, impedance)
        for name in ("microvascular_resistance", "venous_resistance"):
            if (found[name] == 0.0).any():
                raise InputError(f"outlet.{name} must be positive, got 0.")
        return found

    @staticmethod
    def circuit(values: Mapping[str, Any]) -> Circuit:
        """Return the circuit; its states are p₁ and p₂ − p_im."""
        micro, venous = 1.0 / values["microvascular_resistance"], 1.0 / values["venous_resistance"]
        muscle, vein = values["intramyocardial_pressure"], values["venous_pressure"]
        return Circuit(
            values["arterial_resistance"],
            [values["arterial_capacitance"], values["intramyocardial_capacitance"]],
            [[-micro, micro], [micro, -micro - venous]],
            [0.0 * micro + 1.0, 0.0 * micro],
            [micro * muscle, venous * vein - (micro + venous) * muscle],
        )

    @staticmethod
    def initial_state(values: Mapping[str, Any], pressure: Any) -> list[Any]:
        """Return the states of a circuit at rest at a pressure, dyn/cm², shape (case, 1)."""
        return [pressure, pressure - values["intramyocardial_pressure"][:, -1:]]


@dataclass(frozen=True)
class Reflection(Outlet):
    """Outlet that reflects a fraction of small pressure waves, none by default.

    p = p_d + Z·(1 + Γ)/(1 − Γ)·Q with the vessel's impedance Z = ρ·c/S at its end and at
    the initial pressure.

    Attributes
    ----------
    coefficient : float or array_like, shape (n_cases,)
        Γ in (−1, 1); 0 absorbs waves.
    distal_pressure : float, array_like of shape (n_cases,), Waveform or tuple of Waveform
        p_d, dyn/cm².
    """

    coefficient: npt.ArrayLike = 0.0
    distal_pressure: Pressure = 0.0

    def values(self, n_cases: int, time: Array, period: float, impedance: Array) -> dict[str, Any]:
        """Return the values of the Windkessel with the same reflection; see :class:`Outlet`."""
        factor = _for_cases("coefficient", self.coefficient, n_cases, -1.0)
        if not (np.abs(factor) < 1.0).all():
            raise InputError(f"outlet.coefficient must be in (−1, 1), got {factor.max():g}.")
        if not np.isfinite(impedance).all():
            raise InputError("A Reflection needs the vessel's end; give another outlet.")
        resistance = impedance * (1.0 + factor) / (1.0 - factor)
        same = Windkessel(resistance, distal_pressure=self.distal_pressure)
        return same.values(n_cases, time, period, impedance)

    circuit = staticmethod(Windkessel.circuit)


def check_outlet(outlet: object) -> None:
    """Raise InputError unless the argument is an outlet."""
    if not isinstance(outlet, Outlet):
        kinds = listed([kind.__name__ for kind in Outlet.__subclasses__()])
        advice = f"such as Windkessel(resistance=1e4), of the classes {kinds}"
        raise InputError(f"outlet must be an outlet {advice}, got {outlet!r:.80}.")


def outlet_from(values: object) -> Outlet:
    """Return the outlet that :meth:`Outlet.to_dict` describes.

    Raises
    ------
    InputError
        If there is no such outlet, or a field is unknown or missing.
    """
    kinds = {kind.__name__: kind for kind in Outlet.__subclasses__()}
    if not isinstance(values, dict) or values.get("kind") not in kinds:
        raise InputError(f"An outlet needs a kind, one of {list(kinds)}, got {values!r:.80}.")

    def restored(value: Any) -> Any:
        several = isinstance(value, list) and any(isinstance(each, dict) for each in value)
        if several:
            return tuple(map(restored, value))
        return made(Waveform, value) if isinstance(value, dict) else value

    def made(kind: Any, given: dict[str, Any]) -> Any:
        try:
            return kind(**given)
        except TypeError as error:
            known, name = [field.name for field in fields(kind)], kind.__name__
            needed = [field.name for field in fields(kind) if field.default is MISSING]
            wrong = [f"{each!r} is none of them" for each in given if each not in known]
            wrong += [f"{each!r} is missing" for each in needed if each not in given]
            raise InputError(
                f"{name} has the fields {known}, got {[*given]}: {', '.join(wrong)}."
            ) from error

    arguments = {name: restored(value) for name, value in values.items() if name != "kind"}
    outlet: Outlet = made(kinds[values["kind"]], arguments)
    return outlet


def periodic_response(circuit: Circuit, n_times: int, period: Any, xp: Any = np) -> Any:
    """Return 𝒵 and p₀ of p = 𝒵·Q + p₀ in a periodic cycle, (case, 2, harmonic).

    Parameters
    ----------
    circuit : Circuit
        Circuit, with sources at the equally spaced time points of a cycle.
    n_times : int
        Number of time points.
    period : float
        Length of the cycle, s.
    xp : module
        ``numpy`` or ``jax.numpy``.
    """
    n_cases, states = len(circuit.resistance), range(len(circuit.storage))
    i_omega = 2j * xp.pi * xp.arange(n_times // 2 + 1) / period
    shape = n_cases, i_omega.size
    matrix = [
        xp.broadcast_to(i_omega * circuit.storage[j] * (j == k) - circuit.exchange[j][k], shape)
        for j in states
        for k in states
    ]
    matrix = xp.stack(matrix, axis=-1).reshape(*shape, len(states), len(states))
    source = [xp.fft.rfft(xp.broadcast_to(f, (n_cases, n_times))) for f in circuit.source]
    drive = [xp.broadcast_to(b + 0.0 * i_omega, shape) for b in circuit.drive]
    right = xp.stack([xp.stack(drive, axis=-1), xp.stack(source, axis=-1)], axis=-1)
    found = xp.moveaxis(xp.linalg.solve(matrix, right)[..., 0, :], -1, 1)
    return found + xp.stack([circuit.resistance, xp.zeros_like(circuit.resistance)], axis=1)


def windkessel_response(values: Any, n_times: int, period: Any, xp: Any = np) -> Any:
    """Return :func:`periodic_response` (2, harmonic) of R, R_d, C and p_d of a Windkessel."""
    names = (field.name for field in fields(Windkessel))
    shaped = {name: xp.reshape(v, (1, 1)) for name, v in zip(names, values, strict=True)}
    return periodic_response(Windkessel.circuit(shaped), n_times, period, xp)[0]


def _for_cases(name: str, value: Any, n_cases: int, least: float) -> Array:
    array = finite_array(f"outlet.{name}", value)
    if array.ndim > 1 or array.size not in (1, n_cases):
        wanted = f"one number or one for each of {n_cases} cases"
        raise InputError(f"outlet.{name} must be {wanted}, got shape {array.shape}.")
    if (array < least).any():
        bound = "negative" if least == 0.0 else f"less than {least:g}"
        raise InputError(f"outlet.{name} must not be {bound}, got {array.min():g}.")
    return np.broadcast_to(array, (n_cases,))


def _over_time(name: str, value: Any, n_cases: int, time: Array, period: float) -> Array:
    several = (value,) * n_cases if isinstance(value, Waveform) else value
    waveforms = all_of(Waveform, f"outlet.{name}", several)
    if len(waveforms) != n_cases:
        wanted = f"one waveform or one for each of {n_cases} cases"
        raise InputError(f"outlet.{name} must be {wanted}, got {len(waveforms)}.")
    for waveform in waveforms:
        waveform.check_period(f"outlet.{name}", period)
    return np.array([waveform.flow(time) for waveform in waveforms])


def outlet_resistance(cases: Cases) -> float:
    """Return the resistance that fits p = R·Q at the outlet of all cases best, dyn·s/cm⁵.

    Raises
    ------
    InputError
        If no blood flows out, or the flow is against the pressure.
    """
    flow, pressure = cases.flow[:, :, -1].ravel(), cases.pressure[:, :, -1].ravel()
    if not flow @ pressure > 0.0:
        raise InputError("The data's outlet flow and pressure give no resistance; give an outlet.")
    return float(flow @ pressure / (flow @ flow))
