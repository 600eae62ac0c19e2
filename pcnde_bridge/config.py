"""Every number of the method in one place: immutable, validated, serialisable.

The default, :data:`PAPER`, follows the text of Csala, Mohan, Livescu and Arzani
(2024).  Where the published code does something else, the difference is a named
option of the stage it belongs to, and :data:`PUBLISHED_CODE` sets them all.

Units are CGS: cm, s, mL/s, dyn/cm², g/cm³, poise.
"""

from __future__ import annotations

import dataclasses
import json
import math
import numbers
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from pcnde_bridge.errors import InputError

Activation = Literal["tanh", "gelu", "relu", "sigmoid", "swish"]
Loss = Literal["mean", "sum"]
Term = Literal["friction", "convection", "inertia"]

_Config = TypeVar("_Config", bound="_Section")
_Whole = TypeVar("_Whole", bound="_Settings")


class _Section:
    """Validation and (de)serialisation shared by every group of settings."""

    def __post_init__(self) -> None:
        hints = typing.get_type_hints(type(self))
        for f in dataclasses.fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            checked = _checked(value, hints[f.name], f"{type(self).__name__}.{f.name}")
            object.__setattr__(self, f.name, checked)
            if not f.metadata.get("signed", False) and _smallest(checked) < 0:
                raise InputError(f"{type(self).__name__}.{f.name} is negative: {value!r}.")
            if f.metadata.get("positive", False) and _smallest(checked) <= 0:
                raise InputError(f"{type(self).__name__}.{f.name} must be positive: {value!r}.")
            if f.metadata.get("some", False) and not checked:
                raise InputError(f"{type(self).__name__}.{f.name} must not be empty.")

    def replace(self: _Config, /, **changes: Any) -> _Config:
        """Copy with some settings changed; groups may be given as mappings.

        Parameters
        ----------
        **changes
            New values.  A group of settings can be given as a mapping of the
            settings to change in it: ``config.replace(flow={"epochs": 10})``.

        Raises
        ------
        InputError
            If a name is unknown or a value is not usable.
        """
        names = {f.name for f in dataclasses.fields(self)}  # type: ignore[arg-type]
        for name, value in changes.items():
            if name not in names:
                raise InputError(
                    f"{type(self).__name__} has no setting {name!r}; it has {sorted(names)}."
                )
            old = getattr(self, name)
            if isinstance(old, _Section) and isinstance(value, Mapping):
                changes[name] = old.replace(**value)
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as nested plain dictionaries, ready for JSON."""
        return dataclasses.asdict(self)  # type: ignore[call-overload, no-any-return]


class _Settings(_Section):
    """A whole configuration: read from and written to mappings and JSON."""

    def to_json(self) -> str:
        """Return the settings as a JSON text that :meth:`from_json` reads back."""
        return json.dumps(self.to_dict(), indent=1)

    @classmethod
    def from_dict(cls: type[_Whole], settings: Mapping[str, Any]) -> _Whole:
        """Make settings from nested mappings; what is left out keeps its default.

        Raises
        ------
        InputError
            If a name is unknown or a value is not usable.
        """
        if not isinstance(settings, Mapping):
            raise InputError(f"A configuration is a mapping of groups, got {settings!r}.")
        return cls().replace(**settings)

    @classmethod
    def from_json(cls: type[_Whole], text: str) -> _Whole:
        """Inverse of :meth:`to_json`.

        Raises
        ------
        InputError
            If the text is not JSON, a name is unknown or a value is not usable.
        """
        try:
            settings = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"The configuration is not JSON: {error}.") from error
        return cls.from_dict(settings)


def _smallest(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | tuple):
        return math.inf
    if not isinstance(value, tuple):
        return value
    return min((v for v in value if not isinstance(v, str)), default=math.inf)


def _checked(value: Any, hint: Any, where: str) -> Any:
    """Return ``value`` as the annotated type, or say why it cannot be that."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        if value not in arguments:
            raise InputError(f"{where} must be one of {list(arguments)}, got {value!r}.")
        return value
    if origin in (types.UnionType, typing.Union):
        if value is None:
            return None
        (hint,) = (a for a in arguments if a is not type(None))
        return _checked(value, hint, where)
    if origin is tuple:
        if isinstance(value, str) or not isinstance(value, list | tuple):
            raise InputError(f"{where} must be a sequence, got {value!r}.")
        return tuple(_checked(v, arguments[0], f"{where}[{i}]") for i, v in enumerate(value))
    # The numbers of other libraries, such as numpy's, are taken as Python's own.
    if isinstance(value, numbers.Real) and not isinstance(value, bool):
        if hint is float:
            try:
                value = float(value)
            except OverflowError:
                raise InputError(f"{where} must be finite, got a larger number.") from None
        elif hint is int and isinstance(value, numbers.Integral):
            value = int(value)
    if not isinstance(value, hint) or (hint is int and isinstance(value, bool)):
        raise InputError(f"{where} must be {hint.__name__}, got {value!r}.")
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{where} must be finite, got {value!r}.")
    return value


