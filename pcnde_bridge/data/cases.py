"""The data set: flow, area and pressure of many vessels over one heart cycle."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from pcnde_bridge._typing import AnyArray, Array, StrPath
from pcnde_bridge._utils.archive import sha256_arrays, with_prefix
from pcnde_bridge._utils.display import draw
from pcnde_bridge._utils.hdf5 import release
from pcnde_bridge._utils.validation import counted
from pcnde_bridge.data.checks import check_arrays, check_plausible, check_time
from pcnde_bridge.data.files import read_cases, write_cases, write_fingerprint
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.indices import VesselQuantities
from pcnde_bridge.data.labels import LABELS, check_labels, label_arrays
from pcnde_bridge.data.selection import Positions, batches_of, select_positions
from pcnde_bridge.data.splits import fold_positions, split_positions
from pcnde_bridge.data.units import QUANTITIES, in_cgs, stated_units
from pcnde_bridge.data.variables import UNITS
from pcnde_bridge.errors import FileError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Split(NamedTuple):
    """Data set divided into training cases and test cases."""

    train: Cases
    test: Cases


@dataclasses.dataclass(frozen=True, init=False, eq=False, repr=False)
class Cases(VesselQuantities):
    """Flow, area and pressure along a vessel over one cycle, for many cases.

    A case is one geometry with one inflow waveform.  The object is immutable: its arrays
    are read-only, C-contiguous float64 copies of the arguments.  Read-only memory maps are
    not copied: they stay on disk, and :meth:`batches` reads them part by part.  The drop, the
    fractional flow reserve and other quantities are methods of
    :class:`~pcnde_bridge.data.indices.VesselQuantities`.

    Parameters
    ----------
    flow, area, pressure : array_like, shape (n_cases, n_times, n_points)
        Flow rate (mL/s), cross-sectional area (cm², positive) and pressure
        (dyn/cm²), in the order [case, time, z].
    area_undeformed : array_like, shape (n_cases, n_points)
        Area of the unloaded vessel (cm², positive).
    time : array_like, shape (n_times,)
        Time points (s) of one cycle, in uniform steps from any start, at least 4.  The
        end of the cycle, which equals its start, is not repeated.
    z : array_like, shape (n_points,)
        Positions along the vessel (cm), strictly increasing, at least 3.
    period : float, optional
        Length of the cycle (s), by default ``n_times`` time steps; any other value is rejected.
    labels : DataFrame or mapping, optional
        One row per case.  The columns ``geometry`` and ``waveform`` (whole numbers)
        together identify a case.  ``blockage`` is the fraction of the area that the
        stenosis blocks, NaN where unknown; by default it is
        ``1 - min(area_undeformed) / area_undeformed[0]``.  Further columns of numbers or
        text are retained; their names must be Python names.  By default ``geometry``
        counts the cases from 1, as in the published data, and ``waveform`` is 0.
    wall_shear_stress : array_like, shape (n_cases, n_times, n_points), optional
        Wall shear stress (dyn/cm²), the mean around the circumference, either of its axial
        component or, as in the published data, of its magnitude.
    units : str or mapping, optional
        ``"cgs"``, ``"mm-g-s"`` or ``"si"``, or the units that differ from CGS, such as
        ``{"pressure": "mmHg"}``; the arrays are converted.  ``{"area": "cm^2"}`` states that
        the areas are not radii or diameters, ``{"radius": "mm"}`` that they are radii.
    check : bool
        Refuse implausible data.  If False, implausible magnitudes give a warning only.

    Raises
    ------
    InputError
        If an argument is not usable; the message names the field and the index.  Also if
        the values are implausible for arteries of 0.8 mm to 5 cm in CGS units, if the cycle
        mean of a flow is negative or changes along the vessel by more than 4 %, if most of a
        wall shear stress is negative, or if one time point does not fit the others.

    Warns
    -----
    UnitsWarning
        If magnitudes are implausible and ``check`` is False.
    """

    flow: Array
    area: Array
    pressure: Array
    area_undeformed: Array
    time: Array
    z: Array
    wall_shear_stress: Array | None
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
        wall_shear_stress: ArrayLike | None = None,
        units: str | Mapping[str, str] | None = None,
        check: bool = True,
    ) -> None:
        given = flow, area, pressure, area_undeformed, time, z
        optional = {} if wall_shear_stress is None else {"wall_shear_stress": wall_shear_stress}
        arrays = check_arrays(dict(zip(UNITS, given, strict=False)) | optional)
        if stated := stated_units(units):
            arrays = {n: in_cgs(QUANTITIES.get(n, n), v, stated) for n, v in arrays.items()}
            period = None if period is None else in_cgs("time", period, stated)
        cycle = check_time(arrays, period)
        table = check_labels(labels, arrays["area_undeformed"])
        fields = {"wall_shear_stress": None, **arrays}
        self.__setstate__({**fields, "period": cycle, "_labels": table})
        check_plausible(arrays, stated, strict=check)

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Set the fields, also of copies, whose arrays would be writeable otherwise."""
        for name, value in state.items():
            if name in UNITS and value is not None:
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    # ---- contents ------------------------------------------------------

    @property
    def labels(self) -> pd.DataFrame:
        """Copy of the labels (geometry, waveform, blockage, …), one row per case."""
        return self._labels.copy()

    @property
    def n_cases(self) -> int:
        """Number of cases."""
        return int(self.flow.shape[0])

    @property
    def n_times(self) -> int:
        """Number of time points in the cycle."""
        return int(self.flow.shape[1])

    @property
    def n_points(self) -> int:
        """Number of points along the vessel."""
        return int(self.flow.shape[2])

    @property
    def grid(self) -> Grid:
        """Time points (s), points along the vessel (cm) and period (s)."""
        return Grid(self.time, self.z, self.period)

    @property
    def inflow(self) -> Array:
        """Flow rate at the inlet (mL/s), shape (n_cases, n_times); read-only."""
        return self.at_point("flow", 0)

    def at_point(self, name: str, point: int) -> Array:
        """Return a variable at a point of z, by its index, shape (n_cases, n_times); read-only."""
        values: Array = getattr(self, name)[:, :, point]
        if isinstance(values, np.memmap):
            values = np.array(values)
            values.setflags(write=False)
            release(getattr(self, name))
        return values

    def _facts(self) -> list[str]:
        names = "geometry", "waveform"
        kinds = ", ".join(counted(self._labels[name].nunique(), name) for name in names)
        more = [] if self.wall_shear_stress is None else ["with wall shear stress"]
        return [f"{counted(self.n_cases, 'case')}: {kinds}", *self.grid._facts(), *more]

    def plot(self) -> Figure:
        """Plot waveforms and geometries, by :func:`pcnde_bridge.plots.data_set`.

        Save the figure that it returns: ``cases.plot().savefig("cases.png")``.
        """
        return draw("data_set", self)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Cases):
            return NotImplemented
        return self.fingerprint() == other.fingerprint()

    def __hash__(self) -> int:
        return hash(self.fingerprint())

    def fingerprint(self) -> str:
        """Return a checksum of all numbers and labels.

        Returns
        -------
        str
            64 hexadecimal digits (SHA-256).  Two data sets are equal exactly if their
            fingerprints are equal.
        """
        return self._fingerprint

    @cached_property
    def _fingerprint(self) -> str:
        return sha256_arrays(self._contents())

    def _contents(self) -> dict[str, AnyArray]:
        """Return the whole content as arrays; labels are named ``labels/<column>``."""
        contents = {name: v for name in UNITS if (v := getattr(self, name)) is not None}
        contents["period"] = np.array(self.period)
        return contents | label_arrays(self._labels)

    # ---- subsets -------------------------------------------------------

    def select(self, index: Any = None, /, **labels: Any) -> Cases:
        """Return a subset of the cases.

        Parameters
        ----------
        index : int, slice, sequence of int, boolean mask or list of pairs, optional
            Positions in the data set, a mask of length ``n_cases``, or pairs
            ``[(geometry, waveform), …]``.  The result has the order of the request.
        **labels
            Values of label columns, instead of ``index``:
            ``select(geometry=10, waveform=[1, 2])`` returns the cases that match all of
            them, in the order of the data set.

        Returns
        -------
        Cases
            At least one case.

        Raises
        ------
        InputError
            If a requested case does not exist or is requested twice, or if no case
            matches.
        """
        return self._take(select_positions(self._labels, index, labels))

    def _take(self, positions: Positions) -> Cases:
        """Return the cases at valid positions; a range of memory maps stays on disk."""
        if len(positions) and np.array_equal(positions, np.arange(len(positions)) + positions[0]):
            rows: Any = slice(int(positions[0]), int(positions[-1]) + 1)
        else:
            rows = positions
        taken = object.__new__(Cases)
        arrays = {**self.variables(), "area_undeformed": self.area_undeformed}
        state = {name: getattr(self, name) for name in ("time", "z", "period", "wall_shear_stress")}
        state |= {name: values[rows] for name, values in arrays.items()}
        if rows is positions:
            release(*arrays.values())
        state["_labels"] = self._labels.iloc[positions].reset_index(drop=True)
        taken.__setstate__(state)
        return taken

    def __getitem__(self, index: Any) -> Cases:
        """Return ``select(index)``: ``cases[0]``, ``cases[2:5]``, ``cases[[3, 1]]``, a mask."""
        return self.select(index)

    def __iter__(self) -> Iterator[Cases]:
        """Iterate over the cases, each a data set of one case."""
        return map(self.select, range(self.n_cases))

    def batches(self, most: int = 64) -> Iterator[tuple[slice, Cases]]:
        """Iterate over ranges of the cases, of nearly equal size, and the cases in each.

        Of a data set that stays on disk, no more than one range is in memory.

        Parameters
        ----------
        most : int
            Largest number of cases in a range.
        """
        for rows in batches_of(self.n_cases, most):
            yield rows, self[rows]
            release(*self.variables().values())

    def split(
        self,
        how: float | StrPath | Mapping[str, Sequence[Sequence[int]]] | None = None,
        /,
        *,
        by: str | None = None,
        seed: int = 0,
        **labels: Any,
    ) -> Split:
        """Divide the data set into training and test cases.

        Parameters
        ----------
        how : "paper", float, mapping or path of a JSON file, optional
            ``"paper"``, the default, tests on the largest geometry label with every
            waveform and on the largest waveform label with every geometry, and trains on
            the rest, both in the order of their labels; for the published data this is the
            paper's split into 81 and 19 cases.  A number between 0 and 1 is the fraction of
            the cases to test on, chosen at random.  A mapping, or a JSON file with one,
            names the cases in the order wanted: ``{"train": [[geometry, waveform], …],
            "test": […]}``.  Cases that it does not name are left out.
        by : str, optional
            Name of a label, such as ``"geometry"``: the fraction is one of its values, and
            cases with the same value stay together.
        seed : int
            Seed of the random choice.
        **labels
            Values of label columns, instead of ``how``, as in :meth:`select`:
            ``split(geometry=[9, 10])`` tests on these cases and trains on the rest.

        Returns
        -------
        Split
            The named tuple ``(train, test)``; neither is empty.

        Raises
        ------
        InputError
            If training or test would be empty, or an argument is not usable.
        FileError
            If the file is missing or is not JSON.
        """
        return Split(*map(self._take, split_positions(self._labels, how, by, seed, labels)))

    def folds(self, count: int, /, *, by: str | None = None, seed: int = 0) -> list[Split]:
        """Divide the data set at random into folds for cross-validation.

        Parameters
        ----------
        count : int
            Number of folds, at least 2.
        by : str, optional
            Name of a label, such as ``"geometry"``: cases with the same value stay together.
        seed : int
            Seed of the random choice.

        Returns
        -------
        list of Split
            One for each fold: its cases are the test cases, all others train.  Every case
            is a test case once.

        Raises
        ------
        InputError
            If there are fewer cases, or values of the label, than folds.
        """
        parts = fold_positions(self._labels, count, by, seed)
        return [Split(*map(self._take, pair)) for pair in parts]

    # ---- files ---------------------------------------------------------

    def save(self, path: StrPath) -> None:
        """Write the data set to a file, atomically.

        Parameters
        ----------
        path : path-like
            The file, ``.npz`` (numpy) or ``.h5``/``.hdf5`` (HDF5, with units).  An
            existing file is replaced.

        Raises
        ------
        FileError
            If the name has another ending or the file cannot be written.
        """
        write_cases(path, self._contents(), self.fingerprint())

    @classmethod
    def load(cls, path: StrPath) -> Cases:
        """Read a data set written by :meth:`save`.

        Parameters
        ----------
        path : path-like
            A file whose name ends in ``.npz``, ``.h5`` or ``.hdf5``.

        Returns
        -------
        Cases
            Equal to the one that was saved.  Arrays of an HDF5 file that have 128 MB or more stay
            on disk: do not change the file meanwhile.

        Raises
        ------
        DataNotFoundError
            If there is no such file.
        FileError
            If the file is truncated, damaged, foreign, or of a newer version.
        """
        contents = read_cases(path)
        cases = _from_contents(path, contents)
        if cases.fingerprint() != str(contents["fingerprint"]):
            raise FileError(f"{path} was changed after it was saved; save or copy it again")
        return cases


def _from_contents(path: StrPath, contents: Mapping[str, AnyArray]) -> Cases:
    """Return the data set whose file has these arrays."""
    arrays: dict[str, Any] = {name: contents[name] for name in UNITS if name in contents}
    try:
        period, labels = contents["period"].item(), with_prefix(LABELS, contents)
        return Cases(**arrays, period=period, labels=labels, check=False)
    except ValueError as error:
        raise FileError(f"{path} holds data that are not usable: {error}") from error


def sign_cases(path: StrPath) -> None:
    """Complete a file of :func:`~pcnde_bridge.data.files.create_cases` by its fingerprint.

    Raises
    ------
    FileError
        If its arrays are not those of a data set.
    """
    write_fingerprint(path, _from_contents(path, read_cases(path)).fingerprint())
