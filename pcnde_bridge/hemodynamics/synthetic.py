"""Synthetic data set: the paper's matrix of cases, computed by the 1D solver.

It replaces 3D simulations where there are none: 10 geometries (blockage 40 … 85 %)
under 10 waveforms, solved by :mod:`pcnde_bridge.hemodynamics.solver` with the pressure
drop of Seeley and Young in the stenosis, and cached on disk.  A model's errors on it
show how well the model learns, not how well a 1D model represents 3D flow.
"""

import hashlib
import logging
import os
import sys
from collections.abc import Sequence
from functools import partial

import numpy as np
import pandas as pd

from pcnde_bridge._utils.files import cache_folder, make_folder
from pcnde_bridge._utils.validation import check_memory, counted, finite_vector, positive, whole
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.variables import SOLVER_LABELS
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.hemodynamics.discretization import discretize, on_grid
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.outlet import Windkessel
from pcnde_bridge.hemodynamics.solver import Tube1D
from pcnde_bridge.hemodynamics.waveform import DATA_FACTORS, Waveform, coronary

BLOCKAGES = (0.40, 0.85)
"""Smallest and largest blockage, a fraction of area."""

OUTLET_RESISTANCE = 109_236.9
"""R at the outlet, dyn·s/cm⁵, without distal pressure, as in the paper's 3D data."""

DATA_VERSION = 4
"""Version of the numbers, to be raised when a change here or in the solver changes them."""

# Spread of the waveforms of the seeds, relative to the built-in one.
_MEAN_SPREAD, _HARMONIC_SPREAD, _PHASE_SPREAD = 0.05, 0.15, 0.15

_log = logging.getLogger("pcnde_bridge")


def synthetic(
    n_geometries: int = 10,
    n_waveforms: int = 10,
    seed: int = 0,
    *,
    stenosis_positions: Sequence[float] = (2.0,),
    hyperemia: float = 1.0,
    n_points: int = 101,
    tube: Tube1D | None = None,
    cache: str | os.PathLike[str] | bool | None = None,
    progress: bool = True,
) -> Cases:
    """Compute the synthetic data set, or read it from the cache.

    Every geometry is solved under every waveform, from rest, with the paper's
    artery (4 cm long, 0.4 cm wide, linear wall, resistance outlet).  The last
    cycle is returned.

    Parameters
    ----------
    n_geometries : int
        Geometries 1 … n, their blockages equally spaced from 40 to 85 % of the
        area; a single one has 40 %.
    n_waveforms : int
        Waveforms 0 … n − 1: one base waveform with its oscillation scaled.  Ten
        have the factors of the paper's data, another number equally spaced
        factors from −0.5 to 1.75, and a single one the factor 1.
    seed : int
        With 0 the base is :func:`~pcnde_bridge.hemodynamics.waveform.coronary`.  Any other
        seed gives a variation of it, another patient: its mean is changed by 5 %
        (standard deviation), each of its harmonics by 15 % in amplitude and by
        0.15 rad in phase.
    stenosis_positions : sequence of float
        Throats of the stenoses, cm; all stenoses of a vessel have its blockage.
        Without positions the vessel is healthy, and there is a single geometry.
    hyperemia : float
        Factor of all flows; the outlet's resistance is divided by it.  4 is maximal flow,
        for which the fractional flow reserve is defined.
    n_points : int
        Points along the vessel.
    tube : Tube1D, optional
        The solver; by default 100 time points per cycle, three cycles, and the
        Seeley–Young drop as printed in the paper.
    cache : path-like or False, optional
        Folder of the cached result; by default the one that
        :func:`~pcnde_bridge.download_published` uses.  False computes the cases again
        and caches nothing.
    progress : bool
        Show progress on standard error while computing.

    Returns
    -------
    Cases
        ``n_geometries * n_waveforms`` cases in the order of their labels, which
        are geometry, waveform, blockage, factor (of the waveform), periodicity
        and volume_balance (see :meth:`~pcnde_bridge.hemodynamics.solver.Tube1D.solve`).

    Raises
    ------
    InputError
        If an argument is not usable; nothing has been computed then.
    SolveError
        If a case diverges.

    Examples
    --------
    >>> from pcnde_bridge.hemodynamics.synthetic import synthetic
    >>> train, test = synthetic().split("paper")  # doctest: +SKIP
    """
    n_geometries = whole("n_geometries", n_geometries, 1)
    n_waveforms = whole("n_waveforms", n_waveforms, 1)
    seed, n_points = whole("seed", seed), whole("n_points", n_points)
    places = finite_vector("stenosis_positions", stenosis_positions).tolist()
    if not places and n_geometries > 1:
        raise InputError("Without a stenosis all geometries are the same; use n_geometries=1.")
    solver = Tube1D() if tube is None else tube
    count = n_geometries * n_waveforms
    check_memory(counted(count, "case"), 9 * count * solver.n_times * n_points, "compute fewer")
    blockages = np.linspace(*BLOCKAGES, n_geometries).round(12).tolist()
    vessels = [Vessel(tuple(Stenosis(beta, place) for place in places)) for beta in blockages]
    factors = _factors(n_waveforms)
    hyperemia = positive("hyperemia", hyperemia)
    waveforms = base_waveform(seed, hyperemia).family(factors)
    outlet = Windkessel(OUTLET_RESISTANCE / hyperemia)
    solve = partial(_solve, solver, vessels, waveforms, outlet, factors, n_points, progress)
    if cache is False:
        return solve()
    # The name has a checksum of everything that the numbers depend on.
    series = [vars(waveform) for waveform in waveforms]
    content = (DATA_VERSION, vessels, series, outlet.resistance, n_points, solver)
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):  # of arrays all digits
        key = hashlib.sha256(repr(content).encode()).hexdigest()[:16]
    folder = cache_folder(None if cache is True else cache) / "synthetic"
    path = folder / f"{n_geometries}x{n_waveforms}-seed{seed}-{key}.npz"
    try:
        if path.is_file():
            return Cases.load(path)
    except FileError as error:
        _log.warning("The cached cases cannot be read and are computed again: %s.", error)
    cases = solve()
    try:
        make_folder(folder)
        cases.save(path)
    except FileError as error:
        _log.warning("The cases could not be stored in the cache: %s.", error)
    return cases