def _positive(default: Any) -> Any:
    return field(default=default, metadata={"positive": True})


def _widths(*default: int) -> Any:
    """Of hidden layers, at least one."""
    return field(default=default, metadata={"positive": True, "some": True})


@dataclass(frozen=True)
class Physics(_Section):
    """Blood, wall and stenosis (section 2.5 of the paper).

    Attributes
    ----------
    density, viscosity : float
        Of blood, g/cm³ and poise.
    young_modulus, wall_thickness : float
        Of the wall, dyn/cm² and cm; with the radius of the healthy inlet they
        give the stiffness E·h/r₀ of the temporal pressure stage.
    reference_pressure : float
        p_ref, dyn/cm² (100 mmHg).  Only a scale: p* = p / p_ref.
    stenosis_length, stenosis_position : float
        cm.  The paper prints no length; 0.5 cm was measured on its data.
    turbulent_coefficient : float
        K_t of Seeley and Young (1976).
    """

    density: float = _positive(1.06)
    viscosity: float = _positive(0.04)
    young_modulus: float = _positive(1.5e7)
    wall_thickness: float = _positive(0.05)
    reference_pressure: float = _positive(133_322.0)
    stenosis_length: float = _positive(0.5)
    stenosis_position: float = field(default=2.0, metadata={"signed": True})
    turbulent_coefficient: float = 1.52


@dataclass(frozen=True)
class BFGS(_Section):
    """The optimiser of every stage: Optim.jl's ``BFGS`` with ``BackTracking``.

    The paper names BFGS; these settings are those of the published code.

    Attributes
    ----------
    initial_step_norm : float
        The inverse Hessian starts as ``initial_step_norm / max|g|`` · I.
    sufficient_decrease, shrink_most, shrink_least : float
        c₁, ρ_lo and ρ_hi of the cubic backtracking line search.
    max_backtracks : int
        Trial steps before a line search is given up.
    gradient_tolerance : float
        A fit stops early when max|g| is not larger than this.
    """

    initial_step_norm: float = _positive(0.01)
    sufficient_decrease: float = _positive(1e-4)
    shrink_most: float = _positive(0.1)
    shrink_least: float = _positive(0.5)
    max_backtracks: int = _positive(1000)
    gradient_tolerance: float = 1e-8


@dataclass(frozen=True)
class FlowStage(_Section):
    """Momentum equation ∂Q/∂z = f_θ(Q, S) + physics terms, a neural ODE in z.

    Attributes
    ----------
    terms : tuple of {'friction', 'convection', 'inertia'}
        What section 3.6 adds to the network, of the 1D momentum equation solved for
        ∂Q/∂z: N/(2(1+δ)), ½ (Q/S) ∂S/∂z and −(S/Q) ∂Q/∂t/(2(1+δ)).  None in the paper's
        model: they make training harder (:mod:`pcnde_bridge.studies.landscapes`).
    hidden : tuple of int
        Widths of the hidden layers; input 2·n_t and output n_t follow the data.
    activation : str
        Between layers; the last layer is linear.
    epochs, iterations : int
        Passes through the batches, and BFGS iterations in each batch.
    couple_every : int
        Epochs between two couplings of the area back into the network's input.
    rtol, atol : float
        Of Tsit5's adaptive steps (defaults of DifferentialEquations.jl).
    first_step : float or None
        cm; None takes the grid's first spacing, as the published code does.
    max_steps : int
        Accepted and rejected steps after which a solve counts as diverged.
    steps : int or None
        Equal steps of Tsit5 in place of adaptive ones; then the four settings
        before this one do not matter.
    loss : {'mean', 'sum'}
        Mean (paper) or sum (published code) of squared errors.  The optimiser's
        path does not depend on the scale, but for its gradient tolerance.
    """

    terms: tuple[Term, ...] = ()
    hidden: tuple[int, ...] = _widths(8, 8, 8, 8)
    activation: Activation = "tanh"
    epochs: int = _positive(100)
    iterations: int = _positive(5)
    couple_every: int = _positive(25)
    rtol: float = _positive(1e-3)
    atol: float = _positive(1e-6)
    first_step: float | None = _positive(None)
    max_steps: int = _positive(256)
    steps: int | None = _positive(None)
    loss: Loss = "mean"


