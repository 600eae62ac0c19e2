"""The data set: flow, area and pressure of many vessels over one heart cycle."""

from __future__ import annotations

import dataclasses
import json
import os
import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import permutations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from pcnde_bridge.errors import DataNotFoundError, FileError, InputError, PCNDEWarning
from pcnde_bridge.files import atomic_write, check_members, sha256_arrays
from pcnde_bridge.grid import Grid
from pcnde_bridge.h5 import read_dataset

FloatArray = NDArray[np.float64]

FORMAT = "pcnde-cases"
FORMAT_VERSION = 1

VARIABLES = ("flow", "area", "pressure")

#: The units of every array (CGS).
UNITS = {
    "flow": "mL/s",
    "area": "cm^2",
    "pressure": "dyn/cm^2",
    "area_undeformed": "cm^2",
    "time": "s",
    "z": "cm",
}
_AXES = ("case", "time", "z")
_NPZ_SUFFIXES = (".npz",)
_H5_SUFFIXES = (".h5", ".hdf5")
_SUFFIXES = _NPZ_SUFFIXES + _H5_SUFFIXES


class UnitsWarning(PCNDEWarning):
    """The size of the numbers suggests that they are not in CGS units."""


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
        arrays = {name: _real_array(name, value) for name, value in given.items()}
        _check_shapes(arrays)
        for name, array in arrays.items():
            _refuse(name, array, ~np.isfinite(array), "all values must be finite")
        for name in ("area", "area_undeformed"):
            _refuse(name, arrays[name], arrays[name] <= 0, "areas must be positive (cm²)")
        steps = np.diff(arrays["z"])
        _refuse("z", arrays["z"][1:], steps <= 0, "z must be strictly increasing (cm)", shift=1)
        cycle = _check_time(arrays, period)
        table = _check_labels(labels, arrays["area_undeformed"])
        self._fill(arrays, cycle, table)
        _warn_of_units(arrays)

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
            f"Cases({_count(self.n_cases, 'case')}: {_count(geometries, 'geometry')}, "
            f"{_count(waveforms, 'waveform')}; {self.n_times} instants over {self.period:g} s; "
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
            Columns geometry, waveform, blockage, time (s), z (cm), flow (mL/s),
            area (cm²), pressure (dyn/cm²) and area_undeformed (cm²), with
            ``n_cases * n_times * n_points`` rows; z varies fastest.
        """
        shape = self.flow.shape
        columns: dict[str, NDArray[Any]] = {
            name: np.repeat(self._labels[name].to_numpy(), shape[1] * shape[2])
            for name in ("geometry", "waveform", "blockage")
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
                    f"the mask has {_count(len(asked), 'value')} but there are "
                    f"{_count(self.n_cases, 'case')}; give one value per case"
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
        return np.where(asked < 0, asked + self.n_cases, asked).astype(np.intp)

    def _paired(self, pairs: Sequence[tuple[int, int]], where: str) -> NDArray[np.intp]:
        """Find the positions of (geometry, waveform) pairs, in their order."""
        known = {key: i for i, key in enumerate(self._keys())}
        absent = [pair for pair in pairs if pair not in known]
        if absent:
            raise InputError(
                f"{where} asks for cases that are not in this data set: (geometry, waveform) = "
                f"{_listed(absent)}; the pairs there are stand in cases.labels"
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
                    f"no case has {column} = {_listed(absent)}; "
                    f"the values there are: {_listed(pd.unique(self._labels[column]).tolist())}"
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
                f"data set has {_count(len(set(geometry)), 'geometry')} and "
                f"{_count(len(set(waveform)), 'waveform')}, so no case is left for training; "
                "name the cases with a mapping instead"
            )
        return Split(self._take(order[~test]), self._take(order[test]))

    def _split_by(self, mapping: Mapping[str, Any], name: str) -> Split:
        unknown = [key for key in mapping if key not in ("train", "test")]
        if unknown:
            raise InputError(
                f"{name} has unknown keys: {_listed(unknown)}; the keys are 'train' and 'test'"
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
                f"{_listed(both)}; a case may be in one of them"
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
        suffix = _suffix(path)
        header: dict[str, str | int] = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "fingerprint": self.fingerprint(),
        }
        contents = self._contents()
        with atomic_write(path) as temporary:
            if suffix in _NPZ_SUFFIXES:
                with temporary.open("wb") as handle:
                    arrays: dict[str, Any] = {**header, **contents}
                    np.savez(handle, **arrays)
            else:
                _write_h5(temporary, header, contents)

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
        suffix = _suffix(path)
        name = repr(str(path))
        if not Path(path).is_file():
            raise DataNotFoundError(f"there is no file {name}; check the path")
        read = _read_npz if suffix in _NPZ_SUFFIXES else _read_h5
        try:
            contents = read(Path(path))
        except _Refused as error:
            raise FileError(f"{name} {error}") from error
        except Exception as error:  # damaged bytes can make a reader raise nearly anything
            raise FileError(
                f"{name} is truncated or damaged ({error}); save or copy it again"
            ) from error
        absent = [key for key in (*UNITS, "period", "fingerprint") if key not in contents]
        if absent:
            raise FileError(f"{name} is incomplete: it lacks {_listed(absent)}; save it again")
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


# ---- checks of what is given ---------------------------------------------


def _real_array(name: str, value: ArrayLike) -> FloatArray:
    """Return a C-contiguous float64 copy of real numbers."""
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise InputError(f"{name} is not a regular array: {error}") from error
    if array.dtype.kind not in "iuf":
        raise InputError(
            f"{name} must hold real numbers, but its dtype is {array.dtype}; convert it, for "
            f"example with np.asarray({name}, dtype=float)"
        )
    if np.ma.is_masked(value):
        raise InputError(f"{name} has masked values; fill them or leave out their cases")
    return np.array(array, dtype=np.float64, order="C", copy=True)


def _check_shapes(arrays: Mapping[str, FloatArray]) -> None:
    """Compare every shape with the lengths of time, z and the cases."""
    for name in ("time", "z"):
        if arrays[name].ndim != 1:
            raise InputError(f"{name} must have one axis, but its shape is {arrays[name].shape}")
    n_times, n_points = len(arrays["time"]), len(arrays["z"])
    if n_times < 4:
        raise InputError(f"time has {_count(n_times, 'instant')}; at least 4 are needed")
    if n_points < 3:
        raise InputError(f"z has {_count(n_points, 'point')}; at least 3 are needed")
    undeformed = arrays["area_undeformed"].shape
    if undeformed != (*undeformed[:1], n_points):
        raise InputError(
            f"area_undeformed must have the shape (case, z) = (n_cases, {n_points}), but its shape "
            f"is {undeformed}" + (_one_case_hint("area_undeformed") if len(undeformed) == 1 else "")
        )
    n_cases = undeformed[0]
    if n_cases < 1:
        raise InputError("there is no case: area_undeformed has length 0 along its first axis")
    expected = (n_cases, n_times, n_points)
    for name in VARIABLES:
        shape = arrays[name].shape
        if shape != expected:
            raise InputError(
                f"{name} must have the shape (case, time, z) = {expected}, as area_undeformed, "
                f"time and z say, but its shape is {shape}{_axes_hint(name, shape, expected)}"
            )


def _axes_hint(name: str, shape: tuple[int, ...], expected: tuple[int, int, int]) -> str:
    """Name a swapped axis order when the shape gives it away."""
    if len(shape) == 2:
        return _one_case_hint(name)
    for order in permutations(range(3)):
        if tuple(expected[axis] for axis in order) == shape:
            found = ", ".join(_AXES[axis] for axis in order)
            back = tuple(order.index(axis) for axis in range(3))
            return f"; that looks like ({found}): pass np.transpose({name}, {back})"
    return ""


def _one_case_hint(name: str) -> str:
    return f"; for a single case pass {name}[np.newaxis]"


def _refuse(
    name: str, array: FloatArray, wrong: NDArray[np.bool_], rule: str, *, shift: int = 0
) -> None:
    """Raise for the first wrong value, and say how many there are."""
    if not wrong.any():
        return
    first = tuple(int(i) for i in np.argwhere(wrong)[0])
    place = ", ".join(str(i + shift) for i in first)
    total = int(np.count_nonzero(wrong))
    raise InputError(
        f"{name}[{place}] is {array[first]}: {rule}; "
        f"{_count(total, 'value')} of {name} {'is' if total == 1 else 'are'} wrong in this way"
    )


def _check_time(arrays: Mapping[str, FloatArray], period: float | None) -> float:
    """Check that the instants divide the period evenly; return the period."""
    time = arrays["time"]
    n_times = len(time)
    step = float(time[-1] - time[0]) / (n_times - 1)
    if step <= 0:
        raise InputError("time must increase (s); it ends before it starts")
    # A ten-thousandth of a step leaves room for times stored in single precision.
    off = np.abs(time - (time[0] + step * np.arange(n_times))) > 1e-4 * step
    _refuse("time", time, off, f"time must have uniform steps (here {step:g} s)")
    cycle = n_times * step
    end_repeated = (
        "the last instant repeats the first, one period later; leave it out (time[:-1], "
        "flow[:, :-1], area[:, :-1], pressure[:, :-1])"
    )
    if period is None:
        fields = [arrays[name] for name in VARIABLES]
        closed = all(np.array_equal(field[:, 0], field[:, -1]) for field in fields)
        steady = all(np.array_equal(field[:, 0], field[:, 1]) for field in fields)
        if closed and not steady:
            raise InputError(f"{end_repeated}, or pass period= if it does not")
        return cycle
    if isinstance(period, bool) or not isinstance(period, (int, float, np.integer, np.floating)):
        raise InputError(f"period must be a number of seconds; {period!r} is not")
    if abs(cycle - period) <= 1e-6 * abs(period):
        return float(period)
    if abs(cycle - step - period) <= 1e-3 * step:
        why = end_repeated
    elif abs(cycle + step - period) <= 1e-3 * step:
        why = "the last instant of the cycle is missing"
    else:
        why = "time must cover one period, without its end point"
    raise InputError(
        f"period is {period:g} s, but {n_times} instants in steps of {step:g} s make "
        f"{cycle:g} s: {why}"
    )


def _check_labels(
    labels: pd.DataFrame | Mapping[str, Any] | None, area_undeformed: FloatArray
) -> pd.DataFrame:
    """Return the labels as a clean table: geometry, waveform, blockage, the rest."""
    n_cases = len(area_undeformed)
    if labels is None:
        labels = {"geometry": np.arange(n_cases), "waveform": np.zeros(n_cases, dtype=int)}
    try:
        given = pd.DataFrame(labels)
    except (ValueError, TypeError) as error:
        raise InputError(f"labels cannot be made into a DataFrame: {error}") from error
    absent = [name for name in ("geometry", "waveform") if name not in given]
    if absent:
        raise InputError(f"labels lacks the column {absent[0]!r}; add it, as whole numbers")
    for name in given.columns:
        if not (isinstance(name, str) and name.isidentifier()):
            raise InputError(
                f"labels has a column named {name!r}; use Python names, such as 'patient_1'"
            )
    if not given.columns.is_unique:
        raise InputError(f"labels has two columns named {given.columns[_second(given.columns)]!r}")
    if len(given) != n_cases:
        raise InputError(
            f"labels has {_count(len(given), 'row')} but there are {_count(n_cases, 'case')}; "
            "give one row per case"
        )
    columns: dict[str, NDArray[Any] | list[str]] = {
        name: _whole_numbers(name, given[name]) for name in ("geometry", "waveform")
    }
    columns["blockage"] = (
        _blockages(given["blockage"])
        if "blockage" in given
        else 1.0 - area_undeformed.min(axis=1) / area_undeformed[:, 0]
    )
    rest = [name for name in given.columns if name not in columns]
    columns.update({name: _label_values(name, given[name]) for name in rest})
    table = pd.DataFrame(columns)
    pairs = pd.MultiIndex.from_frame(table[["geometry", "waveform"]])
    if not pairs.is_unique:
        again = _second(pairs)
        raise InputError(
            f"labels names two cases alike: geometry {table['geometry'][again]}, waveform "
            f"{table['waveform'][again]} stands in rows {pairs.tolist().index(pairs[again])} and "
            f"{again}; give each case its own pair"
        )
    return table


def _second(index: pd.Index[Any]) -> int:
    """Return the position of the first entry that was there before."""
    return int(np.argmax(index.duplicated()))


def _whole_numbers(name: str, column: pd.Series[Any]) -> NDArray[Any]:
    values = column.to_numpy()
    if values.dtype.kind in "iu":
        return values.astype(np.int64)
    if values.dtype.kind == "f" and np.all(np.isfinite(values)) and np.all(values % 1 == 0):
        return values.astype(np.int64)
    row = next((i for i, v in enumerate(values) if not _is_whole(v)), 0)
    raise InputError(f"labels[{name!r}][{row}] is {values[row]!r}; {name} must be a whole number")


def _is_whole(value: Any) -> bool:
    return isinstance(value, (int, float, np.number)) and float(value).is_integer()


def _blockages(column: pd.Series[Any]) -> NDArray[Any]:
    try:
        values = column.to_numpy(dtype=np.float64, na_value=np.nan)
    except (ValueError, TypeError) as error:
        raise InputError(f"labels['blockage'] must hold numbers: {error}") from error
    unknown = np.isnan(values)
    _refuse(
        "labels['blockage']",
        values,
        ~unknown & ~((values >= 0) & (values < 1)),
        "blockage is a fraction of the area, at least 0 and below 1, or NaN where unknown",
    )
    # One NaN for all, whatever its bits were, so that equal tables have equal checksums.
    return np.where(unknown, np.nan, values)


def _label_values(name: str, column: pd.Series[Any]) -> NDArray[Any] | list[str]:
    values = column.to_numpy()
    if values.dtype.kind == "b":
        return values.astype(np.bool_)
    if values.dtype.kind in "iu":
        return values.astype(np.int64)
    if values.dtype.kind == "f":
        return np.where(np.isnan(values), np.nan, values).astype(np.float64)
    for row, value in enumerate(values):
        # A file can hold neither a NUL character nor half a surrogate pair.
        if not isinstance(value, str) or "\0" in value or not _encodable(value):
            raise InputError(
                f"labels[{name!r}][{row}] is {value!r}; a column of labels must hold numbers "
                "throughout or plain text throughout"
            )
    return [str(value) for value in values]


def _encodable(text: str) -> bool:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def _warn_of_units(arrays: Mapping[str, FloatArray]) -> None:
    """Warn of magnitudes that no vessel has in CGS units."""
    undeformed = arrays["area_undeformed"]
    area = float(np.median(undeformed))
    ratio = float(np.median(arrays["area"] / undeformed[:, None, :]))
    speed = float(np.median(np.abs(arrays["flow"]) / arrays["area"]))
    pressure = float(np.max(np.abs(arrays["pressure"])))
    doubts = []
    if not 1e-4 <= area <= 100:
        doubts.append(f"the median undeformed area is {area:.3g}, expected cm²")
    if not 0.2 <= ratio <= 5:
        doubts.append(f"area is {ratio:.3g} times area_undeformed; both are expected in cm²")
    if speed != 0 and not 0.5 <= speed <= 500:
        doubts.append(f"the median of flow / area is {speed:.3g}, expected cm/s (mL/s over cm²)")
    if not 1e3 <= pressure <= 1e7:
        doubts.append(
            f"the largest pressure is {pressure:.3g}, expected dyn/cm² (1 mmHg = 1333.22 dyn/cm²)"
        )
    if doubts:
        warnings.warn("check the units: " + "; ".join(doubts), UnitsWarning, stacklevel=3)


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


def _count(n: int, noun: str) -> str:
    plural = noun[:-1] + "ies" if noun.endswith("y") else noun + "s"
    return f"{n} {noun if n == 1 else plural}"


def _listed(values: Sequence[Any], most: int = 10) -> str:
    """List values in a message, but not hundreds of them."""
    text = ", ".join(str(value) for value in values[:most])
    return text if len(values) <= most else f"{text}, … ({len(values)} in all)"


# ---- files ------------------------------------------------------------------


class _Refused(Exception):
    """The file is sound, but is none that :meth:`Cases.load` reads; the message says why."""


def _check_header(header: Mapping[str, Any]) -> None:
    """Refuse files of other programs and of newer versions of this one."""
    if str(header.get("format")) != FORMAT or "format_version" not in header:
        raise _Refused("is not a data set saved by this package; load files that Cases.save wrote")
    version = int(header["format_version"])
    if version > FORMAT_VERSION:
        raise _Refused(
            f"has format version {version}, newer than {FORMAT_VERSION}, the newest that this "
            "version of the package reads; update the package"
        )


def _suffix(path: str | os.PathLike[str]) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in _SUFFIXES:
        raise FileError(
            f"{str(path)!r} must end in one of {', '.join(_SUFFIXES)}, which says the format"
        )
    return suffix


def _read_npz(path: Path) -> dict[str, NDArray[Any]]:
    with path.open("rb") as handle:
        if handle.read(2) != b"PK":
            raise _Refused("is not an .npz file; load files that Cases.save wrote")
    with np.load(path, allow_pickle=False) as archive:
        check_members(archive.zip, path.stat().st_size)
        _check_header(archive)
        return dict(archive)


def _write_h5(
    path: Path, header: Mapping[str, str | int], contents: Mapping[str, NDArray[Any]]
) -> None:
    import h5py

    # This generation of the format guards its structure by checksums. Text of fixed
    # length keeps out of the one part that they do not cover, where a damaged byte
    # can hang the reader.
    with h5py.File(path, "w", libver=("v108", "v110")) as file:
        for name, value in header.items():
            file.attrs[name] = np.bytes_(value) if isinstance(value, str) else value
        file.create_group("labels", track_order=True)
        for name, values in contents.items():
            file[name] = _h5_text(values) if values.dtype.kind == "U" else values
        for name, units in (*UNITS.items(), ("period", "s")):
            file[name].attrs["units"] = np.bytes_(units)
        for name in VARIABLES:
            file[name].attrs["axes"] = np.bytes_("case, time, z")
        file["area_undeformed"].attrs["axes"] = np.bytes_("case, z")


def _h5_text(values: NDArray[Any]) -> NDArray[Any]:
    """Return text as UTF-8 of fixed length."""
    import h5py

    encoded = np.char.encode(values, "utf-8")
    return encoded.astype(h5py.string_dtype("utf-8", max(encoded.dtype.itemsize, 1)))


def _read_h5(path: Path) -> dict[str, NDArray[Any]]:
    import h5py

    with path.open("rb") as handle:
        if handle.read(8) != b"\x89HDF\r\n\x1a\n":
            raise _Refused("is not an HDF5 file; load files that Cases.save wrote")
    with h5py.File(path, "r") as file:
        header = {
            key: value.decode() if isinstance(value, bytes) else value
            for key, value in file.attrs.items()
        }
        _check_header(header)
        names = [*file, *(f"labels/{name}" for name in file["labels"])]
        found = {name: read_dataset(file, name) for name in names}
        contents = {name: values for name, values in found.items() if values is not None}
        if "fingerprint" in header:
            contents["fingerprint"] = np.array(header["fingerprint"])
    return contents