def base_waveform(seed: int, hyperemia: float = 1.0) -> Waveform:
    """Return the inlet waveform from which all waveforms of a seed are scaled.

    Parameters
    ----------
    seed, hyperemia
        See :func:`synthetic`.
    """
    base = coronary()
    harmonics = np.array(base.cosine) - 1j * np.array(base.sine)
    if seed == 0:
        return Waveform.from_spectrum(hyperemia * base.mean, hyperemia * harmonics, base.period)
    rng = np.random.default_rng(seed)
    mean = base.mean * (1.0 + _MEAN_SPREAD * float(rng.standard_normal()))
    amplitude = np.exp(_HARMONIC_SPREAD * rng.standard_normal(base.n_terms))
    phase = _PHASE_SPREAD * rng.standard_normal(base.n_terms)
    harmonics = hyperemia * harmonics * amplitude * np.exp(1j * phase)
    return Waveform.from_spectrum(hyperemia * mean, harmonics, base.period)


def _factors(count: int) -> tuple[float, ...]:
    if count == len(DATA_FACTORS):
        return DATA_FACTORS
    if count == 1:
        return (1.0,)
    factors = np.linspace(min(DATA_FACTORS), max(DATA_FACTORS), count)
    return tuple(factors.round(12).tolist())


def _solve(
    tube: Tube1D,
    vessels: Sequence[Vessel],
    waveforms: Sequence[Waveform],
    outlet: Windkessel,
    factors: Sequence[float],
    n_points: int,
    progress: bool,
) -> Cases:
    """Solve geometry by geometry, in batches of one compiled shape."""
    from rich.console import Console
    from rich.progress import track

    problems, n = [], len(waveforms)
    for number, vessel in enumerate(vessels, start=1):  # all of them before anything is computed
        table = {"geometry": number, "waveform": range(n), "blockage": vessel.blockage}
        labels = pd.DataFrame({**table, "factor": factors})
        given = on_grid([vessel] * n, waveforms, n_points, labels)
        problems.append(discretize(tube, waveforms=waveforms, outlet=outlet, **given))
    description, console = f"Computing {len(vessels) * n} cases", Console(stderr=True)
    shown = track(problems, description, console=console, disable=not progress)
    parts = [tube.run(problem).check() for problem in shown]
    flow, area, pressure, area_undeformed = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("flow", "area", "pressure", "area_undeformed")
    )
    labels = pd.concat([part.labels for part in parts], ignore_index=True)
    fields = flow, area, pressure, area_undeformed, parts[0].time, parts[0].z
    cases = Cases(*fields, period=parts[0].period, labels=labels)
    words = "Computed %d synthetic cases; periodicity %.1e, volume balance %.1e at worst."
    _log.info(words, len(cases), *cases.labels[list(SOLVER_LABELS)].max())
    return cases
