"""Settings of the method, one immutable dataclass per group, in CGS units.

Defaults follow the text of Csala, Mohan, Livescu and Arzani (2024).  Where the published
code differs, the difference is a named option of its stage.
"""

from dataclasses import dataclass
from typing import Literal

from pcnde_bridge.config.validation import Section, Settings, layer_widths, positive, signed
from pcnde_bridge.errors import InputError

Activation = Literal["tanh", "gelu", "relu", "sigmoid", "swish"]
Loss = Literal["mean", "sum"]
Term = Literal["friction", "convection", "inertia"]


@dataclass(frozen=True, repr=False)
class Physics(Section):
    """Blood, wall and stenosis (section 2.5 of the paper).

    Attributes
    ----------
    density, viscosity : float
        Density and dynamic viscosity of blood, g/cm³ and poise.
    young_modulus, wall_thickness : float
        Young's modulus and thickness of the wall, dyn/cm² and cm; with the radius of the
        healthy inlet they give the stiffness E·h/r₀ of the temporal pressure stage.
    reference_pressure : float
        Reference pressure p_ref, dyn/cm² (100 mmHg); only a scale: p* = p / p_ref.
    stenosis_length, stenosis_position : float
        Length and center of the stenosis, cm.  The paper does not state the length; 0.5 cm
        was measured on its data.
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


@dataclass(frozen=True, repr=False)
class BFGS(Section):
    """Optimizer of every stage: Optim.jl's ``BFGS`` with ``BackTracking``.

    The paper names BFGS; these settings are those of the published code.

    Attributes
    ----------
    initial_step_norm : float
        The inverse Hessian starts as ``initial_step_norm / max|g|`` · I.
    sufficient_decrease, shrink_most, shrink_least : float
        c₁, ρ_lo and ρ_hi of the cubic backtracking line search.
    max_backtracks : int
        Largest number of trial steps of a line search.
    gradient_tolerance : float
        A fit stops early when max|g| is not larger than this.
    """

    initial_step_norm: float = positive(0.01)
    sufficient_decrease: float = positive(1e-4)
    shrink_most: float = positive(0.1)
    shrink_least: float = positive(0.5)
    max_backtracks: int = positive(1000)
    gradient_tolerance: float = 1e-8


@dataclass(frozen=True, repr=False)
class FlowStage(Section):
    """Momentum equation ∂Q/∂z = f_θ(Q, S) + physics terms, a neural ODE in z.

    Attributes
    ----------
    terms : tuple of {'friction', 'convection', 'inertia'}
        Terms of the 1D momentum equation, solved for ∂Q/∂z, that are added to the network
        (section 3.6): N/(2(1+δ)), ½ (Q/S) ∂S/∂z and −(S/Q) ∂Q/∂t/(2(1+δ)).  The paper's
        model has none: they make training harder (:mod:`pcnde_bridge.studies.landscapes`).
    hidden : tuple of int
        Widths of the hidden layers; input 2·n_t and output n_t follow the data.
    activation : str
        Activation of the hidden layers; the last layer is linear.
    epochs, iterations : int
        Passes through the batches, and BFGS iterations in each batch.
    couple_every : int
        Epochs between two couplings of the area into the input of the network.
    rtol, atol : float
        Tolerances of Tsit5's adaptive steps (defaults of DifferentialEquations.jl).
    first_step : float or None
        First step, cm; None uses the first spacing of the grid, as the published code does.
    max_steps : int
        Accepted and rejected steps after which a solution counts as diverged.
    steps : int or None
        Number of equal steps of Tsit5 instead of adaptive ones, for which the previous
        four settings have no effect.
    loss : {'mean', 'sum'}
        Mean (paper) or sum (published code) of squared errors.  Except for the gradient
        tolerance, the optimizer does not depend on this scale.
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


