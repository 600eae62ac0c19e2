"""Errors, training time and memory of the presets and of simpler methods, over seeds.

Run ``python benchmarks/accuracy.py [DATA] [--presets fast physics] [--engines jax]
[--seeds 0 1 2 3 4] [--splits paper] [--json FILE]``.  Every fit is made in a process of
its own, so that its time has all compilation in it and its memory is its own.  Prints,
for each split and preset, the median and the worst of the seeds, and the simpler methods
below: the polynomial is the best on the test cases of all degrees up to 3.

Splits: ``paper``; ``transposed`` tests on the first geometry and the first waveform;
``random`` on a random half, drawn by each seed.  All test cases of the paper's split are
the outermost ones.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import statistics
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from typing import Any

import numpy as np

from pcnde_bridge import (
    PCNDE,
    Cases,
    InputError,
    Split,
    load_cases,
)
from pcnde_bridge.evaluation.baselines import (
    FEM_WALL,
    ResponseSurface,
    Solver1D,
    Unchanged,
)
from pcnde_bridge.model.metrics import coverage, pooled_errors

VARIABLES = ("flow", "area", "pressure")


def split_of(cases: Cases, how: str, seed: int) -> Split:
    """Divide the cases."""
    if how == "paper":
        return cases.split("paper")
    labels = cases.labels[["geometry", "waveform"]]
    if how == "transposed":
        test = ((labels == labels.min()).any(axis=1)).to_numpy()
    else:
        test = np.zeros(len(cases), dtype=bool)
        test[np.random.default_rng(seed).permutation(len(cases))[: len(cases) // 2]] = True
    return Split(cases.select(np.flatnonzero(~test)), cases.select(np.flatnonzero(test)))


def fit_and_measure(data: str, how: str, preset: str, engine: str, seed: int) -> dict[str, Any]:
    """Fit one model in this process; all errors, seconds and the largest memory."""
    warnings.simplefilter("ignore")
    train, test = split_of(load_cases(data), how, seed)
    began = time.perf_counter()
    model = PCNDE.fit(train, config=preset, engine=engine, seed=seed, progress=False)
    seconds = time.perf_counter() - began
    result: dict[str, Any] = {
        "split": how,
        "preset": preset,
        "asked": engine,
        "engine": model.engine.name,
        "seed": seed,
        "seconds": seconds,
        "train": pooled_errors(model.predict(train).variables(), train),
        "test": pooled_errors(model.predict(test).variables(), test),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }
    if model.uncertainty is not None:
        result["coverage"] = coverage(model.predict(test, samples=64).interval(0.9), test)
    return result


def simpler(data: str, how: str, seed: int) -> dict[str, dict[str, dict[str, float]]]:
    """Errors of the methods to compare with."""
    sets = split_of(load_cases(data), how, seed)
    found = {}
    methods: dict[str, Any] = {"no change": Unchanged(), "1D solver": Solver1D(FEM_WALL)}
    for name, method in methods.items():
        method.fit(sets.train)
        found[name] = {
            part: pooled_errors(method.predict(cases), cases)
            for part, cases in sets._asdict().items()
        }
    best: dict[str, float] = dict.fromkeys(VARIABLES, np.inf)
    for degrees in product(range(1, 4), repeat=2):
        try:
            surface = ResponseSurface(*degrees).fit(sets.train)
        except InputError:
            continue
        errors = pooled_errors(surface.predict(sets.test), sets.test)
        best = {name: min(best[name], errors[name]) for name in VARIABLES}
    found["best polynomial"] = {"test": best}
    return found


def summary(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Median and worst over the seeds."""
    rows = {
        f"{part} {v}": [r[part][v] for r in results]
        for part in ("train", "test")
        for v in VARIABLES
    }
    rows |= {name: [r[name] for r in results] for name in ("seconds", "peak_mb")}
    if "coverage" in results[0]:
        rows |= {f"coverage {v}": [r["coverage"][v] for r in results] for v in VARIABLES}
    return {name: (statistics.median(values), max(values)) for name, values in rows.items()}


def main() -> None:
    """Fit all, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", default="published")
    parser.add_argument("--presets", nargs="+", default=["fast", "physics"])
    parser.add_argument("--engines", nargs="+", default=["jax"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2, 3, 4])
    parser.add_argument("--splits", nargs="+", default=["paper"])
    parser.add_argument("--json")
    options = parser.parse_args()
    results: list[dict[str, Any]] = []
    rivals: dict[str, Any] = {}
    spawn = multiprocessing.get_context("spawn")
    for how in options.splits:
        for preset, engine in product(options.presets, options.engines):
            for seed in options.seeds:
                # A new process for every fit.
                with ProcessPoolExecutor(1, mp_context=spawn) as pool:
                    args = options.data, how, preset, engine, seed
                    results.append(pool.submit(fit_and_measure, *args).result())
            key = (how, preset, engine)
            mine = [r for r in results if (r["split"], r["preset"], r["asked"]) == key]
            print(f"{how}: {preset} ({engine}), {len(mine)} seeds, median (worst)")
            for name, (median, worst) in summary(mine).items():
                print(f"  {name:18} {median:.5g} ({worst:.5g})", flush=True)
        seeds = options.seeds if how == "random" else options.seeds[:1]
        rivals[how] = {seed: simpler(options.data, how, seed) for seed in seeds}
        for seed, methods in rivals[how].items():
            for name, errors in methods.items():
                values = "  ".join(f"{v} {errors['test'][v]:.5f}" for v in VARIABLES)
                print(f"{how}, seed {seed}: {name}: test {values}", flush=True)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:  # noqa: PTH123
            json.dump({"data": options.data, "fits": results, "simpler": rivals}, file, indent=1)


if __name__ == "__main__":
    main()
