"""Description of a file: model, ensemble, checkpoint or data set, without starting an engine."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any

from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.archive import archive_kind, interpreting, read_archive, with_prefix
from pcnde_bridge._utils.validation import listed
from pcnde_bridge.config import PRESETS, Config, config_from
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import FileError, PCNDEError
from pcnde_bridge.model.ensemble import ENSEMBLE_FORMAT, ENSEMBLE_VERSION
from pcnde_bridge.model.pcnde import MODEL_FORMAT, MODEL_VERSION
from pcnde_bridge.training.closure_training import ClosureTraining
from pcnde_bridge.training.staged_training import StagedTraining

_FORMATS = {
    MODEL_FORMAT: (MODEL_VERSION, "model"),
    ENSEMBLE_FORMAT: (ENSEMBLE_VERSION, "ensemble"),
}
for _format, _version in (StagedTraining.checkpoint_format, ClosureTraining.checkpoint_format):
    _FORMATS[_format] = (_version, "checkpoint")


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
    file_format = archive_kind(path)
    if file_format not in _FORMATS:
        with contextlib.suppress(PCNDEError):
            return _data_set(Cases.load(path))
        # The reader reports whether the file is missing, damaged or something else.
        read_archive(path, MODEL_FORMAT, MODEL_VERSION, "model")
        raise FileError(f"{path} is not a file of pcnde_bridge.")
    version, kind = _FORMATS[file_format]
    facts, arrays = read_archive(path, file_format, version, kind)
    with interpreting(path, kind):
        return {"kind": kind, **_trained(kind, facts, arrays)}


def _trained(kind: str, facts: Mapping[str, Any], arrays: Mapping[str, Array]) -> dict[str, Any]:
    """Describe a model, an ensemble or a checkpoint."""
    found: dict[str, Any] = {}
    settings = facts
    if kind == "ensemble":
        settings, arrays = facts["members"][0], with_prefix("member_0_", arrays)
        found["members"] = len(facts["members"])
        found["uncertainty"] = "calibrated spread of the members"
    elif "uncertainty_members" in arrays:
        found["uncertainty"] = "fits that left out folds of the training cases"
    config = config_from(settings["config"])
    preset, changes = nearest_preset(config)
    found |= {"preset": preset, "changes": changes, "config": config.to_dict()}
    found["provenance"] = dict(facts.get("provenance", {}))
    if kind == "checkpoint":
        vectors = len(facts.get("vectors", ()))
        found |= {"finished": facts.get("finished", vectors), "steps": facts.get("units")}
    else:
        found["grid"] = _grid(arrays["time"], arrays["z"], arrays["period"])
    return found


def _grid(time: Array, z: Array, period: Array | float) -> dict[str, Any]:
    ends = [float(z[0]), float(z[-1])]
    return {"time_points": time.size, "period": float(period), "points": z.size, "z": ends}


def _data_set(cases: Cases) -> dict[str, Any]:
    return {
        "kind": "data set",
        "grid": _grid(cases.time, cases.z, cases.period),
        "cases": len(cases),
        "fingerprint": cases.fingerprint(),
        "labels": {
            str(name): column.drop_duplicates().tolist() for name, column in cases.labels.items()
        },
    }


def nearest_preset(config: Config) -> tuple[str, dict[str, Any]]:
    """Return the preset with the fewest settings that differ, and these settings.

    Examples
    --------
    >>> from pcnde_bridge.config import FAST
    >>> from pcnde_bridge.model.describe import nearest_preset
    >>> nearest_preset(FAST.replace(flow={"steps": 24}))
    ('fast', {'flow.steps': 24})
    """
    mine = _flat(config)
    differences = {
        name: {key: value for key, value in mine.items() if theirs[key] != value}
        for name, preset in PRESETS.items()
        if type(preset) is type(config)
        for theirs in [_flat(preset)]
    }
    name = min(differences, key=lambda name: len(differences[name]))
    return name, differences[name]


def _flat(config: Config) -> dict[str, Any]:
    """Return the settings by names such as ``flow.epochs``."""
    found: dict[str, Any] = {}
    for name, value in config.to_dict().items():
        group = isinstance(value, dict)
        found |= {f"{name}.{k}": v for k, v in value.items()} if group else {name: value}
    return found


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
    if "labels" in found:
        rows.append(("cases", f"{found['cases']}, fingerprint {found['fingerprint'][:16]}…"))
        return [*rows, *((name, listed(values)) for name, values in found["labels"].items())]
    return [*rows, ("uncertainty", found.get("uncertainty", "none")), *_history_of_fit(found)]


def _history_of_fit(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of the provenance."""
    facts, rows = found["provenance"], []
    if "cases" in facts:
        rows.append(("cases", f"{facts['cases']}, fingerprint {facts['cases_fingerprint'][:16]}…"))
    if "cases_labels" in facts:
        by_geometry: dict[int, list[int]] = {}
        for geometry, waveform in facts["cases_labels"]:
            by_geometry.setdefault(geometry, []).append(waveform)
        listed_waveforms = ((g, ", ".join(map(str, w))) for g, w in by_geometry.items())
        rows.append(("", "\n".join(f"geometry {g}: waveforms {w}" for g, w in listed_waveforms)))
    for name in ("seed", "engine", "trained", "seconds", "platform", "command", "source"):
        if facts.get(name) is not None:
            value = facts[name]
            rows.append((name, f"{value:.1f}" if isinstance(value, float) else str(value)))
    if "versions" in facts:
        text = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
        rows.append(("versions", text))
    return rows
