"""Results of svOneDSolver: its input file and the text files that it writes.

For each segment there are ``<model><segment>_flow.dat``, ``_area.dat`` and
``_pressure.dat``: one row for each node from inlet to outlet, one column for each saved
time step, the start included.  Lengths, areas and the time step are in the input file
(SEGMENT, SOLVEROPTIONS).
"""

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.files import reading
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.errors import DataNotFoundError, InputError
from pcnde_bridge.io.assemble import CaseOptions, Paths, read_vessels
from pcnde_bridge.io.vessel_results import VesselResults


class _Segment(NamedTuple):
    """Line SEGMENT of the input file: lengths in cm, areas in cm²."""

    name: str
    inlet: str
    outlet: str
    length: float
    elements: int
    inlet_area: float
    outlet_area: float

    def area(self) -> Array:
        """Return the undeformed area at the nodes; the radius is linear between the ends."""
        growth = math.sqrt(self.outlet_area / self.inlet_area) - 1
        return self.inlet_area * (1 + growth * np.linspace(0.0, 1.0, self.elements + 1)) ** 2


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
            "svOneDSolver starts from rest: pass the period, period= (--period), in s."
        )
    wanted = [segments] if isinstance(segments, str) else segments
    return read_vessels(paths, lambda path: [_read_vessel(path, wanted)], **options)


def _read_vessel(path: Path, wanted: Sequence[str] | None) -> VesselResults:
    with reading(path, "an input file of svOneDSolver"):
        model, known, step, saves = _read_input(path)
    if saves < 4:
        advice = "reduce the second number of SOLVEROPTIONS"
        raise InputError(f"it saves {saves} time points, too few: {advice}.")
    parts: list[dict[str, Array]] = []
    start = 0.0
    for segment in _chain(known, wanted):
        shape = segment.elements + 1, saves
        part = {
            name: _read_table(path.with_name(f"{model}{segment.name}_{name}.dat"), shape)
            for name in VARIABLES
        }
        part["area_undeformed"] = segment.area()
        part["z"] = start + np.linspace(0.0, segment.length, shape[0])
        # The first node of a segment is the last one of the segment before.
        parts.append({name: array[min(len(parts), 1) :] for name, array in part.items()})
        start += segment.length
    joined: dict[str, Any] = {
        name: np.concatenate([part[name] for part in parts]).T for name in parts[0]
    }
    time = step * np.arange(float(saves))
    return VesselResults(str(path), **joined, time=time, units={"shape": "area"})


def _read_input(path: Path) -> tuple[str, dict[str, _Segment], float, int]:
    """Return the model's name, its segments, the time between saves (s) and their number.

    Keywords have any case, and commas separate as blanks do.
    """
    model, step, saves = "", 0.0, 0
    segments: dict[str, _Segment] = {}
    # Comments have any encoding, and some editors put a mark before UTF-8.
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    for number, line in enumerate(text.splitlines(), start=1):
        keyword, *values = line.partition("#")[0].replace(",", " ").split() or [""]
        try:
            match keyword.upper(), values:
                case "MODEL", [name, *_]:
                    model = name
                case "SOLVEROPTIONS", [time_step, every, steps, *_]:
                    step, saves = float(time_step) * int(every), 1 + int(steps) // int(every)
                case "SEGMENT", [name, _, length, elements, inlet, outlet, first, last, *_]:
                    if name in segments:
                        raise ValueError("it is repeated")
                    sizes = float(length), int(elements), float(first), float(last)
                    segments[name] = _Segment(name, inlet, outlet, *sizes)
                    if not all(size > 0 for size in sizes):
                        raise ValueError("its length, elements and areas must be positive")
                case (("MODEL" | "SOLVEROPTIONS" | "SEGMENT"), _):
                    raise ValueError("it is incomplete")
        except (ValueError, ZeroDivisionError) as error:
            raise ValueError(f"line {number}, {line[:60]!r}: {error}") from error
    if not (model and segments and step > 0):
        raise ValueError("it needs the lines MODEL, SEGMENT and SOLVEROPTIONS, with steps above 0")
    for name in (model, *segments):
        if Path(name).name != name or name.startswith("."):
            raise ValueError(f"the name {name!r} leads out of the file's folder")
    return model, segments, step, saves


def _chain(known: dict[str, _Segment], wanted: Sequence[str] | None) -> list[_Segment]:
    """Return the segments of the vessel, from the inlet on."""
    if absent := [name for name in wanted or () if name not in known]:
        raise InputError(f"it has no segments {absent}; it has {list(known)}.")
    chain = [known[name] for name in wanted or known]
    for one, other in itertools.pairwise(chain):
        if one.outlet != other.inlet:
            raise InputError(
                f"segment {other.name} does not begin where {one.name} ends, so these are not one "
                "vessel. Choose its segments from the inlet on, segments=[…] (--segments), of "
                f"{list(known)}."
            )
    return chain


def _read_table(path: Path, shape: tuple[int, int]) -> Array:
    """Return the numbers of a result file, one row for each node."""
    if not path.is_file():
        advice = "run the solver with the output TEXT, and keep its results beside its input"
        raise DataNotFoundError(f"There is no file {path}: {advice}.")
    what = "a table of numbers with {} nodes (rows) and {} time steps (columns)".format(*shape)
    with reading(path, f"{what}, as the input file says"):
        table: Array = np.loadtxt(path, ndmin=2, comments=None, encoding="ascii")
        if table.shape != shape:
            raise ValueError("it has {} and {}, as if of another run".format(*table.shape))
    return table
