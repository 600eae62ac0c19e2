"""Uncertainty of a prediction: calibrated samples, and the distance from the training data.

Training calibrates a model's uncertainty here, and the model draws samples with it.
"""

from pcnde_bridge.uncertainty.calibration import Calibration
from pcnde_bridge.uncertainty.novelty import Novelty, OutsideTrainingWarning
from pcnde_bridge.uncertainty.sampling import Uncertainty

__all__ = ["Calibration", "Novelty", "OutsideTrainingWarning", "Uncertainty"]