@dataclass(frozen=True)
class TemporalFlowStage(_Section):
    """Momentum equation ∂Q/∂t = f_θ(Q) or f_θ(Q, t), a neural ODE in time (section 2.3).

    The formulation that the paper compares its own with; no model is made of it
    (:mod:`pcnde_bridge.studies.formulations`).

    Attributes
    ----------
    hidden : tuple of int
        Widths of the hidden layers; input n_z, with time n_z + 1, and output n_z.
    activation : str
        Between layers; the last layer is linear.
    time_input : bool
        Whether t/T is the network's last input.
    steps : int
        Runge–Kutta steps from instant to instant.
    epochs, iterations : int
        Passes through the batches, and BFGS iterations in each batch.
    """

    hidden: tuple[int, ...] = _widths(8, 8, 8, 8)
    activation: Activation = "tanh"
    time_input: bool = False
    steps: int = _positive(1)
    epochs: int = _positive(100)
    iterations: int = _positive(5)


@dataclass(frozen=True)
class IntermediateAreaStage(_Section):
    """Continuity ∂Ŝ/∂t = −â(z) ∂Q/∂z + b̂(z), from S_u over some cycles.

    Attributes
    ----------
    cycles : int
        Cycles integrated; the loss is taken on the last one.
    iterations : int
        BFGS iterations in each batch, each time the area is coupled.
    """

    cycles: int = _positive(3)
    iterations: int = _positive(5)


@dataclass(frozen=True)
class FourierAreaStage(_Section):
    """Periodic area by Fourier series, S_n = −a(z)/(iω_n) ∂Q_n/∂z.

    Attributes
    ----------
    terms : int
        Number of terms with the mean, so harmonics 1 … terms − 1.
    iterations : int
        BFGS iterations in each batch, each time the area is coupled.
    anchor : {'last_instant', 'last_cycle', 'undeformed'}
        Where S₀ takes Ŝ(z, t=0) from.  The text does not say which of the
        integrated cycles' starts is t = 0; the default is the published code's
        reading, the end of the integration (the start of the next cycle, where
        the transient has died out).  'last_cycle' is the start of the cycle
        that is fitted, 'undeformed' the start of the first, which is S_u.  Only
        the default reaches the paper's training error (CONTRIBUTING has the
        measurement).
    frequency : {'harmonic', 'next'}
        ω_n (paper) or, with the published code, ω_{n+1} dividing harmonic n.
    sides : {'two', 'one'}
        The whole real series (paper), or its one-sided half (published code),
        which halves the amplitude that a(z) = 1 means.
    restart : bool
        False (paper) continues (a, b) from batch to batch; True (published
        code) starts each batch from a = 1, b = 0, so that only the last batch
        counts.
    """

    terms: int = field(default=10, metadata={"positive": True})
    iterations: int = _positive(5)
    anchor: Literal["last_instant", "last_cycle", "undeformed"] = "last_instant"
    frequency: Literal["harmonic", "next"] = "harmonic"
    sides: Literal["two", "one"] = "two"
    restart: bool = False


@dataclass(frozen=True)
class TemporalPressureStage(_Section):
    """First pressure stage, p̂* = 1 + E·h/(r₀·p_ref) g_θ(S, S − S_u, Δp, Q).

    Attributes
    ----------
    hidden : tuple of int
        Widths of the hidden layers; input 4·n_z and output n_z follow the data.
    activation : str
        tanh in the paper's text; the published weights fit GeLU.
    iterations : int
        BFGS iterations, on all training cases at once.
    pressure_drop_input : {'normalised', 'dyn'}
        Δp/p_ref as in the published code, or Δp in dyn/cm².  The text leaves
        the scale open; in dyn/cm² the input saturates every tanh.
    """

    hidden: tuple[int, ...] = _widths(2, 2)
    activation: Activation = "tanh"
    iterations: int = _positive(250)
    pressure_drop_input: Literal["normalised", "dyn"] = "normalised"