@dataclass(frozen=True, repr=False)
class TemporalFlowStage(Section):
    """Momentum equation ∂Q/∂t = f_θ(Q) or f_θ(Q, t), a neural ODE in time (section 2.3).

    The paper compares its formulation with this one, which is used only in a study
    (:mod:`pcnde_bridge.studies.formulations`).

    Attributes
    ----------
    hidden : tuple of int
        Widths of the hidden layers; input n_z, with time n_z + 1, and output n_z.
    activation : str
        Activation of the hidden layers; the last layer is linear.
    time_input : bool
        Whether t/T is the last input of the network.
    steps : int
        Runge–Kutta steps between two time points.
    epochs, iterations : int
        Passes through the batches, and BFGS iterations in each batch.
    """

    hidden: tuple[int, ...] = layer_widths(8, 8, 8, 8)
    activation: Activation = "tanh"
    time_input: bool = False
    steps: int = positive(1)
    epochs: int = positive(100)
    iterations: int = positive(5)


@dataclass(frozen=True, repr=False)
class IntermediateAreaStage(Section):
    """Continuity equation ∂Ŝ/∂t = −â(z) ∂Q/∂z + b̂(z), from S_u over some cycles.

    Attributes
    ----------
    cycles : int
        Number of integrated cycles; the loss is computed on the last one.
    iterations : int
        BFGS iterations in each batch, each time the area is coupled.
    """

    cycles: int = positive(3)
    iterations: int = positive(5)


@dataclass(frozen=True, repr=False)
class FourierAreaStage(Section):
    """Periodic area as a Fourier series, S_n = −a(z)/(iω_n) ∂Q_n/∂z.

    Attributes
    ----------
    terms : int
        Number of terms including the mean, so harmonics 1 … terms − 1.
    iterations : int
        BFGS iterations in each batch, each time the area is coupled.
    anchor : {'last_time_point', 'last_cycle', 'undeformed'}
        Time point of Ŝ from which S₀ is computed.  The paper does not state which start
        of the integrated cycles is t = 0.  'last_time_point' is the end of the integration,
        as in the published code: the start of the next cycle, where the transient has
        decayed.  'last_cycle' is the start of the fitted cycle, 'undeformed' the start of
        the first one, which is S_u.  Only the default reaches the paper's training error
        (decision 001 in the documentation).
    frequency : {'harmonic', 'next'}
        Frequency that divides harmonic n: ω_n (paper) or ω_{n+1} (published code).
    sides : {'two', 'one'}
        Complete real series (paper), or its one-sided half (published code), which halves
        the amplitude for a(z) = 1.
    restart : bool
        False (paper) continues (a, b) from batch to batch; True (published code) starts
        each batch from a = 1, b = 0, so that only the last batch matters.
    """

    terms: int = positive(10)
    iterations: int = positive(5)
    anchor: Literal["last_time_point", "last_cycle", "undeformed"] = "last_time_point"
    frequency: Literal["harmonic", "next"] = "harmonic"
    sides: Literal["two", "one"] = "two"
    restart: bool = False


@dataclass(frozen=True, repr=False)
class TemporalPressureStage(Section):
    """First pressure stage, p̂* = 1 + E·h/(r₀·p_ref) g_θ(S, S − S_u, Δp, Q).

    Attributes
    ----------
    hidden : tuple of int
        Widths of the hidden layers; input 4·n_z and output n_z follow the data.
    activation : str
        Activation of the hidden layers: tanh in the paper's text; the published weights
        fit GeLU.
    iterations : int
        BFGS iterations, on all training cases together.
    pressure_drop_input : {'normalized', 'dyn'}
        Δp/p_ref, as in the published code, or Δp in dyn/cm².  The paper does not state the
        scale; in dyn/cm² the input saturates every tanh.
    """

    hidden: tuple[int, ...] = layer_widths(2, 2)
    activation: Activation = "tanh"
    iterations: int = positive(250)
    pressure_drop_input: Literal["normalized", "dyn"] = "normalized"


@dataclass(frozen=True, repr=False)
class SpatialPressureStage(Section):
    """Second pressure stage: constant, tanh at the stenosis, constant.

    Attributes
    ----------
    iterations : int
        BFGS iterations, on all training cases together.
    form : {'continuous', 'printed'}
        'printed' is the paper's equation, which jumps by the whole pressure drop at
        z = L/3, contrary to its description (constant, tanh, constant) and figure.
        'continuous' centers the tanh on the mean of p̂*, with half the drop on either side.
    """

    iterations: int = positive(75)
    form: Literal["continuous", "printed"] = "continuous"


