"""Results of svOneDSolver: its input file and the text files that it writes.

For each segment there are ``<model><segment>_flow.dat``, ``_area.dat`` and
``_pressure.dat``: a row for each node from inlet to outlet, a column for each saved
time step, the start included.  Lengths, areas and the time step stand in the input file
(SEGMENT, SOLVEROPTIONS).
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.files import as_paths, check_file
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import (
    DataNotFoundError,
    FileError,
    InputError,
)
from pcnde_bridge.io.vessel_results import CaseOptions, VesselResults, to_cases

if TYPE_CHECKING:
    from typing_extensions import Unpack


@dataclass(frozen=True)
class _Segment:
    name: str
    length: float
    elements: int
    inlet: str
    outlet: str
    inlet_area: float
    outlet_area: float


def read_sv1d(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    segments: str | Sequence[str] | None = None,
    **options: Unpack[CaseOptions],
) -> Cases:
    """Read results of svOneDSolver.

    Parameters
    ----------
    paths : path-like or sequence of them
        Input files of the solver (``.in``), one for each case; the results lie beside.
    segments : str or sequence of str, optional
        Names of the segments that make the vessel, from the inlet on, each beginning
        where the one before ends.  By default all, if they are such a chain.
    **options
        ``period``, ``units``, ``flip``, ``instants``, ``points`` and ``labels``, see
        :func:`pcnde_bridge.io.vessel_results.to_cases`.  The period is needed: solutions
        start from rest, and only their last cycle is taken.

    Returns
    -------
    Cases
        The undeformed area is that of the input file, linear along each segment.

    Raises
    ------
    DataNotFoundError
        If a file is not there.
    FileError
        If a file is not of this format, or damaged.
    InputError
        If the segments are no chain, the period is missing, or units, flow or time
        steps are doubtful.
    """
    if options.get("period") is None:
        raise InputError(
            "svOneDSolver's solutions start from rest: pass the period of the inflow, period= "
            "(--period), in s, and their last cycle is taken."
        )
    wanted = [segments] if isinstance(segments, str) else segments
    return to_cases([_read_vessel(path, wanted) for path in as_paths(paths)], **options)


def _read_vessel(path: Path, wanted: Sequence[str] | None) -> VesselResults:
    model, known, step = _read_input(path)
    chain = _chain(path, known, wanted)
    parts: dict[str, list[Array]] = {name: [] for name in (*VARIABLES, "undeformed", "z")}
    start = 0.0
    for number, segment in enumerate(chain):
        # The first node of a segment is the last of the one before.
        own = slice(0 if number == 0 else 1, None)
        nodes = segment.elements + 1
        for name in VARIABLES:
            file = path.parent / f"{model}{segment.name}_{name}.dat"
            table = _read_table(file, nodes)
            if parts[name] and table.shape[1] != parts[name][0].shape[1]:
                raise FileError(
                    f"{file} has {table.shape[1]} time steps, the segment before "
                    f"{parts[name][0].shape[1]}: it is truncated, or of another run."
                )
            parts[name].append(table[own])
        parts["z"].append(start + np.linspace(0.0, segment.length, nodes)[own])
        areas = np.linspace(segment.inlet_area, segment.outlet_area, nodes)
        parts["undeformed"].append(areas[own])
        start += segment.length
    whole = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    return VesselResults(
        str(path),
        whole["flow"].T,
        whole["area"].T,
        whole["pressure"].T,
        whole["undeformed"],
        step * np.arange(whole["flow"].shape[1], dtype=np.float64),
        whole["z"],
    )


def _read_input(path: Path) -> tuple[str, dict[str, _Segment], float]:
    """Return the model's name, its segments, and the time between saved steps."""
    check_file(path, "the solver's input file (.in)")
    model, step = None, None
    segments: dict[str, _Segment] = {}
    try:
        # Comments come in any encoding, and some editors put a mark before UTF-8.
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise FileError(f"{path} is not a readable text file: {error}.") from error
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].split()
        try:
            if words[:1] == ["MODEL"]:
                model = words[1]
            elif words[:1] == ["SOLVEROPTIONS"]:
                step = float(words[1]) * int(words[2])
            elif words[:1] == ["SEGMENT"]:
                segment = _Segment(
                    words[1], float(words[3]), int(words[4]), words[5], words[6],
                    float(words[7]), float(words[8]),
                )  # fmt: skip
                if segment.name in segments or segment.elements < 1 or not segment.length > 0:
                    raise ValueError("it is there twice, or has no length or no elements")
                segments[segment.name] = segment
        except (IndexError, ValueError) as error:
            raise FileError(
                f"{path}, line {number}: {line[:60]!r} is not a line of svOneDSolver's input "
                f"({error})."
            ) from error
    if model is None or step is None or not segments:
        raise FileError(
            f"{path} is not an input file of svOneDSolver: it needs the lines MODEL, SEGMENT and "
            "SOLVEROPTIONS."
        )
    if not step > 0:
        raise FileError(f"{path}: SOLVEROPTIONS gives steps of {step:g} s.")
    for name in (model, *segments):
        if Path(name).name != name or name.startswith("."):
            raise FileError(f"{path}: the name {name!r} leads out of the file's folder.")
    return model, segments, step


def _chain(path: Path, known: dict[str, _Segment], wanted: Sequence[str] | None) -> list[_Segment]:
    """Return the segments of the vessel, from the inlet on."""
    absent = [name for name in wanted or () if name not in known]
    if absent or (wanted is not None and not wanted):
        raise InputError(f"{path} has no segments {absent}; it has {list(known)}.")
    chain = [known[name] for name in wanted or known]
    for one, other in itertools.pairwise(chain):
        if one.outlet != other.inlet:
            raise InputError(
                f"{path}: segment {other.name} does not begin where {one.name} ends, so these are "
                f"not one vessel. Choose its segments from the inlet on, segments=[…] "
                f"(--segments), of {list(known)}."
            )
    return chain


def _read_table(path: Path, nodes: int) -> Array:
    if not path.is_file():
        raise DataNotFoundError(
            f"There is no file {path}: run the solver with the output TEXT, and leave its results "
            "beside its input file."
        )
    try:
        rows = [line.split() for line in path.read_text(encoding="ascii").splitlines()]
        table = np.array([[float(word) for word in row] for row in rows if row])
    except (OSError, ValueError) as error:
        raise FileError(f"{path} is no table of numbers, or damaged: {error}.") from error
    if table.ndim != 2 or len(table) != nodes:
        raise FileError(
            f"{path} has {len(table)} rows, but the input file gives its segment {nodes} nodes: it "
            "is truncated, or of another run."
        )
    return table
