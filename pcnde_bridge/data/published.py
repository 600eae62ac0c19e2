"""Folder layout of the published data: ``case_G_W/averagedTo1DFrom0_case_G_W.npy``.

One file holds one case, geometry G with waveform W, as float64 of shape (6, 100, 101):
[variable, time, z].  The variables are flow (mL/s), pressure × undeformed area (dyn),
undeformed area (cm²), area (cm²), radial displacement, and the magnitude of the wall shear
stress (dyn/cm²), which is zero throughout in data without it.  The time points are
0 … 0.99 s of a cycle of 1 s, the points z = 0 … 4 cm.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.files import reading
from pcnde_bridge._utils.validation import listed
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.plausibility import UnitsError
from pcnde_bridge.errors import DataNotFoundError, FileError

SHAPE = (6, 100, 101)
"""Shape of a file: variables, time points, points."""

DT, PERIOD, DZ = 0.01, 1.0, 0.04
"""Time step (s), length of the cycle (s) and distance between points (cm)."""

_FLOW, _FORCE, _AREA_UNDEFORMED, _AREA, _DISPLACEMENT, _WALL_SHEAR_STRESS = range(6)
_CASE = re.compile(r"case_(0|[1-9]\d*)_(0|[1-9]\d*)")


def read_authors_folder(folder: StrPath) -> Cases:
    """Read a data set in the layout of the published one, complete or in part.

    The pressure is variable 1 divided by the *undeformed* area: the published averages
    were computed on the undeformed cross-sections, and dividing by the deformed area
    gives spurious peaks at the stenosis and at both ends.

    Parameters
    ----------
    folder : path-like
        The folder with the ``case_G_W`` folders, or its parent if it is named
        ``data_3D``.  Other files and folders in it are ignored.

    Returns
    -------
    Cases
        All cases found, in the order of G, then W, with the labels geometry = G,
        waveform = W and blockage = 0.40 + 0.05·(G − 1).

    Raises
    ------
    DataNotFoundError
        If there is no such folder, or no case in it.
    FileError
        If files are missing, damaged or of another shape; the message lists up to 10.
    """
    root = Path(folder)
    if not root.is_dir():
        raise DataNotFoundError(f"there is no folder {str(folder)!r}; check the path")
    if (root / "data_3D").is_dir():
        root = root / "data_3D"
    found = [(entry, _CASE.fullmatch(entry.name)) for entry in root.iterdir() if entry.is_dir()]
    cases = sorted((int(match[1]), int(match[2]), entry) for entry, match in found if match)
    if not cases:
        raise DataNotFoundError(
            f"{str(root)!r} holds no folders named case_G_W (G the geometry, W the waveform); "
            "give the folder that holds them, or its parent data folder"
        )
    arrays, problems = [], []
    for _, _, entry in cases:
        try:
            arrays.append(_read_case(entry / f"averagedTo1DFrom0_{entry.name}.npy"))
        except FileError as error:
            problems.append(str(error))
    if problems:
        raise FileError(
            f"{len(problems)} of {len(cases)} cases in {str(root)!r} cannot be used; get these "
            "files again or move their folders away:\n  " + listed(problems, separator="\n  ")
        )
    data = np.stack(arrays, axis=1)
    area_undeformed = data[_AREA_UNDEFORMED, :, 0]
    geometry, waveform = np.array([case[:2] for case in cases]).T
    blockage = np.round(0.40 + 0.05 * (geometry - 1), 2)
    labels = {"geometry": geometry, "waveform": waveform, "blockage": blockage}
    pressure = data[_FORCE] / area_undeformed[:, None, :]
    # Quotients of whole numbers are the decimals nearest to 0.01 k and 0.04 k.
    time, z = np.arange(SHAPE[1]) / round(1 / DT), np.arange(SHAPE[2]) / round(1 / DZ)
    fields = data[_FLOW], data[_AREA], pressure, area_undeformed, time, z
    stress = data[_WALL_SHEAR_STRESS] if data[_WALL_SHEAR_STRESS].any() else None
    options: dict[str, Any] = {"period": PERIOD, "labels": labels, "wall_shear_stress": stress}
    try:
        return Cases(*fields, **options, units={"area": "cm^2"})
    except UnitsError as error:
        raise FileError(
            f"the files in {str(root)!r} must hold CGS units, but {error.problem}; correct them"
        ) from error


def _read_case(path: Path) -> Array:
    """Return the variables of a file."""
    with reading(path, "a case of the published data"):
        # Mapped, a length that exceeds the file is noticed before memory is allocated.
        data = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(data, np.ndarray) or data.shape != SHAPE or data.dtype != np.float64:
            what = f"{data.dtype} {data.shape}" if isinstance(data, np.ndarray) else "an archive"
            raise TypeError(f"it holds {what} instead of float64 {SHAPE}, [variable, time, z]")
        found = np.array(data)
        found[_DISPLACEMENT] = 0  # not used
        if not np.isfinite(found).all():
            place = tuple(int(i) for i in np.argwhere(~np.isfinite(found))[0])
            raise ValueError(f"value {place} is {found[place]}")
        if (found[[_AREA_UNDEFORMED, _AREA]] <= 0).any():
            raise ValueError("it has areas that are not positive (variables 2 and 3)")
        undeformed = found[_AREA_UNDEFORMED]
        if not np.allclose(undeformed, undeformed[0], rtol=1e-9, atol=0):
            raise ValueError("the undeformed area (variable 2) changes with time")
    return found
