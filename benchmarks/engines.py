"""Latency, training time, inference time and memory of both engines.

Run ``python benchmarks/engines.py [DATA]``.  The default data is the published data set if
it is on this machine, otherwise cases of the same size by formula.  Each engine runs in its
own process, one after the other.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

from pcnde_bridge.config import PAPER
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.engines.staged import undeformed
from pcnde_bridge.engines.types import FitData, ModelInputs
from pcnde_bridge.io.datasets import find_published, load_cases

BATCHES = 20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", nargs="?", help="cases; default: the published data set")
    parser.add_argument("--engine", choices=["julia", "jax"], help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.engine:
        print(json.dumps(measure(arguments.engine, read(arguments.data))))
        return
    results = {}
    for engine in ("julia", "jax"):
        command = [sys.executable, __file__, "--engine", engine]
        command += [arguments.data] if arguments.data else []
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"{engine}: {done.stderr.strip().splitlines()[-1]}")
        else:
            results[engine] = json.loads(done.stdout.splitlines()[-1])
    if not results:
        raise SystemExit("no engine is available")
    rows = list(next(iter(results.values())))
    both = len(results) == 2
    heads = [*results, "julia/jax"] if both else list(results)
    print(f"{'':48}" + "".join(f"{head:>12}" for head in heads))
    for row in rows:
        values = [result[row] for result in results.values()]
        ratio = f"{values[0] / values[1]:12.2f}" if both else ""
        print(f"{row:48}" + "".join(f"{value:12.4g}" for value in values) + ratio)


def read(data: str | None) -> Cases:
    if data is None and find_published() is None:
        return cases_by_formula()
    return load_cases(data or find_published())


def cases_by_formula() -> Cases:
    """Create one hundred cases of the published size."""
    time_, z = np.arange(100) / 100, np.linspace(0, 4, 101)
    geometry, waveform = (a.ravel() for a in np.meshgrid(range(1, 11), range(10), indexing="ij"))
    bump = np.exp(-(((z - 2) / 0.25) ** 2))
    area_undeformed = 0.125 * (1 - 0.05 * geometry[:, None] * bump)
    oscillation = 0.2 * np.cos(2 * np.pi * time_) + 0.1 * np.sin(4 * np.pi * time_ + 1)
    inflow = 1.2 + 0.3 * waveform[:, None] * oscillation
    flow = inflow[:, :, None] * (1 - 0.02 * z / 4 * np.cos(2 * np.pi * time_)[:, None])
    pressure = 1.09e5 * flow[:, :, -1:] + 2e3 * geometry[:, None, None] * flow * (z < 2)
    area = area_undeformed[:, None] * (1 + pressure / 4.9e6) ** 2
    more = {"labels": {"geometry": geometry, "waveform": waveform}, "units": "cgs,area=cm^2"}
    return Cases(flow, area, pressure, area_undeformed, time_, z, period=1.0, **more)


def measure(name: str, cases: Cases) -> dict[str, float]:
    """Measure one engine in this new process; return seconds, milliseconds and megabytes."""
    results = {}
    started = time.perf_counter()
    engine = select_engine(name)
    results["start of the engine, s"] = time.perf_counter() - started

    train = cases.split("paper").train
    grid = train.grid
    first = initial_parameters(PAPER, train.n_times, train.n_points, seed=0)
    area = undeformed(train.area_undeformed, train.n_times)
    order = np.random.default_rng(0).permutation(train.n_cases)
    batches = [order[i : i + PAPER.batch_size] for i in range(0, train.n_cases, PAPER.batch_size)]

    vector = first.flow
    seconds, iterations = [], 0
    for number in range(BATCHES):
        batch = batches[number % len(batches)]
        began = time.perf_counter()
        inputs = train.inflow[batch], area[batch]
        data = FitData(inputs, train.flow[batch], grid, PAPER)
        fit = engine.flow.fit(vector, data, PAPER.flow.iterations)
        seconds.append(time.perf_counter() - began)
        vector = fit.parameters
        iterations = len(fit.losses) - 1
    results["first batch of the flow stage, s"] = seconds[0]
    results["flow, BFGS iteration on 12 cases, ms"] = 1e3 * np.median(seconds) / iterations
    parameters = first.replace(flow=vector)

    flow = engine.flow.solve(vector, (train.inflow, area), grid, PAPER)
    batch = batches[0]
    pressure = train.pressure / PAPER.physics.reference_pressure
    fits = {
        "intermediate_area": (
            (flow[batch], train.area_undeformed[batch]),
            train.area[batch],
        ),
        "fourier_area": (
            (flow[batch], train.area_undeformed[batch]),
            train.area[batch],
        ),
        "temporal_pressure": (
            (flow, train.area, train.area_undeformed),
            pressure,
        ),
        "spatial_pressure": (
            (pressure, flow, train.area_undeformed),
            pressure,
        ),
    }
    for stage, (inputs, target) in fits.items():

        def fit_stage(stage=stage, inputs=inputs, target=target) -> int:
            start = getattr(parameters, stage)
            fit = getattr(engine, stage).fit(start, FitData(inputs, target, grid, PAPER), 5)
            return max(len(fit.losses) - 1, 1)

        taken, count = timed(fit_stage)
        results[f"{stage}, BFGS iteration, ms"] = 1e3 * taken / count

    def infer(count: int) -> Callable[[], None]:
        subset = train.select(slice(0, count))

        def run() -> None:
            engine.predict(
                parameters, ModelInputs(subset.inflow, subset.area_undeformed, grid), PAPER
            )

        return run

    began = time.perf_counter()
    infer(train.n_cases)()
    results["first inference, 81 cases, s"] = time.perf_counter() - began
    results["inference, 1 case alone, ms"] = 1e3 * timed(infer(1))[0]
    results["inference, per case of 81, ms"] = 1e3 * timed(infer(train.n_cases))[0] / train.n_cases
    # Linux counts kilobytes, macOS bytes.
    unit = 1e6 if sys.platform == "darwin" else 1e3
    results["peak memory, MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
    return {key: float(value) for key, value in results.items()}


def timed(run: Callable[[], object]) -> tuple[float, object]:
    """Return the median seconds of five runs after a first one, and the last result."""
    run()
    seconds = []
    for _ in range(5):
        began = time.perf_counter()
        result = run()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds)), result


if __name__ == "__main__":
    main()
