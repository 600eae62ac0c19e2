"""Inputs that a user of the page chooses: a vessel and a waveform, with their limits.

The controls extend somewhat beyond the training data, as far as the model knows them.
"""

import math
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.errors import InputError, PCNDEError
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.synthetic import BLOCKAGES
from pcnde_bridge.hemodynamics.waveform import DATA_FACTORS, Waveform, coronary
from pcnde_bridge.io.input_tables import read_cycle
from pcnde_bridge.model.pcnde import PCNDE

_EXTENSION = 0.25  # of a control on either side, relative to the training range
_SHORTEST, _LONGEST = 0.2, 1.0  # stenosis, cm; the 1D solver's grid resolves 0.16 cm
_MARGIN = 0.1  # between a stenosis and the ends of the vessel, cm
_MOST_COLUMNS = 200  # of an uploaded table; reading a very wide one takes long
_HEALTHY = 0.01  # blockage below which a vessel has no stenosis


class Span(NamedTuple):
    """Limits, step and initial value of one control.

    Attributes
    ----------
    minimum, low, high, maximum : float
        Limits of the control, and of the training data between them.
    step : float
        Step of the control.
    start : float
        Initial value of the control.
    """

    minimum: float
    low: float
    high: float
    maximum: float
    step: float
    start: float


class Inputs(NamedTuple):
    """One choice, which determines everything on the page.

    Attributes
    ----------
    vessel : Vessel
        Vessel with one stenosis or none.
    waveform : Waveform
        Flow at the inlet.
    """

    vessel: Vessel
    waveform: Waveform


class Choices:
    """Choices that the controls offer for a model.

    Parameters
    ----------
    model : PCNDE
        Model, whose record of its training data gives the limits.

    Attributes
    ----------
    base : Waveform
        The strongest waveform of the training data, which the scale multiplies.
    healthy : Vessel
        Vessel without stenosis.
    scale, blockage, position, length : Span
        Factor of the waveform's oscillation; blocked fraction of the area; throat of the
        stenosis, cm from the inlet, and its length, cm.
    from_training : bool
        Whether the limits are those of the training data; a model without them gets the
        limits of the synthetic data set.
    any_grid : bool
        Whether position and length can be chosen.
    """

    def __init__(self, model: PCNDE) -> None:
        z = model.grid.z - model.grid.z[0]
        end, period = float(z[-1]), model.grid.period
        if model.novelty is None:
            self.base, factors = coronary(period), (min(DATA_FACTORS), max(DATA_FACTORS))
            self.healthy, blockages = Vessel(length=end), BLOCKAGES
            throat, length = end / 2, min(0.5, end / 4)
        else:
            inflow = model.novelty.inflow_ends(model.grid.time.size)
            self.base, factors = _strongest(inflow, period)
            self.healthy, blockages, throat, length = _stenosis(z, model.novelty.area_ends(z))
        longest = max(length, min(_LONGEST, end / 2))
        reach = longest / 2 + _MARGIN
        ends = min(reach, throat), throat, throat, max(end - reach, throat)
        self.position = _span(*ends, 0.05)
        self.length = _span(min(_SHORTEST, length), length, length, longest, 0.05)
        self.scale = _around(*factors, 0.05)
        self.blockage = _around(*blockages, 0.005, 0.0, 0.95)
        self.from_training = model.novelty is not None
        self.any_grid = model.any_grid

    @property
    def initial(self) -> Inputs:
        """Inputs at the initial values of the controls."""
        return self.inputs(self.blockage.start, self.scale.start)

    def inputs(
        self,
        blockage: float,
        scale: float,
        position: float | None = None,
        length: float | None = None,
        waveform: Waveform | None = None,
    ) -> Inputs:
        """Create vessel and waveform from the values of the controls.

        Parameters
        ----------
        blockage : float
            Blocked fraction of the area, in [0, 1).
        scale : float
            Factor of the waveform's oscillation.
        position, length : float, optional
            Throat and length of the stenosis, cm; the values of the training data by
            default, and for models that are bound to their grid.
        waveform : Waveform, optional
            Waveform to use instead of the strongest one of the training data.

        Raises
        ------
        InputError
            If a number is invalid.
        """
        if position is None or not self.any_grid:
            position = self.position.start
        if length is None or not self.any_grid:
            length = self.length.start
        stenosis = Stenosis(float(blockage), float(position), float(length))
        healthy = self.healthy
        vessel = Vessel((stenosis,) if blockage else (), healthy.length, healthy.diameter)
        return Inputs(vessel, (waveform or self.base).scaled(float(scale)))