@dataclass(frozen=True)
class SpatialPressureStage(_Section):
    """Second pressure stage: constant, tanh at the stenosis, constant.

    Attributes
    ----------
    iterations : int
        BFGS iterations, on all training cases at once.
    form : {'continuous', 'printed'}
        The paper's equation as printed jumps by the whole pressure drop at
        z = L/3, against its own description (constant, tanh, constant) and
        figure.  'continuous' centres the tanh on the mean of p̂*, with half the
        drop on either side; 'printed' is the equation to the letter.
    """

    iterations: int = _positive(75)
    form: Literal["continuous", "printed"] = "continuous"


@dataclass(frozen=True)
class AllAtOnce(_Section):
    """Training on all cases at once, with least squares for all that is linear.

    Networks are fitted by L-BFGS without restarts, in whitened weights
    (:mod:`pcnde_bridge.training.lbfgs`); both area stages, the networks' last layers (that of the
    flow along the data's flow), a₁, a₂ and b₁ by least squares.  The numbers were compared
    by cross-validation inside the published training cases (CONTRIBUTING has the
    measurement, and what a look at the test cases had to do with it).

    Attributes
    ----------
    rounds : int
        Fits of the flow, each followed by a fit of the area, which is then coupled back.
        With a validation part, the first fits the networks to the other cases alone and
        stops by the validation part's error; the others go on from there on all cases.
    starts : int
        Fits of the flow in the first round, each from other random weights: the one of
        the least loss (or validation error, if there is a validation part) goes on.
    mean_flow : {'area', 'data'}
        Whose mean over the cycle the flow is fitted to: that which the data's area asks
        for (:func:`pcnde_bridge.training.full_batch.balanced_flow`), or the data's flow's.
    wave_weight : float
        Each case's squares of the flow count by its inflow's range over time to the power
        of minus this (:func:`pcnde_bridge.training.full_batch.wave_weight`); 0 counts all alike.
    known_flow_iterations : int
        L-BFGS iterations of each of these, and of the one in each later round, along the
        data's flow (:mod:`pcnde_bridge.training.collocation`).
    iterations, later_iterations : int
        L-BFGS iterations of the equation itself, in the first and in each later round; with
        physics terms the iterations before are added to them.
    pressure_iterations : int
        L-BFGS iterations of each of the pressure fits.
    memory : int
        Pairs of steps and gradient changes that L-BFGS keeps.
    validation : float
        Share of the cases, about, in the validation part, which is made of whole
        waveforms and whole geometries; with too few cases there is none.  0 fits all
        cases from the first round for the given iterations, which did better.
    patience, check_every : int
        Iterations without a lower validation error that end a fit, and between two looks.
    whitening : float
        Variance, in units of the largest, below which a component of a network's
        inputs is not amplified to the size of the others.
    weight_decay, pressure_weight_decay : float
        Of the flow's and the pressure's network: multiply the whitened weights' squares,
        beside the loss over the target's mean square.
    """

    rounds: int = _positive(2)
    starts: int = _positive(1)
    mean_flow: Literal["area", "data"] = "area"
    wave_weight: float = 1.5
    known_flow_iterations: int = _positive(120)
    iterations: int = _positive(20)
    later_iterations: int = _positive(60)
    pressure_iterations: int = _positive(100)
    memory: int = _positive(100)
    validation: float = 0.0
    patience: int = _positive(30)
    check_every: int = _positive(10)
    whitening: float = _positive(1e-1)
    weight_decay: float = 1e-7
    pressure_weight_decay: float = 1e-3


