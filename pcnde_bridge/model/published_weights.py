"""Reader of the authors' published weights (``trained_weights/*.jld2``, which are HDF5 files)."""

from pathlib import Path

import numpy as np

from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.files import reading
from pcnde_bridge._utils.hdf5 import read_dataset
from pcnde_bridge.config import PUBLISHED_CODE
from pcnde_bridge.data.published import SHAPE
from pcnde_bridge.engines.parameters import Parameters, sizes
from pcnde_bridge.errors import FileError

FILES = {
    "flow": "ptrained_BFGS_Q.jld2",
    "intermediate_area": "ptrained_BFGS_S.jld2",
    "fourier_area": "pFourier_trained.jld2",
}
"""File of each stage.

The two pressure files are not read: the second holds 300 numbers where the
paper's equation has 202, and they do not reproduce the paper's pressure errors.
"""


def read_published_weights(folder: StrPath) -> Parameters:
    """Read flow and area parameters; the pressure stages' vectors are empty.

    Parameters
    ----------
    folder : path-like
        Folder of the ``.jld2`` files, or of their folder ``trained_weights``.

    Raises
    ------
    DataNotFoundError
        If a file is missing.
    FileError
        If a file cannot be read, or has another length than expected.
    """
    inner = Path(folder) / "trained_weights"
    folder = inner if inner.is_dir() else Path(folder)
    needed = sizes(PUBLISHED_CODE, *SHAPE[1:])
    vectors = {stage: _read(folder / name, needed[stage]) for stage, name in FILES.items()}
    return Parameters(**vectors, temporal_pressure=np.empty(0), spatial_pressure=np.empty(0))


def _read(path: Path, size: int) -> Array:
    import h5py

    with reading(path, "a file of the authors' published weights"), h5py.File(path, "r") as file:
        vector = np.asarray(read_dataset(file, "p"), dtype=np.float64)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise FileError(
            f"{path} should hold {size} finite numbers, but has the shape {vector.shape}."
        )
    return vector
