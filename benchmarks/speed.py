"""Time of predicting 1, 100 and 10 000 cases in one call, after compilation.

Run ``python benchmarks/speed.py MODEL [MODEL ...] [--engines jax julia] [--batches 1 100 10000]
[--json FILE]`` with saved models, such as ``pcnde fit published --preset physics --out
physics.npz`` makes them.  All models and engines are measured in turns in this one run.
Prints milliseconds per case, cases per second, and the ratio to the first; the published
cases are repeated, their inflows scaled by up to 1 %, so that no two are the same.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import time
import warnings
from pathlib import Path

import numpy as np

from pcnde_bridge import PCNDE, PCNDEError, load_cases


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", nargs="+")
    parser.add_argument("--engines", nargs="+", default=["jax"])
    parser.add_argument("--batches", nargs="+", type=int, default=[1, 100, 10_000])
    parser.add_argument("--turns", type=int, default=7)
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
                print(f"{name}: left out, {error}")
    cases = load_cases("published")
    rng = np.random.default_rng(0)
    rows = []
    for count in options.batches:
        scale = 1 + 0.01 * rng.uniform(-1, 1, size=(count, 1))
        inflow = scale * np.resize(cases.inflow, (count, cases.n_times))
        area = np.resize(cases.area_undeformed, (count, cases.n_points))
        seconds: dict[str, list[float]] = {name: [] for name in models}
        for turn in range(options.turns + 1):
            for name, model in models.items():
                began = time.perf_counter()
                model.predict(inflow, area)
                if turn:  # the first compiles
                    seconds[name].append(time.perf_counter() - began)
        first = None
        for name, values in seconds.items():
            taken = statistics.median(values)
            first = first or taken
            row = {
                "cases": count,
                "model": name,
                "ms_per_case": 1e3 * taken / count,
                "cases_per_second": count / taken,
                "ratio_to_first": taken / first,
                "peak_mb_so_far": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
            }
            rows.append(row)
            print("  ".join(f"{k} {v:.4g}" if k != "model" else v for k, v in row.items()))
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:  # noqa: PTH123
            json.dump(rows, file, indent=1)


if __name__ == "__main__":
    main()
