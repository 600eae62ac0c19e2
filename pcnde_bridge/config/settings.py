"""Settings of the method, one immutable dataclass per group, in CGS units.

Defaults follow the text of Csala, Mohan, Livescu and Arzani (2024).  Where the
published code differs, the difference is a named option of its stage.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pcnde_bridge.config.validation import Section, Settings, layer_widths, positive, signed
from pcnde_bridge.errors import InputError

Activation = Literal["tanh", "gelu", "relu", "sigmoid", "swish"]
Loss = Literal["mean", "sum"]
Term = Literal["friction", "convection", "inertia"]


@dataclass(frozen=True)
class Physics(Section):
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

    density: float = positive(1.06)
    viscosity: float = positive(0.04)
    young_modulus: float = positive(1.5e7)
    wall_thickness: float = positive(0.05)
    reference_pressure: float = positive(133_322.0)
    stenosis_length: float = positive(0.5)
    stenosis_position: float = signed(2.0)
    turbulent_coefficient: float = 1.52


@dataclass(frozen=True)
class BFGS(Section):
    """The optimizer of every stage: Optim.jl's ``BFGS`` with ``BackTracking``.

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

    initial_step_norm: float = positive(0.01)
    sufficient_decrease: float = positive(1e-4)
    shrink_most: float = positive(0.1)
    shrink_least: float = positive(0.5)
    max_backtracks: int = positive(1000)
    gradient_tolerance: float = 1e-8


@dataclass(frozen=True)
class FlowStage(Section):
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
        Mean (paper) or sum (published code) of squared errors.  The optimizer's
        path does not depend on the scale, but for its gradient tolerance.
    """

    terms: tuple[Term, ...] = ()
    hidden: tuple[int, ...] = layer_widths(8, 8, 8, 8)
    activation: Activation = "tanh"
    epochs: int = positive(100)
    iterations: int = positive(5)
    couple_every: int = positive(25)
    rtol: float = positive(1e-3)
    atol: float = positive(1e-6)
    first_step: float | None = positive(None)
    max_steps: int = positive(256)
    steps: int | None = positive(None)
    loss: Loss = "mean"


@dataclass(frozen=True)
class TemporalFlowStage(Section):
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

    hidden: tuple[int, ...] = layer_widths(8, 8, 8, 8)
    activation: Activation = "tanh"
    time_input: bool = False
    steps: int = positive(1)
    epochs: int = positive(100)
    iterations: int = positive(5)


@dataclass(frozen=True)
class IntermediateAreaStage(Section):
    """Continuity ∂Ŝ/∂t = −â(z) ∂Q/∂z + b̂(z), from S_u over some cycles.

    Attributes
    ----------
    cycles : int
        Cycles integrated; the loss is taken on the last one.
    iterations : int
        BFGS iterations in each batch, each time the area is coupled.
    """

    cycles: int = positive(3)
    iterations: int = positive(5)


@dataclass(frozen=True)
class FourierAreaStage(Section):
    """Periodic area by Fourier series, S_n = −a(z)/(iω_n) ∂Q_n/∂z.

    Attributes
    ----------
    terms : int
        Number of terms with the mean, so harmonics 1 … terms − 1.
    iterations : int
        BFGS iterations in each batch, each time the area is coupled.
    anchor : {'last_time_point', 'last_cycle', 'undeformed'}
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

    terms: int = positive(10)
    iterations: int = positive(5)
    anchor: Literal["last_time_point", "last_cycle", "undeformed"] = "last_time_point"
    frequency: Literal["harmonic", "next"] = "harmonic"
    sides: Literal["two", "one"] = "two"
    restart: bool = False


@dataclass(frozen=True)
class TemporalPressureStage(Section):
    """First pressure stage, p̂* = 1 + E·h/(r₀·p_ref) g_θ(S, S − S_u, Δp, Q).

    Attributes
    ----------
    hidden : tuple of int
        Widths of the hidden layers; input 4·n_z and output n_z follow the data.
    activation : str
        tanh in the paper's text; the published weights fit GeLU.
    iterations : int
        BFGS iterations, on all training cases at once.
    pressure_drop_input : {'normalized', 'dyn'}
        Δp/p_ref as in the published code, or Δp in dyn/cm².  The text leaves
        the scale open; in dyn/cm² the input saturates every tanh.
    """

    hidden: tuple[int, ...] = layer_widths(2, 2)
    activation: Activation = "tanh"
    iterations: int = positive(250)
    pressure_drop_input: Literal["normalized", "dyn"] = "normalized"


