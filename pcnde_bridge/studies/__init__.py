"""The paper's further studies: each a function with a typed result, one module for each."""

from pcnde_bridge.studies.activations import ACTIVATIONS, activation_study
from pcnde_bridge.studies.errors import (
    PointwiseErrors,
    box_statistics,
    error_matrix,
    pointwise_errors,
)
from pcnde_bridge.studies.formulations import FormulationStudy, compare_formulations
from pcnde_bridge.studies.fourier_effect import FourierEffect, fourier_effect
from pcnde_bridge.studies.landscapes import (
    Landscape,
    LandscapeStudy,
    explore_landscapes,
    loss_landscape,
)
from pcnde_bridge.studies.noise import NoiseStudy, NoisyInput, noise_study
from pcnde_bridge.studies.pressure_drop import PressureDrops, pressure_drops

__all__ = [
    "ACTIVATIONS",
    "FormulationStudy",
    "FourierEffect",
    "Landscape",
    "LandscapeStudy",
    "NoiseStudy",
    "NoisyInput",
    "PointwiseErrors",
    "PressureDrops",
    "activation_study",
    "box_statistics",
    "compare_formulations",
    "error_matrix",
    "explore_landscapes",
    "fourier_effect",
    "loss_landscape",
    "noise_study",
    "pointwise_errors",
    "pressure_drops",
]
