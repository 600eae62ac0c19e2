"""Checks that several studies share."""

from __future__ import annotations

from pcnde_bridge._typing import Array
from pcnde_bridge._utils import validation
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.errors import InputError
from pcnde_bridge.model.pcnde import PCNDE


def check_single(cases: Cases, study: str) -> None:
    """Raise InputError unless there is exactly one case."""
    if len(cases) != 1:
        raise InputError(
            f"{study} one case, got {len(cases)}. Select it: cases.select(geometry=…, waveform=…)."
        )


def check_shape(variable: str, values: Array, cases: Cases) -> Array:
    """Return the truth of a predicted variable, if the prediction has its shape.

    Raises
    ------
    InputError
        If the shapes differ.
    """
    truth: Array = getattr(cases, variable)
    validation.check_shape(f"The predicted {variable}", values, truth.shape, "case, time, z")
    return truth


def staged_parts(model: PCNDE, missing: str) -> tuple[PCNDEConfig, Parameters]:
    """Return configuration and parameters of a model with the paper's stages.

    Parameters
    ----------
    model : PCNDE
        Model of any preset.
    missing : str
        What a model of the preset ``physics`` lacks, for the error message.

    Raises
    ------
    InputError
        If the model has the preset ``physics``.
    """
    config, parameters = model.config, model.parameters
    if not isinstance(config, PCNDEConfig) or not isinstance(parameters, Parameters):
        raise InputError(f"A model of the preset physics has no {missing}; give another model.")
    return config, parameters
