"""Time of predicting 1, 100 and 10 000 cases after compilation, in one call and streamed.

Run ``python benchmarks/speed.py MODEL [MODEL ...] [--engines jax julia] [--batches 1 100 10000]
[--json FILE]`` with saved models, such as those of ``pcnde fit published --preset physics --out
physics.npz``.  All models and engines are measured in turns in one run, each first streamed
(``predict_batches``), then in one call (``predict``).  Prints milliseconds per case (median and
best turn), cases per second, the ratio to the first, the largest growth of the process's memory
so far, and the load of the machine before and after.  The published cases are repeated with
inflows scaled by up to 1 %, so that all are different; a single case has another waveform in
every turn.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import time
import warnings
from pathlib import Path

import numpy as np

from pcnde_bridge import (
    PCNDE,
    PCNDEError,
    load_cases,
)


def main() -> None:
    """Measure the times and print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", nargs="+")
    parser.add_argument("--engines", nargs="+", default=["jax"])
    parser.add_argument("--batches", nargs="+", type=int, default=[1, 100, 10_000])
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--of-one", type=int, default=300, help="turns with a single case")
    parser.add_argument("--json")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    models = {}
    for path in options.models:
        for engine in options.engines:
            name = f"{Path(path).stem} ({engine})"
            try:
                models[name] = PCNDE.load(path, engine=engine)
            except PCNDEError as error:
                print(f"{name}: skipped, {error}")
    cases = load_cases("published")
    rng = np.random.default_rng(0)
    rows = []
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    start = _peak_mb()
    # Streamed first: the peak memory of a process never decreases.
    runs = [("streamed", max(options.batches))] if max(options.batches) > 1 else []
    runs += [("in one call", count) for count in options.batches]
    for mode, count in runs:
        scale = 1 + 0.01 * rng.uniform(-1, 1, size=(count, 1))
        inflow = scale * np.resize(cases.inflow, (count, cases.n_times))
        area = np.resize(cases.area_undeformed, (count, cases.n_points))
        seconds: dict[str, list[float]] = {name: [] for name in models}
        for turn in range((options.of_one if count == 1 else options.turns) + 1):
            if count == 1:
                inflow = cases.inflow[[turn % len(cases)]] * scale
            for name, model in models.items():
                began = time.perf_counter()
                if mode == "streamed":
                    for _ in model.predict_batches(inflow, area):
                        pass
                else:
                    model.predict(inflow, area)
                if turn:  # the first compiles
                    seconds[name].append(time.perf_counter() - began)
        first = None
        for name, values in seconds.items():
            taken = statistics.median(values)
            first = first or taken
            row = {
                "cases": count,
                "mode": mode,
                "model": name,
                "ms_per_case": 1e3 * taken / count,
                "best_ms_per_case": 1e3 * min(values) / count,
                "cases_per_second": count / taken,
                "ratio_to_first": taken / first,
                "grown_mb_so_far": _peak_mb() - start,
            }
            rows.append(row)
            print("  ".join(v if isinstance(v, str) else f"{k} {v:.4g}" for k, v in row.items()))
    print(f"load {os.getloadavg()[0]:.1f}")
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:  # noqa: PTH123
            json.dump(rows, file, indent=1)


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


if __name__ == "__main__":
    main()