@dataclass(frozen=True)
class SpatialPressureStage(Section):
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

    iterations: int = positive(75)
    form: Literal["continuous", "printed"] = "continuous"


@dataclass(frozen=True)
class FullBatch(Section):
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
    amplitude_exponent : float
        Each case's squares of the flow count by its inflow's range over time to the power
        of minus this (:func:`pcnde_bridge.training.full_batch.wave_weight`); 0 counts all alike.
    collocation_iterations : int
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

    rounds: int = positive(2)
    starts: int = positive(1)
    mean_flow: Literal["area", "data"] = "area"
    amplitude_exponent: float = 1.5
    collocation_iterations: int = positive(120)
    iterations: int = positive(20)
    later_iterations: int = positive(60)
    pressure_iterations: int = positive(100)
    memory: int = positive(100)
    validation: float = 0.0
    patience: int = positive(30)
    check_every: int = positive(10)
    whitening: float = positive(1e-1)
    weight_decay: float = 1e-7
    pressure_weight_decay: float = 1e-3


@dataclass(frozen=True)
class PCNDEConfig(Settings):
    """All settings of a PCNDE, grouped per stage; the default is the paper's.

    Attributes
    ----------
    physics : Physics
        Constants of blood, wall and stenosis.
    optimizer : BFGS
        Settings of the optimizer that all stages share.
    flow, intermediate_area, fourier_area : stage settings
        Trained in turns, coupled.
    temporal_pressure, spatial_pressure : stage settings
        Trained after them.
    temporal_flow : TemporalFlowStage
        The formulation in time, which only a study uses.
    training : {'minibatch', 'full_batch'}
        BFGS restarted in every batch (paper), or what ``full_batch`` says; then the
        optimizer, the stages' epochs and iterations and the batch size do not matter.
    full_batch : FullBatch
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
    optimizer: BFGS = BFGS()
    flow: FlowStage = FlowStage()
    intermediate_area: IntermediateAreaStage = IntermediateAreaStage()
    fourier_area: FourierAreaStage = FourierAreaStage()
    temporal_pressure: TemporalPressureStage = TemporalPressureStage()
    spatial_pressure: SpatialPressureStage = SpatialPressureStage()
    temporal_flow: TemporalFlowStage = TemporalFlowStage()
    training: Literal["minibatch", "full_batch"] = "minibatch"
    full_batch: FullBatch = FullBatch()
    batch_size: int = positive(12)
    coupling_passes: int = positive(3)


@dataclass(frozen=True)
class OutletClosure(Section):
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

    resistance: float | None = positive(None)
    distal_pressure: float | None = signed(None)
    kind: Literal["auto", "resistance", "windkessel"] = "auto"


@dataclass(frozen=True)
class LossClosure(Section):
    """Pressure losses along the vessel; what is None is learned.

    Attributes
    ----------
    friction, inertia, convection : float or None
        c_f, c_i and c_m of :mod:`pcnde_bridge.engines.jax.closures.pressure_losses`; 1 is
        Poiseuille's friction and a flat profile's momentum.
    jet_spread : float or None
        Growth of a free jet's radius per length of the way.
    """

    friction: float | None = positive(None)
    inertia: float | None = positive(None)
    convection: float | None = positive(None)
    jet_spread: float | None = positive(None)


@dataclass(frozen=True)
class WallClosure(Section):
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
    stiffness: float | None = positive(None)
    poisson: float | None = None
    shear: float | None = positive(None)
    support: float | None = positive(None)
    exponent: float | None = signed(None)
    zero_pressure: float | None = signed(None)


@dataclass(frozen=True)
class CorrectionClosure(Section):
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

    storage: float | None = positive(None)
    hidden: tuple[int, ...] = positive(())
    weight_decay: float = 1e-4
    evaluations: int = positive(60)
    passes: int = positive(8)
    folds: int = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.folds == 1:
            raise InputError(
                "CorrectionClosure.folds must be 0 or at least 2: one part is all of the cases."
            )


@dataclass(frozen=True)
class ClosureConfig(Settings):
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