@dataclass(frozen=True)
class PCNDEConfig(_Settings):
    """All settings of a PCNDE, grouped per stage; the default is the paper's.

    Attributes
    ----------
    physics : Physics
        Constants of blood, wall and stenosis.
    optimiser : BFGS
        Settings of the optimiser that all stages share.
    flow, intermediate_area, fourier_area : stage settings
        Trained in turns, coupled.
    temporal_pressure, spatial_pressure : stage settings
        Trained after them.
    temporal_flow : TemporalFlowStage
        The formulation in time, which only a study uses.
    training : {'batches', 'all_at_once'}
        BFGS restarted in every batch (paper), or what ``all_at_once`` says; then the
        optimiser, the stages' epochs and iterations and the batch size do not matter.
    all_at_once : AllAtOnce
        Settings of that.
    batch_size : int
        Cases in a batch of the flow and area stages.
    coupling_passes : int
        Passes through flow and area at inference.

    Examples
    --------
    >>> from pcnde_bridge import PCNDEConfig
    >>> PCNDEConfig().replace(flow={"epochs": 10}).flow.epochs
    10
    """

    physics: Physics = Physics()
    optimiser: BFGS = BFGS()
    flow: FlowStage = FlowStage()
    intermediate_area: IntermediateAreaStage = IntermediateAreaStage()
    fourier_area: FourierAreaStage = FourierAreaStage()
    temporal_pressure: TemporalPressureStage = TemporalPressureStage()
    spatial_pressure: SpatialPressureStage = SpatialPressureStage()
    temporal_flow: TemporalFlowStage = TemporalFlowStage()
    training: Literal["batches", "all_at_once"] = "batches"
    all_at_once: AllAtOnce = AllAtOnce()
    batch_size: int = _positive(12)
    coupling_passes: int = _positive(3)


@dataclass(frozen=True)
class OutletClosure(_Section):
    """Outlet condition p(L) = p_d + 𝒵 Q(L); what is None is learned.

    Attributes
    ----------
    resistance : float or None
        R₁ + R₂, dyn·s/cm⁵.
    distal_pressure : float or None
        p_d, dyn/cm².
    kind : {'auto', 'resistance', 'windkessel'}
        A resistance, or a three-element Windkessel 𝒵 = R₁ + R₂/(1 + iωR₂C).
        'auto' takes the resistance unless it misses the training cases' outlet
        pressure by more than 1 % of its variation.
    """

    resistance: float | None = _positive(None)
    distal_pressure: float | None = field(default=None, metadata={"signed": True})
    kind: Literal["auto", "resistance", "windkessel"] = "auto"


@dataclass(frozen=True)
class LossClosure(_Section):
    """Pressure losses along the vessel; what is None is learned.

    Attributes
    ----------
    friction, inertia, convection : float or None
        c_f, c_i and c_m of :mod:`pcnde_bridge.engines.jax.closures.pressure_losses`; 1 is
        Poiseuille's friction and a flat profile's momentum.
    jet_spread : float or None
        Growth of a free jet's radius per length of the way.
    """

    friction: float | None = _positive(None)
    inertia: float | None = _positive(None)
    convection: float | None = _positive(None)
    jet_spread: float | None = _positive(None)


@dataclass(frozen=True)
class WallClosure(_Section):
    """Wall; what is None is learned.

    Attributes
    ----------
    law : {'auto', 'membrane', 'local'}
        An elastic membrane clamped at both ends, as in 3D fluid–structure
        simulations, or a tube law, as in 1D solvers.  'auto' takes the membrane
        if the ends of the training cases do not move.
    stiffness : float or None
        K = E·h/(1 − ν²), dyn/cm, of the membrane; K in p = K·(√(S/S_u) − 1) at
        the inlet, dyn/cm², of the tube law.
    poisson, shear, support : float or None
        ν, the shear ratio and the axial support (1/cm²) of the membrane.
    exponent : float or None
        m of the tube law's K·(r_0/r_u)^m.
    zero_pressure : float or None
        p₀, at which the wall is undeformed, dyn/cm².
    """

    law: Literal["auto", "membrane", "local"] = "auto"
    stiffness: float | None = _positive(None)
    poisson: float | None = None
    shear: float | None = _positive(None)
    support: float | None = _positive(None)
    exponent: float | None = field(default=None, metadata={"signed": True})
    zero_pressure: float | None = field(default=None, metadata={"signed": True})


