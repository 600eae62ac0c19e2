"""Content of a model's file: facts for JSON, and arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.archive import interpreting
from pcnde_bridge.config import Config, config_from
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.model.kinds import AnyParameters, kind_of
from pcnde_bridge.training import history as histories
from pcnde_bridge.training.history import Iteration
from pcnde_bridge.uncertainty.novelty import Novelty
from pcnde_bridge.uncertainty.sampling import Uncertainty

MODEL_FORMAT, MODEL_VERSION = "pcnde-model", 1
ENSEMBLE_FORMAT, ENSEMBLE_VERSION = "pcnde-ensemble", 1

_Part = TypeVar("_Part", Uncertainty, Novelty)


class Content(NamedTuple):
    """Parts of a :class:`~pcnde_bridge.PCNDE` that its file keeps."""

    config: Config
    parameters: AnyParameters
    grid: Grid
    provenance: Mapping[str, Any]
    history: tuple[Iteration, ...]
    uncertainty: Uncertainty | None
    novelty: Novelty | None


def to_archive(content: Content) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    """Return the facts and the arrays of a model's file."""
    facts = {"config": content.config.to_dict(), "provenance": dict(content.provenance)}
    arrays = {
        "time": content.grid.time,
        "z": content.grid.z,
        "period": np.array(content.grid.period),
        **histories.to_arrays(content.history),
        **dict(content.parameters),
    }
    for prefix, part in (("uncertainty", content.uncertainty), ("novelty", content.novelty)):
        if part is not None:
            arrays |= {f"{prefix}_{name}": array for name, array in part}
    return facts, arrays


def from_archive(
    facts: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]], where: str
) -> Content:
    """Check and return the content of a model's file; the inverse of :func:`to_archive`.

    Parameters
    ----------
    facts, arrays : mapping
        Result of :func:`to_archive`.
    where : str
        Name of the source in messages.

    Raises
    ------
    FileError
        If a part is missing, or the parts do not fit together.
    """
    with interpreting(where, "model"):
        config = config_from(facts["config"])
        kind = kind_of(config)
        content = Content(
            config,
            kind.read_parameters(arrays),
            Grid(arrays["time"], arrays["z"], float(arrays["period"])),
            dict(facts["provenance"]),
            histories.from_arrays(arrays),
            _optional_part(Uncertainty, "uncertainty", arrays),
            _optional_part(Novelty, "novelty", arrays),
        )
        kind.check(config, content.parameters, content.grid, content.uncertainty)
        if content.novelty is not None:
            content.novelty.check()
    return content


def _optional_part(kind: type[_Part], prefix: str, arrays: Mapping[str, Array]) -> _Part | None:
    """Create a part of the model from the arrays with its prefix, if there are any."""
    found = with_prefix(f"{prefix}_", arrays)
    # Older files spell the center in British English.
    found = {name.replace("centre", "center"): values for name, values in found.items()}
    return kind(**found) if found else None


def with_prefix(prefix: str, arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Return the arrays whose names have a prefix, by their names without it."""
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