@dataclass(frozen=True, repr=False)
class FullBatch(Section):
    """Training on all cases together, with least squares for linear parameters.

    Networks are fitted by L-BFGS without restarts, in whitened weights
    (:mod:`pcnde_bridge.training.lbfgs`).  Least squares solve for both area stages, the last
    layers of the networks (for the flow during collocation), a₁, a₂ and b₁.  The defaults
    were compared by cross-validation inside the published training cases (decision 008 in
    the documentation).

    Attributes
    ----------
    most_cases : int
        Largest number of cases in use; of more training cases, this many are chosen at random,
        the same ones for every seed.
    rounds : int
        Number of fits of the flow, each followed by a fit of the area, which is then coupled
        back.
    mean_flow : {'area', 'data'}
        Source of the mean over the cycle of the flow's target: consistent with the
        reference area (:func:`pcnde_bridge.training.flow_fit.balanced_flow`), or the mean
        of the reference flow.
    amplitude_exponent : float
        The squared flow errors of a case are weighted by the range of its inflow to the
        power of minus this exponent; 0 weights all cases alike.
    collocation_iterations : int
        L-BFGS iterations of the fit by collocation on the reference flow in each round
        (:mod:`pcnde_bridge.training.collocation`).
    iterations, later_iterations : int
        L-BFGS iterations of the equation itself, in the first and in each later round; with
        physics terms, the iterations of collocation are added to them.
    pressure_iterations : int
        L-BFGS iterations of each pressure stage.
    memory : int
        Pairs of steps and gradient changes that L-BFGS stores.
    whitening : float
        Variance, relative to the largest, below which a component of a network's inputs is
        not amplified to the size of the others.
    weight_decay, pressure_weight_decay : float
        Factors, for the networks of flow and pressure, of the squared whitened weights in
        the objective, in which the loss is divided by the mean square of the target.
    """

    most_cases: int = positive(512)
    rounds: int = positive(2)
    mean_flow: Literal["area", "data"] = "area"
    amplitude_exponent: float = 1.5
    collocation_iterations: int = positive(120)
    iterations: int = positive(20)
    later_iterations: int = positive(60)
    pressure_iterations: int = positive(100)
    memory: int = positive(100)
    whitening: float = positive(1e-1)
    weight_decay: float = 1e-7
    pressure_weight_decay: float = 1e-3


