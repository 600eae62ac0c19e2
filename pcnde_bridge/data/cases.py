"""The data set: flow, area and pressure of many vessels over one heart cycle."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from pcnde_bridge._utils.checksum import sha256_arrays
from pcnde_bridge._utils.validation import counted, listed
from pcnde_bridge.data.checks import (
    check_arrays,
    check_labels,
    check_time,
    warn_of_units,
)
from pcnde_bridge.data.files import read_cases, write_cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.variables import UNITS
from pcnde_bridge.errors import (
    DataNotFoundError,
    FileError,
    InputError,
)

FloatArray = NDArray[np.float64]


class Split(NamedTuple):
    """A data set divided into cases to learn from and cases to judge by."""

    train: Cases
    test: Cases


@dataclasses.dataclass(frozen=True, init=False, eq=False, repr=False)
class Cases:
    """Flow, area and pressure along a vessel over one cycle, for many cases.

    A case is one geometry under one inflow waveform. The object never changes:
    its arrays are read-only, C-contiguous float64 copies of what was given.

    Parameters
    ----------
    flow, area, pressure : array_like, shape (n_cases, n_times, n_points)
        Flow rate (mL/s), cross-sectional area (cm², positive) and pressure
        (dyn/cm²), in the order [case, time, z].
    area_undeformed : array_like, shape (n_cases, n_points)
        Area of the unloaded vessel (cm², positive).
    time : array_like, shape (n_times,)
        Instants (s) of one cycle, in uniform steps from any start. The end of
        the cycle, which equals its start, is not repeated. At least 4.
    z : array_like, shape (n_points,)
        Positions along the vessel (cm), strictly increasing. At least 3.
    period : float, optional
        Length of the cycle (s), which must be ``n_times`` time steps.
        That is also the default.
    labels : DataFrame or mapping, optional
        One row per case. The columns ``geometry`` and ``waveform`` (whole
        numbers) together name a case; no two cases share both. ``blockage`` is
        the fraction of the area that the stenosis takes, NaN where unknown; by
        default it is ``1 - min(area_undeformed) / area_undeformed[0]``. Further
        columns of numbers or text are kept; their names must be Python names.
        By default ``geometry`` counts the cases from 0 and ``waveform`` is 0.

    Raises
    ------
    InputError
        When an argument is not usable; the message names the field and the index.

    Warns
    -----
    UnitsWarning
        When the values are implausible for a vessel in CGS units: median
        undeformed area outside 1e-4 … 100 cm², median area more than 5 times
        away from the undeformed one, median speed ``|flow| / area`` outside
        0.5 … 500 cm/s (unless there is no flow), or largest pressure outside
        1e3 … 1e7 dyn/cm².
    """

    flow: FloatArray
    area: FloatArray
    pressure: FloatArray
    area_undeformed: FloatArray
    time: FloatArray
    z: FloatArray
    period: float
    _labels: pd.DataFrame

    def __init__(
        self,
        flow: ArrayLike,
        area: ArrayLike,
        pressure: ArrayLike,
        area_undeformed: ArrayLike,
        time: ArrayLike,
        z: ArrayLike,
        *,
        period: float | None = None,
        labels: pd.DataFrame | Mapping[str, Any] | None = None,
    ) -> None:
        given = {
            "flow": flow,
            "area": area,
            "pressure": pressure,
            "area_undeformed": area_undeformed,
            "time": time,
            "z": z,
        }
        arrays = check_arrays(given)
        cycle = check_time(arrays, period)
        table = check_labels(labels, arrays["area_undeformed"])
        self._fill(arrays, cycle, table)
        warn_of_units(arrays)

    def _fill(self, arrays: Mapping[str, FloatArray], period: float, labels: pd.DataFrame) -> None:
        """Set the fields, once."""
        for name, array in arrays.items():
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "period", period)
        object.__setattr__(self, "_labels", labels)

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Copies made by the standard library's copy and by worker processes
        # would be writeable otherwise.
        self.__dict__.update(state)
        for name in UNITS:
            getattr(self, name).setflags(write=False)

    # ---- what it holds -------------------------------------------------

    @property
    def labels(self) -> pd.DataFrame:
        """Copy of the labels: geometry, waveform, blockage, …; one row per case."""
        return self._labels.copy()

    @property
    def n_cases(self) -> int:
        """Number of cases."""
        return int(self.flow.shape[0])

    @property
    def n_times(self) -> int:
        """Number of instants in the cycle."""
        return int(self.flow.shape[1])

    @property
    def n_points(self) -> int:
        """Number of points along the vessel."""
        return int(self.flow.shape[2])

    @property
    def grid(self) -> Grid:
        """Instants (s), points (cm) and period (s)."""
        return Grid(self.time, self.z, self.period)

    @property
    def inflow(self) -> FloatArray:
        """Flow at the inlet (mL/s), shape (n_cases, n_times); a read-only view."""
        return self.flow[:, :, 0]

    def __len__(self) -> int:
        return self.n_cases

    def __repr__(self) -> str:
        geometries = self._labels["geometry"].nunique()
        waveforms = self._labels["waveform"].nunique()
        return (
            f"Cases({counted(self.n_cases, 'case')}: {counted(geometries, 'geometry')}, "
            f"{counted(waveforms, 'waveform')}; {self.n_times} instants over {self.period:g} s; "
            f"{self.n_points} points, z from {self.z[0]:g} to {self.z[-1]:g} cm)"
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Cases):
            return NotImplemented
        return self._checksum == other._checksum

    def __hash__(self) -> int:
        return hash(self._checksum)

    def fingerprint(self) -> str:
        """Return a checksum of every number and label.

        Returns
        -------
        str
            64 hexadecimal digits (SHA-256). Two data sets are equal exactly when
            their fingerprints are.
        """
        return self._checksum

    @cached_property
    def _checksum(self) -> str:
        return sha256_arrays(self._contents())

    def _contents(self) -> dict[str, NDArray[Any]]:
        """Everything in it as plain arrays; labels are named ``labels/<column>``."""
        contents: dict[str, NDArray[Any]] = {name: getattr(self, name) for name in UNITS}
        contents["period"] = np.array(self.period)
        for column in self._labels.columns:
            values = self._labels[column].to_numpy()
            if values.dtype.kind not in "biuf":
                values = np.array(values.tolist(), dtype=np.str_)
            contents[f"labels/{column}"] = values
        return contents

    def to_frame(self) -> pd.DataFrame:
        """Return everything as one tidy table, one row per case, instant and point.

        Returns
        -------
        DataFrame
            The labels' columns (geometry, waveform, blockage and any other), time (s),
            z (cm), flow (mL/s), area (cm²), pressure (dyn/cm²) and area_undeformed (cm²),
            with ``n_cases * n_times * n_points`` rows; z varies fastest.
        """
        shape = self.flow.shape
        columns: dict[str, NDArray[Any]] = {
            name: np.repeat(self._labels[name].to_numpy(), shape[1] * shape[2])
            for name in self._labels.columns
        }
        spread = {
            "time": self.time[:, None],
            "z": self.z,
            "flow": self.flow,
            "area": self.area,
            "pressure": self.pressure,
            "area_undeformed": self.area_undeformed[:, None, :],
        }
        for name, values in spread.items():
            columns[name] = np.broadcast_to(values, shape).ravel()
        return pd.DataFrame(columns)

    # ---- choosing cases ------------------------------------------------

    def select(self, index: Any = None, /, **labels: Any) -> Cases:
        """Return some of the cases.

        Parameters
        ----------
        index : int, slice, sequence of int, boolean mask or list of pairs, optional
            Positions in the data set, a mask of length ``n_cases``, or pairs
            ``[(geometry, waveform), …]``. The result is in the order asked for.
        **labels
            Values wanted of label columns, instead of ``index``:
            ``select(geometry=10, waveform=[1, 2])`` returns the cases that match
            all of them, in the order of the data set.

        Returns
        -------
        Cases
            At least one case.

        Raises
        ------
        InputError
            When something asked for is not there, is asked for twice, or when no
            case is left.
        """
        if (index is None) == (not labels):
            raise InputError(
                "select needs either positions, a mask or pairs, or label values such as "
                "geometry=10; " + ("both were given" if labels else "neither was given")
            )
        positions = self._labelled(labels) if labels else self._positions(index)
        if len(positions) == 0:
            raise InputError("the selection is empty: no case matches; loosen it")
        unique, counts = np.unique(positions, return_counts=True)
        if np.any(counts > 1):
            twice = int(unique[np.argmax(counts > 1)])
            raise InputError(f"case {twice} is selected more than once; ask for each case once")
        return self._take(positions)

    def _take(self, positions: NDArray[np.intp]) -> Cases:
        """Return the cases at the positions, known to be right."""
        taken = object.__new__(Cases)
        arrays = {
            name: getattr(self, name) if name in ("time", "z") else getattr(self, name)[positions]
            for name in UNITS
        }
        taken._fill(arrays, self.period, self._labels.iloc[positions].reset_index(drop=True))
        return taken

    def _positions(self, index: Any) -> NDArray[np.intp]:
        """Turn positions, a slice, a mask or pairs into positions."""
        if isinstance(index, slice):
            try:
                return np.arange(self.n_cases)[index]
            except (TypeError, ValueError) as error:
                raise InputError(f"the slice {index!r} is not usable: {error}") from error
        if isinstance(index, tuple) and all(np.ndim(i) == 0 for i in index):
            raise InputError(
                f"select({index!r}) could mean two things: write [{index!r}] for a "
                f"(geometry, waveform) pair, or {list(index)!r} for positions"
            )
        try:
            asked = np.asarray(index)
        except ValueError:  # rows of unequal length
            asked = np.asarray(None)
        if asked.dtype == bool and asked.ndim == 1:
            if len(asked) != self.n_cases:
                raise InputError(
                    f"the mask has {counted(len(asked), 'value')} but there are "
                    f"{counted(self.n_cases, 'case')}; give one value per case"
                )
            return np.flatnonzero(asked)
        if asked.ndim == 2:
            return self._paired(_pairs(asked.tolist(), "select"), "select")
        if asked.ndim > 1 or (asked.size and asked.dtype.kind not in "iu"):
            raise InputError(
                f"select cannot use {index!r}; give an int, a slice, a list of ints, a boolean "
                "mask or a list of (geometry, waveform) pairs"
            )
        asked = np.atleast_1d(asked)
        outside = (asked < -self.n_cases) | (asked >= self.n_cases)
        if outside.any():
            raise InputError(
                f"there is no case {asked[outside][0]}: positions run from 0 to "
                f"{self.n_cases - 1}, or from -{self.n_cases} to -1"
            )
        asked = asked.astype(np.intp)  # before sums that a smaller type cannot hold
        return np.where(asked < 0, asked + self.n_cases, asked)

    def _paired(self, pairs: Sequence[tuple[int, int]], where: str) -> NDArray[np.intp]:
        """Find the positions of (geometry, waveform) pairs, in their order."""
        known = {key: i for i, key in enumerate(self._keys())}
        absent = [pair for pair in pairs if pair not in known]
        if absent:
            raise InputError(
                f"{where} asks for cases that are not in this data set: (geometry, waveform) = "
                f"{listed(absent)}; the pairs there are stand in cases.labels"
            )
        return np.array([known[pair] for pair in pairs], dtype=np.intp)

    def _labelled(self, wanted: Mapping[str, Any]) -> NDArray[np.intp]:
        """Find the positions of the cases whose labels have the wanted values."""
        mask = np.ones(self.n_cases, dtype=bool)
        for column, value in wanted.items():
            if column not in self._labels:
                raise InputError(
                    f"there is no label {column!r}; the labels are "
                    + ", ".join(map(repr, self._labels.columns))
                )
            present = self._labels[column].to_numpy()
            values = [value] if isinstance(value, str) or np.ndim(value) == 0 else list(value)
            hits = [_matches(present, each) for each in values]
            absent = [each for each, hit in zip(values, hits, strict=True) if not hit.any()]
            if absent:
                raise InputError(
                    f"no case has {column} = {listed(absent)}; "
                    f"the values there are: {listed(pd.unique(self._labels[column]).tolist())}"
                )
            mask &= np.any(hits, axis=0)
        return np.flatnonzero(mask)

    def _keys(self) -> list[tuple[int, int]]:
        """Return the (geometry, waveform) of every case."""
        columns = (self._labels[name].tolist() for name in ("geometry", "waveform"))
        return list(zip(*columns, strict=True))

    # ---- dividing into training and test -------------------------------

    def split(
        self, how: str | os.PathLike[str] | Mapping[str, Sequence[Sequence[int]]] = "paper"
    ) -> Split:
        """Divide the data set into training and test cases.

        Parameters
        ----------
        how : "paper", mapping or path of a JSON file
            ``"paper"`` tests on the largest geometry label under every waveform
            and on the largest waveform label in every geometry, and trains on the
            rest, both in the order of their labels; for the published data that
            is the paper's 81 and 19 cases. A mapping, or a JSON file that holds
            one, names the cases itself, in the order wanted:
            ``{"train": [[geometry, waveform], …], "test": […]}``. Cases that it
            does not name are left out.

        Returns
        -------
        Split
            The named tuple ``(train, test)``; neither is empty.

        Raises
        ------
        InputError
            When training or test would be empty, or the mapping is not usable.
        FileError
            When the file is missing or is not JSON.
        """
        if isinstance(how, str) and how == "paper":
            return self._split_as_the_paper()
        if isinstance(how, Mapping):
            return self._split_by(how, "the split")
        if not isinstance(how, str | os.PathLike):
            raise InputError(
                f"how must be 'paper', a mapping or the path of a JSON file, got {how!r}"
            )
        path = Path(how)
        try:
            mapping = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError as error:
            raise DataNotFoundError(
                f"there is no split file {str(path)!r}; give 'paper', a mapping or the path of a "
                "JSON file"
            ) from error
        except (OSError, ValueError, RecursionError) as error:
            raise FileError(f"{str(path)!r} is not a readable JSON file: {error}") from error
        if not isinstance(mapping, dict):
            raise InputError(f'{str(path)!r} must hold {{"train": [...], "test": [...]}}')
        return self._split_by(mapping, repr(str(path)))

    def _split_as_the_paper(self) -> Split:
        geometry = self._labels["geometry"].to_numpy()
        waveform = self._labels["waveform"].to_numpy()
        order = np.lexsort((waveform, geometry))
        test = ((geometry == geometry.max()) | (waveform == waveform.max()))[order]
        if test.all():
            raise InputError(
                "the paper's split tests on the largest geometry and the largest waveform; this "
                f"data set has {counted(len(set(geometry)), 'geometry')} and "
                f"{counted(len(set(waveform)), 'waveform')}, so no case is left for training; "
                "name the cases with a mapping (a file of it), or use all without a split "
                "(--split none)"
            )
        return Split(self._take(order[~test]), self._take(order[test]))

    def _split_by(self, mapping: Mapping[str, Any], name: str) -> Split:
        unknown = [key for key in mapping if key not in ("train", "test")]
        if unknown:
            raise InputError(
                f"{name} has unknown keys: {listed(unknown)}; the keys are 'train' and 'test'"
            )
        parts: dict[str, list[tuple[int, int]]] = {}
        for key in ("train", "test"):
            if key not in mapping:
                raise InputError(
                    f"{name} has no {key!r}; give it a list of [geometry, waveform] pairs"
                )
            parts[key] = _pairs(mapping[key], f"{key!r} of {name}")
        both = [pair for pair in parts["train"] if pair in set(parts["test"])]
        if both:
            raise InputError(
                f"{name} has cases in both 'train' and 'test': (geometry, waveform) = "
                f"{listed(both)}; a case may be in one of them"
            )
        return Split(
            **{
                key: self._take(self._paired(pairs, f"{key!r} of {name}"))
                for key, pairs in parts.items()
            }
        )

    # ---- files ---------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the data set to a file, atomically.

        Parameters
        ----------
        path : str or path-like
            The file, ``.npz`` (numpy) or ``.h5``/``.hdf5`` (HDF5, with units).
            A file that is there already is replaced.

        Raises
        ------
        FileError
            When the ending is another one or the file cannot be written.
        """
        write_cases(path, self._contents(), self.fingerprint())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Cases:
        """Read a data set that :meth:`save` wrote.

        Parameters
        ----------
        path : str or path-like
            A file whose name ends in ``.npz``, ``.h5`` or ``.hdf5``.

        Returns
        -------
        Cases
            Equal to the one that was saved.

        Raises
        ------
        DataNotFoundError
            When there is no such file.
        FileError
            When the file is truncated, damaged, foreign, or of a newer version.
        """
        contents, name = read_cases(path), repr(str(path))
        prefix = "labels/"
        try:
            cases = cls(
                **{key: contents[key] for key in UNITS},
                period=contents["period"].item(),
                labels={
                    key.removeprefix(prefix): values
                    for key, values in contents.items()
                    if key.startswith(prefix)
                },
            )
        except ValueError as error:
            raise FileError(f"{name} holds data that are not usable: {error}") from error
        if cases.fingerprint() != str(contents["fingerprint"]):
            raise FileError(f"{name} was changed after it was saved; save or copy it again")
        return cases


