"""Predictions of many cases, written to an HDF5 file part by part."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from pcnde_bridge._typing import AnyArray, Array, BoolArray, IntArray, StrPath
from pcnde_bridge._utils.archive import sha256_arrays
from pcnde_bridge._utils.files import atomic_write, check_writable, locked, make_folder, reserve
from pcnde_bridge._utils.hdf5 import map_dataset
from pcnde_bridge._utils.parallel import Workers, run
from pcnde_bridge._utils.result_folder import remove_results
from pcnde_bridge._utils.validation import check_values, counted, finite_array, listed, whole
from pcnde_bridge.data.cases import sign_cases
from pcnde_bridge.data.files import create_cases
from pcnde_bridge.data.labels import check_labels, label_arrays
from pcnde_bridge.data.selection import batches_of
from pcnde_bridge.engines.types import solve_most
from pcnde_bridge.errors import FileError, InputError, PCNDEWarning
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.model.predictor import Predictor
from pcnde_bridge.uncertainty.novelty import EDGE

_EXAMPLE = 16  # cases from which the shapes of the file are known
_OPTIONS = ("z", "period", "outlet", "units")


def predict_to_file(
    model: Predictor,
    path: StrPath,
    inflow: npt.ArrayLike,
    area_undeformed: npt.ArrayLike,
    *,
    labels: pd.DataFrame | Mapping[str, Any] | None = None,
    fields: bool = True,
    batch: int = 512,
    executor: Workers | None = None,
    progress: bool = True,
    **options: Any,
) -> IntArray:
    """Predict any number of cases, and write the results to an HDF5 file.

    One batch per worker is in memory.  A run that was interrupted continues where it ended if it
    is repeated: finished batches are in ``PATH.unfinished`` until the file is complete.

    Parameters
    ----------
    model : PCNDE or Ensemble
        Model of the predictions.
    path : path-like
        The file, ``.h5`` or ``.hdf5``.
    inflow, area_undeformed : array of shape (case, time) and (case, z)
        See :meth:`PCNDE.predict <pcnde_bridge.PCNDE.predict>`; either may have one row.  Memory
        maps are read batch by batch.
    labels : DataFrame or mapping, optional
        Labels of the cases, see :class:`~pcnde_bridge.Cases`; by default each is a geometry.
    fields : bool
        Whether to write flow, area, pressure and wall shear stress: the file is a data set then,
        which :func:`pcnde_bridge.load_cases` reads if all cases were predicted.  The group
        ``indices`` always has the columns of :meth:`pcnde_bridge.Cases.indices` and ``novelty``.
    batch : int
        Number of cases in each batch.
    executor : Executor, int or distributed.Client, optional
        Workers, such as a number of processes or a dask client; they must reach the file.
    progress : bool
        Whether to show progress.
    **options
        ``z``, ``period``, ``outlet`` (common to all cases) and ``units`` of ``predict``.

    Returns
    -------
    array of int
        Cases that could not be predicted; their values in the file are NaN.

    Warns
    -----
    PCNDEWarning
        If cases could not be predicted, or lie outside the training data.

    Raises
    ------
    InputError
        If the model, an input or an option is not usable, or a file of other inputs is
        unfinished.
    FileError
        If the file cannot be written.
    TaskError
        If a batch failed.
    """
    target, size = Path(path), whole("batch", batch, 1)
    if target.suffix.lower() not in (".h5", ".hdf5"):
        raise FileError(f"Cannot write {target}: the name must end in .h5 or .hdf5.")
    if not isinstance(model, Predictor):
        raise InputError(f"model must be a fitted model, got {type(model).__name__}.")
    if unknown := sorted(options.keys() - _OPTIONS):
        raise InputError(f"There is no option {unknown[0]!r} here; there are {listed(_OPTIONS)}.")
    q, s_u = _rows("inflow", inflow), _rows("area_undeformed", area_undeformed)
    check_values("area_undeformed", s_u, ~(s_u > 0), "areas must be positive")
    count = max(len(q), len(s_u))
    if not {len(q), len(s_u)} <= {1, count}:
        raise InputError(f"inflow has {len(q)} cases and area_undeformed {len(s_u)}.")
    facts: dict[str, Any] = {"fields": fields, "batch": size, "options": _facts_of(options)}
    table = label_arrays(check_labels(labels, np.broadcast_to(s_u, (count, s_u.shape[1]))))
    facts["labels"] = sha256_arrays(table)
    facts["inputs"] = sha256_arrays({"inflow": q, "area_undeformed": s_u})
    facts["model"] = sha256_arrays(model.to_archive()[1])
    parts = target.with_name(target.name + ".unfinished")
    draft = parts / f"{sha256_arrays({'facts': np.array(str(facts))})[:16]}.h5"
    with locked(target):
        check_writable(target)
        if not draft.exists():
            if any(parts.glob("*.npz")):
                raise InputError(
                    f"{parts} has the result of other tasks (other inputs, options or another "
                    "model): repeat that run, remove this folder, or write to another file."
                )
            example, _ = _solve(model, q[:_EXAMPLE], s_u[:_EXAMPLE], options)
            make_folder(parts)
            for unused in parts.glob("*.h5"):
                unused.unlink()
            with atomic_write(draft) as temporary:
                create_cases(temporary, table | _shapes(example, count, fields))
                reserve(temporary)
        tasks = {
            f"cases {rows.start} to {rows.stop - 1}": _Batch(
                model, draft, rows.start, _part(q, rows), _part(s_u, rows), options
            )
            for rows in batches_of(count, size)
        }
        outcome = run(
            _predict, tasks, executor=executor, folder=parts, facts=facts, progress=progress
        )
        results = outcome.check().values()
        failed = np.concatenate([result["failed"] for result in results])
        if fields and not failed.size:
            sign_cases(draft)
        draft.replace(target)
        remove_results(parts)
    outside = sum(result["outside"] for result in results)
    lie = "lies" if outside == 1 else "lie"
    for number, what in (
        (failed.size, f"could not be predicted (NaN in the file): {listed(failed.tolist())}"),
        (outside, f"{lie} outside the training data; see indices/novelty"),
    ):
        if number:
            warnings.warn(f"{number} of {counted(count, 'case')} {what}.", PCNDEWarning, 2)
    return failed


def _rows(name: str, values: npt.ArrayLike) -> Array:
    """Return an input as an array (case, n); a memory map is returned as it is."""
    array = values if isinstance(values, np.memmap) else finite_array(name, values)
    if array.ndim not in (1, 2) or not array.size:
        raise InputError(f"{name} must have the shape (case, n) or (n,), got {array.shape}.")
    return array if array.ndim == 2 else array[None]


def _facts_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options by their values; the representation of an outlet does not show them all."""
    facts = dict(options)
    if (z := options.get("z")) is not None:
        facts["z"] = np.ravel(z).tolist()
    if (outlet := options.get("outlet")) is not None:
        facts["outlet"] = outlet.to_dict()
    return facts


