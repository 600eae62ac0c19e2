"""The paper's further studies of a trained model, one module for each."""

from pcnde_bridge.studies.activations import ACTIVATIONS, activation_study
from pcnde_bridge.studies.errors import (
    PointwiseErrors,
    box_statistics,
    error_matrix,
    pointwise_errors,
)
from pcnde_bridge.studies.fourier_effect import FourierEffect, fourier_effect
from pcnde_bridge.studies.noise import NoiseStudy, NoisyInput, noise_study
from pcnde_bridge.studies.pressure_drop import PressureDrops, pressure_drops

__all__ = [
    "ACTIVATIONS",
    "FourierEffect",
    "NoiseStudy",
    "NoisyInput",
    "PointwiseErrors",
    "PressureDrops",
    "activation_study",
    "box_statistics",
    "error_matrix",
    "fourier_effect",
    "noise_study",
    "pointwise_errors",
    "pressure_drops",
]