def read_waveform(content: bytes, name: str, model: PCNDE) -> tuple[Waveform, str]:
    """Read an uploaded waveform, a table as for ``pcnde predict --inflow``.

    Parameters
    ----------
    content : bytes
        CSV: time (s), then a column of Q (mL/s); further columns are ignored.
    name : str
        Name of the file, for messages.
    model : PCNDE
        Model to whose time points the waveform will be resampled.

    Returns
    -------
    Waveform, str
        Waveform with no more harmonics than the model's time points resolve, and a note
        for the user.

    Raises
    ------
    InputError
        If it is not such a table, or the model is bound to another period.
    """
    grid = model.grid
    widest = max((line.count(b",") for line in content.splitlines()), default=0)
    if widest >= _MOST_COLUMNS:
        raise InputError(f"{name} has {widest + 1} columns: keep {_MOST_COLUMNS} at most.")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "upload.csv")
        path.write_bytes(content)
        try:
            period, columns = read_cycle(path, float(grid.time[0]), math.nan)
        except PCNDEError as error:
            raise InputError(str(error).replace(str(path), name)) from error
    if not model.any_grid and not math.isclose(period, grid.period, rel_tol=1e-6):
        raise InputError(
            f"{name} has a period of {period:g} s, but this model works at {grid.period:g} s "
            "only; use a model of the preset physics for other periods."
        )
    flow, resolved = columns.iloc[:, 0].to_numpy(dtype=np.float64), grid.time.size
    n_terms = None if flow.size <= resolved else (resolved - 1) // 2
    try:
        waveform = Waveform.from_samples(flow, period=period, n_terms=n_terms)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    note = f"{name}: {flow.size} time points over {period:g} s, mean {waveform.mean:.3g} mL/s"
    if flow.size != resolved:
        note += f", resampled to the model's {resolved} time points"
    if columns.shape[1] > 1:
        note += f"; the first of {columns.shape[1]} waveforms"
    return waveform, note + "."


def _strongest(ends: Array, period: float) -> tuple[Waveform, tuple[float, float]]:
    """Return the waveform with the largest oscillation, and the range of the factors."""
    oscillation = ends - ends.mean(axis=1, keepdims=True)
    size = np.linalg.norm(oscillation, axis=1)
    largest = int(size.argmax())
    base = Waveform.from_samples(ends[largest], period=period, n_terms=None)
    if size[largest] <= 1e-9 * np.abs(ends).max():  # steady flow
        return base, (0.0, 1.0)
    factors = oscillation @ oscillation[largest] / size[largest] ** 2
    return base, (float(factors.min()), float(factors.max()))


def _stenosis(z: Array, ends: Array) -> tuple[Vessel, tuple[float, float], float, float]:
    """Return the healthy vessel, range of blockages, and throat and length of the stenosis.

    The stenosis of :mod:`pcnde_bridge.hemodynamics.geometry` has half its depth at a quarter
    of its length from the throat; other shapes are treated as if they were of this one.
    """
    # The end slices of 3D vessels can be inaccurate, so the inlet area is not used.
    healthy = np.median(ends, axis=1)
    blockages = 1.0 - ends.min(axis=1) / healthy
    narrowest = ends[int(blockages.argmax())]
    vessel = Vessel(length=float(z[-1]), diameter=2.0 * math.sqrt(float(healthy[0]) / math.pi))
    if blockages.max() < _HEALTHY:
        return vessel, (0.0, 0.0), vessel.length / 2, min(0.5, vessel.length / 4)
    radius = np.sqrt(narrowest / math.pi)
    position = round(float(z[radius.argmin()]), 3)
    fine = np.linspace(0.0, vessel.length, 4001)
    wide = fine[np.interp(fine, z, radius) >= (vessel.diameter / 2 + radius.min()) / 2]
    start = float(wide[wide < position].max(initial=0.0))
    end = float(wide[wide > position].min(initial=vessel.length))
    longest = 2.0 * min(position, vessel.length - position)
    low, high = (float(round(max(b, 0.0), 3)) for b in (blockages.min(), blockages.max()))
    return vessel, (low, high), position, min(round(2.0 * (end - start), 2), longest)


def _around(
    low: float, high: float, step: float, floor: float = -math.inf, ceiling: float = math.inf
) -> Span:
    """Create a control that extends beyond a training range, within a floor and a ceiling."""
    beyond = _EXTENSION * (high - low) or _EXTENSION
    return _span(max(floor, low - beyond), low, high, min(ceiling, high + beyond), step)


def _span(minimum: float, low: float, high: float, maximum: float, step: float) -> Span:
    """Create a control whose values are multiples of the step, so that it shows round numbers."""
    minimum = min(math.ceil(round(minimum / step, 6)) * step, low)
    maximum = max(math.floor(round(maximum / step, 6)) * step, high)
    start = low + 0.75 * (high - low)
    if high > low:
        start = round(start / step) * step
    return Span(*(round(value, 6) for value in (minimum, low, high, maximum, step, start)))
