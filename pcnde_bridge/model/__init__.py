"""User-facing objects: ``PCNDE``, ``Ensemble`` and ``Prediction``.

They combine training, engines and uncertainty, and are saved to files.
"""

from pcnde_bridge.model.ensemble import Ensemble, load_model
from pcnde_bridge.model.metrics import coverage, error_table, pooled_errors, relative_error
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.model.prediction_file import predict_to_file

__all__ = [
    "PCNDE",
    "Ensemble",
    "Prediction",
    "coverage",
    "error_table",
    "load_model",
    "pooled_errors",
    "predict_to_file",
    "relative_error",
]