def _pairs(value: Any, where: str) -> list[tuple[int, int]]:
    """Check a list of (geometry, waveform) pairs."""
    if isinstance(value, (str, Mapping)) or not hasattr(value, "__len__") or len(value) == 0:
        raise InputError(f"{where} must be a non-empty list of [geometry, waveform] pairs")
    pairs: list[tuple[int, int]] = []
    for i, pair in enumerate(value):
        good = (
            isinstance(pair, (list, tuple, np.ndarray))
            and len(pair) == 2
            and all(isinstance(n, (int, np.integer)) and not isinstance(n, bool) for n in pair)
        )
        if not good:
            raise InputError(
                f"{where}, entry {i}, is {pair!r}; write [geometry, waveform], two whole numbers"
            )
        key = (int(pair[0]), int(pair[1]))
        if key in pairs:
            raise InputError(f"{where} names {key} twice, the second time as entry {i}")
        pairs.append(key)
    return pairs


def _matches(present: NDArray[Any], value: Any) -> NDArray[np.bool_]:
    """Mark equal labels; fractions within rounding, so that 0.55 finds 0.55."""
    if present.dtype.kind == "f" and isinstance(value, (int, float, np.number)):
        close: NDArray[np.bool_] = np.isclose(present, float(value), atol=1e-12, equal_nan=True)
        return close
    return np.array([bool(each == value) for each in present.tolist()])
