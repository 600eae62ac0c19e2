"""Time, memory and errors of a fit to many cases; time and memory of many predictions.

Run ``python benchmarks/many_cases.py FOLDER [--preset physics] [--cases 100 1000 10000]
[--workers 0 1 2] [--predict | --sensitivity]``.  The cases are random samples of predictions of a
``physics`` model that is fitted to the published cases: they have the errors that the model has
on cases left out.  There are a tenth as many stenoses (blockage 40 to 85 %, position 1.8 to
2.2 cm, length 0.6 to 1.2 cm), each under ten waveforms.  FOLDER stores them.  Each fit is a
process of its own; it reports CPU seconds per case, the peak of the resident memory, with the
pages of the file that it has read, and the errors on 500 further cases.
With ``--workers`` the cases are on a local dask cluster, and the CPU seconds of this process
and of each worker are reported.  With ``--predict``, the indices of so many other cases are
predicted, and written to a file, in place of the fit; with ``--sensitivity``, Sobol indices of
five inputs are computed with about this number of predictions.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from pcnde_bridge import PCNDE, load_cases, load_model
from pcnde_bridge.evaluation import sobol_indices
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.waveform import DATA_FACTORS, coronary
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.model.prediction_file import predict_to_file

WAVEFORMS, LARGEST, TESTED = 10, 10_000, 500


class Sampled(PCNDE):
    """Model whose predictions are random samples of themselves."""

    def predict(self, *given, **options) -> Prediction:
        """Return one sample; the first inflow is its seed."""
        seed = int(abs(given[0].flat[1]) * 1e9)
        return next(super().predict(*given, samples=2, seed=seed, **options).each_sample())


def inputs(count: int, n_times: int, z: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random inflows and areas, ten inflows for each area."""
    rng = np.random.default_rng(seed)
    low, high = (0.40, 1.8, 0.6), (0.85, 2.2, 1.2)
    stenoses = rng.uniform(low, high, (-(-count // WAVEFORMS), 3))
    areas = np.array([Vessel((Stenosis(*row),)).area_undeformed(z) for row in stenoses.tolist()])
    waveform = coronary()
    oscillation = waveform.samples(n_times) - waveform.mean
    factor = rng.uniform(min(DATA_FACTORS), max(DATA_FACTORS), (count, 1))
    mean = waveform.mean * rng.uniform(0.9, 1.1, (count, 1))
    return mean + factor * oscillation, np.repeat(areas, WAVEFORMS, axis=0)[:count]


def create(folder: Path) -> None:
    """Write the training and test cases, unless the folder has them."""
    folder.mkdir(exist_ok=True)
    if not (path := folder / "model.npz").exists():
        PCNDE.fit(load_cases("published").split("paper").train, "physics", "jax").save(path)
    model = Sampled.load(path, "jax")
    for name, count, seed in (("train", LARGEST, 1), ("test", TESTED, 2)):
        if not (path := folder / f"{name}.h5").exists():
            q, s = inputs(count, model.grid.time.size, model.grid.z, seed)
            case = np.arange(count)
            labels = {"geometry": case // WAVEFORMS + 1, "waveform": case % WAVEFORMS}
            predict_to_file(model, path, q, s, labels=labels)


@contextmanager
def measured(count: int, workers: int) -> Iterator[tuple[Any, dict[str, float]]]:
    """Give the client of a cluster, or None, and a row with times and memory at the end."""
    row: dict[str, float] = {"cases": count}
    with clients(workers) as client:
        before = client.run(time.process_time) if client else {}
        cpu, wall = time.process_time(), time.perf_counter()
        yield client, row
        row |= {"cpu_s": time.process_time() - cpu, "wall_s": time.perf_counter() - wall}
        row |= {"ms_per_case": 1e3 * row["cpu_s"] / count, "cases_per_s": count / row["wall_s"]}
        after = client.run(time.process_time) if client else {}
        row |= {f"worker_{n}_s": after[k] - v for n, (k, v) in enumerate(before.items())}
    row["peak_gb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def fit(folder: Path, preset: str, count: int, workers: int) -> dict[str, float]:
    """Fit, and return time, memory and errors."""
    cases = load_cases(folder / "train.h5")[:count]
    with measured(count, workers) as (client, row):
        model = PCNDE.fit(cases, preset, "jax", executor=client)
    if (serial := folder / f"{preset}-{count}-0.npz").exists():
        pairs = zip(load_model(serial).parameters, model.parameters, strict=True)
        found = [np.abs(a - b).max() / np.abs(a).max() for (_, a), (_, b) in pairs if a.any()]
        row["difference"] = max(found)
    model.save(folder / f"{preset}-{count}-{workers}.npz")
    errors = model.evaluate(load_cases(folder / "test.h5")).iloc[-1]
    return row | {name: float(value) for name, value in errors.items()}


def predict(folder: Path, count: int, workers: int) -> dict[str, float]:
    """Write the indices of predictions to a file, and return time, memory and its size."""
    model = load_model(folder / "model.npz", "jax")
    path = folder / "predictions.h5"
    q, s = inputs(count, model.grid.time.size, model.grid.z, 3)
    with measured(count, workers) as (client, row):
        predict_to_file(model, path, q, s, fields=False, executor=client, progress=False)
    row["file_mb"] = path.stat().st_size / 1e6
    path.unlink()
    return row


def sensitivity(folder: Path, count: int, workers: int) -> dict[str, float]:
    """Compute Sobol indices of FFR, and return time, memory and the first-order indices."""
    model = load_model(folder / "model.npz", "jax")
    ranges = {"blockage": (0.4, 0.85), "position": (1.8, 2.2), "length": (0.6, 1.2)}
    ranges |= {"amplitude": (min(DATA_FACTORS), max(DATA_FACTORS)), "mean_flow": (1.2, 1.4)}
    samples = 2 ** round(np.log2(count / (len(ranges) + 2)))
    with measured(samples * (len(ranges) + 2), workers) as (_, row):
        found = sobol_indices(model, ranges, ["ffr"], samples=samples)
    return row | found.loc["ffr", "first"].to_dict()


@contextmanager
def clients(workers: int) -> Iterator[Any]:
    """Start a cluster with so many processes, or none."""
    if not workers:
        yield None
        return
    from distributed import Client, LocalCluster

    os.environ["NPROC"] = "1"  # threads of XLA in each worker
    options = {"threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(n_workers=workers, **options) as cluster, Client(cluster) as client:
        yield client


def main() -> None:
    """Run the measurements in processes of their own, and print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--preset", default="physics")
    parser.add_argument("--cases", type=int, nargs="+", default=[100, 1000, 10_000])
    parser.add_argument("--workers", type=int, nargs="+", default=[0])
    parser.add_argument("--here", action="store_true", help="run in this process, print JSON")
    parser.add_argument("--predict", action="store_true", help="predict in place of fitting")
    parser.add_argument("--sensitivity", action="store_true", help="Sobol indices, not a fit")
    options = parser.parse_args()
    folder, preset = options.folder, options.preset
    if options.here:
        size = options.cases[0], options.workers[0]
        if options.predict:
            row = predict(folder, *size)
        elif options.sensitivity:
            row = sensitivity(folder, *size)
        else:
            row = fit(folder, preset, *size)
        print(json.dumps(row))
        return
    create(folder)
    for count, workers in product(options.cases, options.workers):
        command = [sys.executable, __file__, folder, "--preset", preset, "--here"]
        command += ["--cases", count, "--workers", workers, *["--predict"] * options.predict]
        command += ["--sensitivity"] * options.sensitivity
        done = subprocess.run(map(str, command), check=True, stdout=subprocess.PIPE, text=True)
        row = {"workers": workers} | json.loads(done.stdout)
        print("  ".join(f"{name} {value:.3g}" for name, value in row.items()), flush=True)


if __name__ == "__main__":
    main()
