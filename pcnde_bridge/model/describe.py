"""Description of a file: model, ensemble, checkpoint or data set, without starting an engine."""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.archive import archive_kind, interpreting, read_archive, with_prefix
from pcnde_bridge._utils.validation import listed, whole
from pcnde_bridge.config import config_from, nearest_preset
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import PCNDEError
from pcnde_bridge.model.ensemble import MEMBER_PREFIX, Ensemble
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.training.closure_training import ClosureTraining
from pcnde_bridge.training.provenance import provenance_from
from pcnde_bridge.training.staged_training import StagedTraining

_CHECKPOINTS = (StagedTraining.checkpoint_format, ClosureTraining.checkpoint_format)
_FILES = (PCNDE.file_format, Ensemble.file_format, *((*f, "checkpoint") for f in _CHECKPOINTS))
_FORMATS = {file_format[0]: file_format for file_format in _FILES}
_FACTS = ("seed", "engine", "trained", "seconds", "platform", "command", "source")


def describe(path: StrPath) -> dict[str, Any]:
    """Read the facts that are needed to reproduce a fit.

    Parameters
    ----------
    path : path-like
        File of a model, an ensemble, a checkpoint or a data set.

    Returns
    -------
    dict
        Values that JSON can hold: ``kind``; ``preset``, the nearest, and ``changes`` from it;
        ``config``, all settings; ``provenance``; and, depending on the kind, ``grid``,
        ``members``, ``uncertainty``, ``finished`` and ``steps`` (training steps).  For a data
        set: ``kind``, ``grid``, ``cases``, ``fingerprint`` and ``labels``.

    Raises
    ------
    FileError
        If the file is none of these, or damaged.
    """
    if Path(path).suffix.lower() in (".h5", ".hdf5"):
        return _data_set(Cases.load(path))
    file_format = _FORMATS.get(archive_kind(path) or "")
    if file_format is None:
        with contextlib.suppress(PCNDEError):
            return _data_set(Cases.load(path))
        # The reader reports whether the file is missing, damaged or something else.
        file_format = PCNDE.file_format
    facts, arrays = read_archive(path, *file_format)
    kind = file_format[2]
    with interpreting(path, kind):
        return {"kind": kind, **_trained(kind, facts, arrays)}


def _trained(kind: str, facts: Mapping[str, Any], arrays: Mapping[str, Array]) -> dict[str, Any]:
    """Describe a model, an ensemble or a checkpoint."""
    found: dict[str, Any] = {}
    settings = facts
    if kind == "ensemble":
        settings, arrays = facts["members"][0], with_prefix(MEMBER_PREFIX.format(0), arrays)
        found["members"] = len(facts["members"])
        found["uncertainty"] = "calibrated spread of the members"
    elif "uncertainty_members" in arrays:
        found["uncertainty"] = "fits that left out folds of the training cases"
    config = config_from(settings["config"])
    preset, changes = nearest_preset(config)
    found |= {"preset": preset, "changes": changes, "config": config.to_dict()}
    found["provenance"] = provenance_from(facts.get("provenance", {}))
    if kind == "checkpoint":
        vectors = len(facts.get("vectors", ()))
        finished = whole("finished", facts.get("finished", vectors))
        return found | {"finished": finished, "steps": whole("steps", facts["steps"])}
    return found | {"grid": _grid(arrays["time"], arrays["z"], arrays["period"])}


def _grid(time: Array, z: Array, period: Array | float) -> dict[str, Any]:
    ends = [float(z[0]), float(z[-1])]
    return {"time_points": time.size, "period": float(period), "points": z.size, "z": ends}


def _data_set(cases: Cases) -> dict[str, Any]:
    labels = cases.labels.items()
    return {
        "kind": "data set",
        "grid": _grid(cases.time, cases.z, cases.period),
        "cases": len(cases),
        "fingerprint": cases.fingerprint(),
        "labels": {str(name): column.drop_duplicates().tolist() for name, column in labels},
    }


def lines(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of a readable table from the result of :func:`describe`."""
    rows = [("kind", found["kind"])]
    if "preset" in found:
        changes = ", ".join(f"{name} = {value}" for name, value in found["changes"].items())
        rows.append(("preset", found["preset"] + (f", but {changes}" if changes else "")))
    if "steps" in found:
        rows.append(("finished", f"{found['finished']} of {found['steps']} training steps"))
    if "members" in found:
        rows.append(("members", str(found["members"])))
    if "grid" in found:
        grid = found["grid"]
        text = f"{grid['time_points']} time points in {grid['period']:g} s, {grid['points']} points"
        rows.append(("grid", f"{text}, z = {grid['z'][0]:g} … {grid['z'][1]:g} cm"))
    if "provenance" in found:
        rows.append(("uncertainty", found.get("uncertainty", "none")))
    facts = found.get("provenance", found)
    if "cases" in facts:
        fingerprint = facts.get("cases_fingerprint", found.get("fingerprint", "unknown"))
        rows.append(("cases", f"{facts['cases']}, fingerprint {fingerprint[:16]}…"))
    rows += [(name, listed(values)) for name, values in found.get("labels", {}).items()]
    if "cases_labels" in facts:
        keys = pd.DataFrame(facts["cases_labels"], columns=["geometry", "waveform"], dtype=str)
        waveforms = keys.groupby("geometry", sort=False)["waveform"].agg(", ".join)
        rows.append(("", "\n".join(f"geometry {g}: waveforms {w}" for g, w in waveforms.items())))
    for name in _FACTS:
        if facts.get(name) is not None:
            value = facts[name]
            rows.append((name, f"{value:.1f}" if isinstance(value, float) else str(value)))
    if "versions" in facts:
        text = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
        rows.append(("versions", text))
    return rows
