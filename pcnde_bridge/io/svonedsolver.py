"""Results of svOneDSolver: its input file and the text files that it writes.

For each segment there are ``<model><segment>_flow.dat``, ``_area.dat`` and
``_pressure.dat``: one row for each node from inlet to outlet, one column for each saved
time step, the start included.  Lengths, areas and the time step are in the input file
(SEGMENT, SOLVEROPTIONS).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.files import as_paths, reading
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import DataNotFoundError, FileError, InputError
from pcnde_bridge.io.assemble import CaseOptions, Paths, to_cases
from pcnde_bridge.io.vessel_results import VesselResults


class _Segment(NamedTuple):
    """Line SEGMENT of the input file: lengths in cm, areas in cm²."""

    name: str
    length: float
    elements: int
    inlet: str
    outlet: str
    inlet_area: float
    outlet_area: float

    def area(self) -> Array:
        """Return the undeformed area at the nodes; the radius is linear between the ends."""
        growth = math.sqrt(self.outlet_area / self.inlet_area) - 1
        return self.inlet_area * (1 + growth * np.linspace(0.0, 1.0, self.elements + 1)) ** 2


class _Input(NamedTuple):
    """Input file: name of the model, segments, time between saves (s), number of saves."""

    model: str
    segments: dict[str, _Segment]
    step: float
    saves: int


def read_sv1d(
    paths: Paths, *, segments: str | Sequence[str] | None = None, **options: Unpack[CaseOptions]
) -> Cases:
    """Read results of svOneDSolver.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        Input files of the solver (``.in``), one for each case, with the results beside
        them.
    segments : str or sequence of str, optional
        Names of the segments of the vessel from its inlet on, each of which begins where
        the one before ends.  By default all segments, if they are such a chain.
    **options
        ``period``, ``units``, ``flip``, ``time_points``, ``points`` and ``labels``, see
        :func:`pcnde_bridge.io.to_cases`.  The period is required: solutions start from
        rest, and only their last cycle is used.

    Returns
    -------
    Cases
        The undeformed area is that of the input file; its radius is linear along each segment.

    Raises
    ------
    DataNotFoundError
        If a file does not exist.
    FileError
        If a file is damaged or of another format.
    InputError
        If the segments are not a chain, the period is missing, or units, flow or time
        steps are ambiguous.
    """
    if options.get("period") is None:
        raise InputError(
            "svOneDSolver's solutions start from rest: pass the period of the inflow, period= "
            "(--period), in s, and their last cycle is used."
        )
    wanted = [segments] if isinstance(segments, str) else segments
    return to_cases([_read_vessel(path, wanted) for path in as_paths(paths)], **options)


def _read_vessel(path: Path, wanted: Sequence[str] | None) -> VesselResults:
    given = _read_input(path)
    parts: dict[str, list[Array]] = {name: [] for name in (*VARIABLES, "area_undeformed", "z")}
    start = 0.0
    for number, segment in enumerate(_chain(path, given.segments, wanted)):
        nodes = segment.elements + 1
        arrays = {
            "z": start + np.linspace(0.0, segment.length, nodes),
            "area_undeformed": segment.area(),
        }
        for name in VARIABLES:
            file = path.parent / f"{given.model}{segment.name}_{name}.dat"
            arrays[name] = table = _read_table(file, nodes)
            if table.shape[1] != given.saves:
                raise FileError(
                    f"{file} has {table.shape[1]} time steps, but its input file saves "
                    f"{given.saves}: it is truncated, or of another run."
                )
        # The first node of a segment is the last one of the segment before.
        first = 0 if number == 0 else 1
        for name, array in arrays.items():
            parts[name].append(array[first:])
        start += segment.length
    joined = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    fields: dict[str, Any] = {name: joined[name].T for name in VARIABLES}
    return VesselResults(
        str(path),
        **fields,
        area_undeformed=joined["area_undeformed"],
        time=given.step * np.arange(joined["flow"].shape[1], dtype=np.float64),
        z=joined["z"],
    )


def _read_input(path: Path) -> _Input:
    """Read an input file; its keywords have any case, and commas separate as blanks do."""
    with reading(path, "the solver's input file (.in)"):
        # Comments have any encoding, and some editors put a mark before UTF-8.
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    model, step, saves = None, None, 0
    segments: dict[str, _Segment] = {}
    for number, line in enumerate(lines, start=1):
        try:
            match _words(line):
                case ["MODEL", name, *_]:
                    model = name
                case ["SOLVEROPTIONS", time_step, every, steps, *_]:
                    step, saves = float(time_step) * int(every), 1 + int(steps) // int(every)
                case ["SEGMENT", name, _, *values] if len(values) >= 6:
                    if name in segments:
                        raise ValueError("it is repeated")
                    segments[name] = _read_segment(name, values)
                case ["MODEL" | "SOLVEROPTIONS" | "SEGMENT", *_]:
                    raise ValueError("it is incomplete")
        except (ValueError, ZeroDivisionError) as error:
            raise FileError(
                f"{path}, line {number}: {line[:60]!r} is not a line of svOneDSolver's input "
                f"({error})."
            ) from error
    if model is None or step is None or not segments:
        raise FileError(
            f"{path} is not an input file of svOneDSolver: it needs the lines MODEL, SEGMENT and "
            "SOLVEROPTIONS."
        )
    found = _Input(model, segments, step, saves)
    _check_input(path, found)
    return found


def _check_input(path: Path, found: _Input) -> None:
    """Raise if the steps, the number of saves or a name cannot be used."""
    if not found.step > 0:
        raise FileError(f"{path}: SOLVEROPTIONS gives steps of {found.step:g} s.")
    if found.saves < 4:
        raise InputError(
            f"{path} saves {found.saves} time points, and a cycle needs at least 4. Save more "
            "often: the second number of SOLVEROPTIONS is the number of steps between saves."
        )
    for name in (found.model, *found.segments):
        if Path(name).name != name or name.startswith("."):
            raise FileError(f"{path}: the name {name!r} leads out of the file's folder.")


def _read_segment(name: str, values: list[str]) -> _Segment:
    """Return a segment from the words of its line; raise ValueError if one is not usable."""
    length, elements, inlet, outlet, first, last, *_ = values
    areas = float(first), float(last)
    segment = _Segment(name, float(length), int(elements), inlet, outlet, *areas)
    if segment.elements < 1 or not segment.length > 0:
        raise ValueError("it has no length or no elements")
    if not min(areas) > 0:
        raise ValueError("its areas must be positive")
    return segment


def _words(line: str) -> list[str]:
    """Return the words of a line without its comment, the first in capitals."""
    words = line.partition("#")[0].replace(",", " ").split()
    return [words[0].upper(), *words[1:]] if words else []


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
    """Return the numbers of a result file, one row for each node."""
    if not path.is_file():
        raise DataNotFoundError(
            f"There is no file {path}: run the solver with the output TEXT, and leave its results "
            "beside its input file."
        )
    with reading(path, "a table of numbers"):
        rows = [line.split() for line in path.read_text(encoding="ascii").splitlines()]
        table = np.array([row for row in rows if row], dtype=np.float64)
    if table.ndim != 2 or len(table) != nodes:
        raise FileError(
            f"{path} has {len(table)} rows, but the input file gives its segment {nodes} nodes: it "
            "is truncated, or of another run."
        )
    return table
