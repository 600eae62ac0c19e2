"""Errors, training time and memory of the presets and of simpler methods, over several seeds.

Run ``python benchmarks/accuracy.py [DATA] [--presets fast physics] [--engines jax]
[--seeds 0 1 2 3 4] [--splits paper] [--json FILE]``.  Every fit runs in its own process, so
that its time includes all compilation and its memory is measured separately.  Prints the
median and the worst of the seeds for each split and preset, and the errors of the simpler
methods; the polynomial is the best one on the test cases of all degrees up to 3.

Splits: ``paper``; ``transposed`` tests on the first geometry and the first waveform;
``random`` on a random half, chosen by each seed; ``designed-6`` is ``paper`` with only the six
training cases that ``pcnde design`` chooses.  All test cases of the paper's split are the
outermost ones.  Presets with intervals: shares of values in their 90 % intervals.
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
from scipy import stats

from pcnde_bridge import (
    PCNDE,
    Cases,
    InputError,
    Prediction,
    Split,
    load_cases,
)
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.evaluation.baselines import (
    FEM_WALL,
    DropRegression,
    ResponseSurface,
    Solver1D,
    StenosisLoss,
    Unchanged,
    itu,
    mirramezani,
    young_tsai,
)
from pcnde_bridge.evaluation.design import choose
from pcnde_bridge.model.metrics import coverage, pooled_errors


def split_cases(cases: Cases, split: str, seed: int) -> Split:
    """Split the cases into training and test cases."""
    if split == "transposed":
        labels = cases.labels[["geometry", "waveform"]]
        test = (labels == labels.min()).any(axis=1).to_numpy()
        return Split(cases[~test], cases[test])
    if split.startswith("designed-"):
        train, test = cases.split("paper")
        inputs = ModelInputs(train.inflow, train.area_undeformed, train.grid)
        return Split(train[choose(inputs, int(split[9:]))["case"].to_numpy()], test)
    return cases.split(0.5, seed=seed) if split == "random" else cases.split(split)


def fit_and_measure(data: str, split: str, preset: str, engine: str, seed: int) -> dict[str, Any]:
    """Fit one model in this process; return all errors, seconds and the peak memory."""
    warnings.simplefilter("ignore")
    train, test = split_cases(load_cases(data), split, seed)
    began = time.perf_counter()
    model = PCNDE.fit(train, config=preset, engine=engine, seed=seed, progress=False)
    seconds = time.perf_counter() - began
    result: dict[str, Any] = {
        "split": split,
        "preset": preset,
        "requested": engine,
        "engine": model.engine.name,
        "seed": seed,
        "seconds": seconds,
        "train": pooled_errors(model.predict(train).variables(), train),
        "test": pooled_errors(model.predict(test).variables(), test),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }
    if model.uncertainty is not None:
        for subset, cases in (("train", train), ("test", test)):
            found = coverages(model.predict(cases, samples=64), cases)
            result[subset] |= {f"{name} covered": share for name, share in found.items()}
    return result


def coverages(prediction: Prediction, cases: Cases) -> dict[str, float]:
    """Return the shares of values, drops and indices that lie in their 90 % intervals."""
    found = coverage(prediction.interval(0.9), cases)
    samples = np.stack([sample.pressure_drop() for sample in prediction.each_sample()])
    width = stats.t.ppf(0.95, len(samples) - 1) * samples.std(axis=0, ddof=1)
    error = np.abs(prediction.pressure_drop() - cases.pressure_drop())
    found["pressure_drop"] = float((error <= width).mean())
    table, truth = prediction.indices(), cases.indices()
    for name in ("ffr", "mean_drop_mmHg", "peak_drop_mmHg", "peak_wss"):
        found[name] = truth[name].between(table[f"{name}_low"], table[f"{name}_high"]).mean()
    return found


def measure_baselines(data: str, split: str, seed: int) -> dict[str, dict[str, dict[str, float]]]:
    """Return the errors of the baselines."""
    sets = split_cases(load_cases(data), split, seed)
    found = {}
    methods: dict[str, Any] = {
        "no change": Unchanged(),
        "1D solver": Solver1D(FEM_WALL),
        "Seeley-Young": StenosisLoss(),
        "Young-Tsai": StenosisLoss(young_tsai),
        "Mirramezani": StenosisLoss(mirramezani),
        "Itu": StenosisLoss(itu),
        "drop regression": DropRegression(),
    }
    for name, method in methods.items():
        try:
            method.fit(sets.train)
        except InputError as error:
            print(f"{name}: {error}", flush=True)
            continue
        found[name] = {
            subset: pooled_errors(method.predict(cases), cases)
            for subset, cases in sets._asdict().items()
        }
    best: dict[str, float] = {}
    for degrees in product(range(1, 4), repeat=2):
        try:
            surface = ResponseSurface(*degrees).fit(sets.train)
        except InputError:
            continue
        errors = pooled_errors(surface.predict(sets.test), sets.test)
        best = {name: min(best.get(name, np.inf), error) for name, error in errors.items()}
    found["best polynomial"] = {"test": best}
    return found


def summarize(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return median and maximum over the seeds."""
    rows = {
        f"{subset} {v}": [r[subset][v] for r in results]
        for subset in ("train", "test")
        for v in results[0][subset]
    }
    rows |= {name: [r[name] for r in results] for name in ("seconds", "peak_mb")}
    return {name: (statistics.median(values), max(values)) for name, values in rows.items()}


def main() -> None:
    """Fit all models, print the table, and write the JSON file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", default="published")
    parser.add_argument("--presets", nargs="+", default=["fast", "physics"])
    parser.add_argument("--engines", nargs="+", default=["jax"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2, 3, 4])
    parser.add_argument("--splits", nargs="+", default=["paper"])
    parser.add_argument("--json")
    options = parser.parse_args()
    results: list[dict[str, Any]] = []
    baselines: dict[str, Any] = {}
    spawn = multiprocessing.get_context("spawn")
    for split in options.splits:
        for preset, engine in product(options.presets, options.engines):
            for seed in options.seeds:
                # Every fit runs in a new process.
                with ProcessPoolExecutor(1, mp_context=spawn) as pool:
                    args = options.data, split, preset, engine, seed
                    results.append(pool.submit(fit_and_measure, *args).result())
            key = (split, preset, engine)
            mine = [r for r in results if (r["split"], r["preset"], r["requested"]) == key]
            print(f"{split}: {preset} ({engine}), {len(mine)} seeds, median (worst)")
            for name, (median, worst) in summarize(mine).items():
                print(f"  {name:20} {median:.5g} ({worst:.5g})", flush=True)
        seeds = options.seeds if split == "random" else options.seeds[:1]
        baselines[split] = {seed: measure_baselines(options.data, split, seed) for seed in seeds}
        for seed, methods in baselines[split].items():
            for name, errors in methods.items():
                values = "  ".join(f"{v} {error:.5f}" for v, error in errors["test"].items())
                print(f"{split}, seed {seed}: {name}: test {values}", flush=True)
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:  # noqa: PTH123
            json.dump(
                {"data": options.data, "fits": results, "baselines": baselines}, file, indent=1
            )


if __name__ == "__main__":
    main()