@dataclass(frozen=True)
class _Batch:
    """Inputs of a subset of the cases, and the file that their prediction is written to."""

    model: Predictor
    path: Path
    start: int
    inflow: Array
    area_undeformed: Array
    options: dict[str, Any]


def _part(array: Array, rows: slice | IntArray) -> Array:
    """Return some rows of an array, or its only row."""
    return array[rows] if len(array) > 1 else array


def _shapes(example: Prediction, count: int, fields: bool) -> dict[str, AnyArray | tuple[int, ...]]:
    """Return the grid, and shapes of the arrays that each batch writes."""
    grid = {"time": example.time, "z": example.z, "period": np.array(example.period)}
    return grid | {name: (count, *a.shape[1:]) for name, a in _arrays(example, fields)}


def _arrays(prediction: Prediction, fields: bool) -> Iterator[tuple[str, Array]]:
    """Yield the arrays of a prediction that are written, by their names in the file."""
    indices = prediction.indices().drop(columns=["case", "blockage", "positions"])
    for name, column in indices.items():
        yield f"indices/{name}", column.to_numpy()
    if prediction.novelty is not None:
        yield "indices/novelty", prediction.novelty
    yield "area_undeformed", prediction.area_undeformed
    if fields:
        yield from prediction.variables().items()


def _solve(
    model: Predictor, inflow: Array, area_undeformed: Array, options: dict[str, Any]
) -> tuple[Prediction, BoolArray]:
    """Predict cases, without warnings, and return which failed; these have values of another."""

    def solve(rows: IntArray) -> Prediction:
        return model.predict(_part(inflow, rows), _part(area_undeformed, rows), **options)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PCNDEWarning)
        return solve_most(solve, max(len(inflow), len(area_undeformed)))


def _predict(batch: _Batch) -> dict[str, Any]:
    """Predict a batch and write it; return the cases that failed, and how many are outside."""
    import h5py

    prediction, failed = _solve(
        batch.model, batch.inflow, batch.area_undeformed, dict(batch.options)
    )
    with h5py.File(batch.path, "r") as file:
        for name, values in _arrays(prediction, "flow" in file):
            on_disk = map_dataset(file[name], "r+")
            rows = on_disk[batch.start : batch.start + len(values)]
            rows[:] = values
            rows[failed] = np.nan
            on_disk.flush()
    novelty = prediction.novelty
    outside = 0 if novelty is None else int((novelty[~failed] > EDGE).sum())
    return {"failed": batch.start + np.flatnonzero(failed), "outside": outside}
