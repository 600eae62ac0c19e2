"""Uncertainty of a prediction: calibrated samples, and the distance from the training data.

The training uses it to calibrate a model, and the model to draw samples.
"""

from pcnde_bridge.uncertainty.calibration import Calibration
from pcnde_bridge.uncertainty.novelty import Novelty, OutsideTrainingWarning
from pcnde_bridge.uncertainty.sampling import Uncertainty

__all__ = ["Calibration", "Novelty", "OutsideTrainingWarning", "Uncertainty"]