@dataclass(frozen=True)
class CorrectionClosure(_Section):
    """Continuity's factor and the learned correction.

    Attributes
    ----------
    storage : float or None
        κ in ∂Q/∂z = −κ(1 − g)·∂S/∂t; 1 conserves volume.  None learns it: averaged
        3D simulations need not conserve it.
    hidden : tuple of int
        Widths of the correction's hidden layers; none makes it logistic.
    weight_decay : float
        Of the network's weights.
    evaluations : int
        Largest number of evaluations of a fit.
    passes : int
        Coupling passes of flow, area and pressure.
    folds : int
        Parts into which the training cases' geometries, and once more their
        waveforms, are divided to hold them out in turns; the fits without a part
        are the ensemble that gives the uncertainty.  At least 2; 0 leaves it out.
    """

    storage: float | None = _positive(None)
    hidden: tuple[int, ...] = _positive(())
    weight_decay: float = 1e-4
    evaluations: int = _positive(60)
    passes: int = _positive(8)
    folds: int = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.folds == 1:
            raise InputError(
                "CorrectionClosure.folds must be 0 or at least 2: one part is all of the cases."
            )


@dataclass(frozen=True)
class ClosureConfig(_Settings):
    """All settings of the ``physics`` preset; see :mod:`pcnde_bridge.closures`.

    Attributes
    ----------
    physics : Physics
        Density and viscosity of blood are used.
    outlet, losses, wall, correction : closure settings
        Fitted in this order.
    """

    physics: Physics = Physics()
    outlet: OutletClosure = OutletClosure()
    losses: LossClosure = LossClosure()
    wall: WallClosure = WallClosure()
    correction: CorrectionClosure = CorrectionClosure()


PAPER = PCNDEConfig()
"""The paper's text, all of its numbers."""

PUBLISHED_CODE = PAPER.replace(
    flow={"loss": "sum"},
    fourier_area={
        "frequency": "next",
        "sides": "one",
        "restart": True,
    },
    temporal_pressure={"activation": "gelu"},
)
"""What the authors' published code and weights do, where it differs from the text."""

FAST = PAPER.replace(training="all_at_once", flow={"steps": 12})
"""The paper's equations and parameters, trained all at once, in seconds.

Twelve equal steps solve the momentum equation as exactly as the adaptive ones do."""

PHYSICS = ClosureConfig()
"""Closures that obey what the data obey; see :mod:`pcnde_bridge.closures`."""

PRESETS: Mapping[str, PCNDEConfig | ClosureConfig] = types.MappingProxyType(
    {"paper": PAPER, "published-code": PUBLISHED_CODE, "fast": FAST, "physics": PHYSICS}
)
"""The named configurations, as ``--preset`` and ``PCNDE.fit(config=…)`` know them."""


def config_from(settings: Any) -> PCNDEConfig | ClosureConfig:
    """Read the settings that a file keeps; only the closures' have a group ``outlet``.

    Raises
    ------
    InputError
        If a name is unknown or a value is not usable.
    """
    if isinstance(settings, Mapping) and "outlet" in settings:
        return ClosureConfig.from_dict(settings)
    if isinstance(settings, Mapping) and settings.get("training") == "all_at_once":
        group = settings.get("all_at_once")
        if isinstance(group, Mapping):
            # Before there was this setting, all cases counted alike.
            settings = {**settings, "all_at_once": {"wave_weight": 0.0, **group}}
    return PCNDEConfig.from_dict(settings)


def resolve_config(config: PCNDEConfig | ClosureConfig | str) -> PCNDEConfig | ClosureConfig:
    """Return a configuration given as itself or by its preset's name.

    Raises
    ------
    InputError
        If there is no preset of that name.
    """
    if isinstance(config, PCNDEConfig | ClosureConfig):
        return config
    if isinstance(config, str) and config in PRESETS:
        return PRESETS[config]
    raise InputError(f"Unknown preset {config!r}; the presets are {sorted(PRESETS)}.")


def resolve_pcnde_config(config: PCNDEConfig | ClosureConfig | str) -> PCNDEConfig:
    """Return a configuration of the paper's equations, given as itself or by its preset's name.

    Raises
    ------
    InputError
        If there is no preset of that name, or its equations are others.
    """
    found = resolve_config(config)
    if not isinstance(found, PCNDEConfig):
        raise InputError(
            "This study is of the paper's equations: give a PCNDEConfig or its preset ('paper', "
            "'published-code', 'fast'), not one of the preset 'physics'."
        )
    return found