@dataclass(frozen=True, repr=False)
class PCNDEConfig(Settings):
    """All settings of a PCNDE, grouped per stage; the default is the paper's.

    Attributes
    ----------
    physics : Physics
        Constants of blood, wall and stenosis.
    optimizer : BFGS
        Settings of the optimizer that all stages share.
    flow, intermediate_area, fourier_area : stage settings
        Stages that are trained alternately and coupled.
    temporal_pressure, spatial_pressure : stage settings
        Stages that are trained after them.
    temporal_flow : TemporalFlowStage
        Formulation in time, which only a study uses.
    training : {'minibatch', 'full_batch'}
        BFGS restarted in every batch (paper), or the procedure of ``full_batch``, for which
        the optimizer, the stages' epochs and iterations and the batch size have no effect.
    full_batch : FullBatch
        Settings of training on all cases together.
    batch_size : int
        Cases per batch of the flow and area stages.
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


@dataclass(frozen=True, repr=False)
class OutletClosure(Section):
    """Outlet condition p(L) = p_d + 𝒵 Q(L); values of None are trained.

    Attributes
    ----------
    resistance : float or None
        Total resistance R₁ + R₂, dyn·s/cm⁵.
    distal_pressure : float or None
        Distal pressure p_d, dyn/cm².
    kind : {'auto', 'resistance', 'windkessel'}
        A resistance, or a three-element Windkessel 𝒵 = R₁ + R₂/(1 + iωR₂C).  'auto' is a
        resistance unless its error in the outlet pressure of the training cases exceeds
        1 % of the pressure's variation.
    """

    resistance: float | None = positive(None)
    distal_pressure: float | None = signed(None)
    kind: Literal["auto", "resistance", "windkessel"] = "auto"


@dataclass(frozen=True, repr=False)
class LossClosure(Section):
    """Pressure losses along the vessel; values of None are trained.

    The equations are those of :mod:`pcnde_bridge.engines.jax.closures.pressure_losses`.

    Attributes
    ----------
    friction, inertia : float or None
        c_f and c_i; 1 means Poiseuille's friction and the inertia of a flat profile.
    core : float or None
        c_c, factor of the dynamic pressure of the core; 1 means Bernoulli's equation.
    layer_growth : float or None
        c_g, growth of the boundary layer by viscosity; 1 means a quadratic profile.
    jet_momentum : float or None
        β, momentum of the flow that fills the vessel over that of a uniform flow.
    jet_recovery : float or None
        c_j, factor of the pressure that the jet recovers.
    jet_friction : float or None
        c_s, friction of separated flow over Poiseuille's.
    jet_spread, jet_viscous_spread : float or None
        s and s_ν, growth of the jet's radius by turbulence and by viscosity.
    jet_lag : float or None
        λ, lag of the jet behind the flow; 1 means that its fluid keeps its speed.
    spacing : float or None
        Distance of the points at which all closures are solved, cm.  Training sets it to a
        tenth of the mean radius at the inlets of the training cases.
    """

    friction: float | None = positive(None)
    inertia: float | None = positive(None)
    core: float | None = positive(None)
    layer_growth: float | None = positive(None)
    jet_momentum: float | None = positive(None)
    jet_recovery: float | None = positive(None)
    jet_friction: float | None = positive(None)
    jet_spread: float | None = positive(None)
    jet_viscous_spread: float | None = positive(None)
    jet_lag: float | None = positive(None)
    spacing: float | None = positive(None)


@dataclass(frozen=True, repr=False)
class WallClosure(Section):
    """Wall parameters; values of None are trained.

    Attributes
    ----------
    law : {'auto', 'membrane', 'local'}
        An elastic membrane clamped at both ends, as in 3D fluid–structure simulations, or
        a tube law, as in 1D solvers.  'auto' is the membrane if the ends of the training
        cases do not move.
    stiffness : float or None
        K = E·h/(1 − ν²), dyn/cm, of the membrane; K in p = K·(√(S/S_u) − 1) at the inlet,
        dyn/cm², of the tube law.
    poisson, shear, support : float or None
        Poisson's ratio ν, shear ratio and axial support (1/cm²) of the membrane.
    exponent : float or None
        m of the tube law's K·(r_0/r_u)^m.
    zero_pressure : float or None
        Pressure p₀ of the undeformed wall, dyn/cm².
    """

    law: Literal["auto", "membrane", "local"] = "auto"
    stiffness: float | None = positive(None)
    poisson: float | None = None
    shear: float | None = positive(None)
    support: float | None = positive(None)
    exponent: float | None = signed(None)
    zero_pressure: float | None = signed(None)


@dataclass(frozen=True, repr=False)
class CorrectionClosure(Section):
    """Factor of the continuity equation and the trained correction.

    Attributes
    ----------
    storage : float or None
        κ in ∂Q/∂z = −κ(1 − g)·∂S/∂t; 1 conserves volume.  None trains it: averaged 3D
        simulations need not conserve volume.
    hidden : tuple of int
        Widths of the hidden layers of the correction; without any it is logistic.
    weight_decay : float
        Weight decay of the network.
    evaluations : int
        Largest number of evaluations of a fit.
    passes : int
        Coupling passes of flow, area and pressure.
    folds : int
        Number of folds into which the geometries of the training cases, and separately their
        waveforms, are divided.  The fits that leave out one fold each are the ensemble for
        the uncertainty.  At least 2; 0 omits the uncertainty.
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
                "CorrectionClosure.folds must be 0 or at least 2: a single fold has all cases."
            )


@dataclass(frozen=True, repr=False)
class ClosureConfig(Settings):
    """All settings of the ``physics`` preset; see :mod:`pcnde_bridge.engines.jax.closures`.

    Attributes
    ----------
    physics : Physics
        Constants, of which density and viscosity of blood are used.
    outlet, losses, wall, correction : closure settings
        Closures, fitted in this order.
    """

    physics: Physics = Physics()
    outlet: OutletClosure = OutletClosure()
    losses: LossClosure = LossClosure()
    wall: WallClosure = WallClosure()
    correction: CorrectionClosure = CorrectionClosure()


Config = PCNDEConfig | ClosureConfig
"""Settings of either kind of model."""
