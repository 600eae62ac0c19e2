"""Evaluation of complete models: cross-validation, sweeps, baselines and benchmarks.

Its functions fit and predict as a user does, and return tables of errors and times.
"""

from pcnde_bridge.evaluation.baselines import (
    DropRegression,
    ResponseSurface,
    Solver1D,
    StenosisLoss,
    Unchanged,
    standard_baselines,
)
from pcnde_bridge.evaluation.benchmark import bench_baseline, bench_model
from pcnde_bridge.evaluation.cross_validation import cross_validate
from pcnde_bridge.evaluation.learning_curve import learning_curve
from pcnde_bridge.evaluation.parameter_fit import Calibration, calibrate
from pcnde_bridge.evaluation.sensitivity import sobol_indices
from pcnde_bridge.evaluation.sweep import sweep

__all__ = [
    "Calibration",
    "DropRegression",
    "ResponseSurface",
    "Solver1D",
    "StenosisLoss",
    "Unchanged",
    "bench_baseline",
    "bench_model",
    "calibrate",
    "cross_validate",
    "learning_curve",
    "sobol_indices",
    "standard_baselines",
    "sweep",
]
