"""Do 1D simulations and priors help with 3, 4 or 6 cases?  Errors on training cases left out.

    python benchmarks/pretraining.py --preset physics --out pretraining_physics.csv
    python benchmarks/pretraining.py --preset fast --out pretraining_fast.csv

The pools are those of ``few_cases.py --left-out``; each has one designed subset of each size, and
two random ones.  Variants of ``physics`` draw the losses to their start values, or to those of a
fit to 1D simulations: a residual of ``strength`` times the relative change of each parameter is
added to the relative error of the pressure.  Variants of ``fast`` start from a fit to 1D
simulations, or are trained on the cases and as many 1D simulations together.
"""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from itertools import product
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pandas as pd
from few_cases import pools

from pcnde_bridge import PCNDE, PHYSICS, Cases
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.evaluation.design import choose
from pcnde_bridge.hemodynamics import synthetic
from pcnde_bridge.training import closure_fit, staged_training

SIZES, DRAWS, STRENGTHS = (3, 4, 6), 2, (0.01, 0.1)
FIELDS = "flow", "area", "pressure", "area_undeformed"


def drawn_to(center, strength):
    """Return a context in which the losses are drawn to a vector."""
    fit_losses = closure_fit.fit_losses

    def draw(parameters):
        return strength * (parameters / center - 1), strength * np.diag(1 / center)

    def fit(held, *given, **options):
        def problem(weight):
            return held.problem(weight, None, draw)

        return fit_losses(SimpleNamespace(square=held.square, problem=problem), *given, **options)

    return mock.patch.object(closure_fit, "fit_losses", fit)


def joined(cases, others):
    """Return cases and as many others as one data set."""
    rows = np.random.default_rng(0).choice(len(others), len(cases), replace=False)
    parts = cases, others[np.sort(rows)]
    arrays = [np.concatenate([getattr(part, name) for part in parts]) for name in FIELDS]
    return Cases(*arrays, cases.time, cases.z, check=False)


def variants(preset, simulated):
    """Return settings, and by name contexts of a fit and functions that change its cases."""
    unchanged = nullcontext(), lambda cases: cases
    if preset == "fast":
        pretrained = PCNDE.fit(simulated, "fast", "jax", progress=False).parameters
        start = mock.patch.object(staged_training, "initial_parameters", lambda *_: pretrained)
        together = nullcontext(), lambda cases: joined(cases, simulated)
        return "fast", {"none": unchanged, "start": (start, unchanged[1]), "together": together}
    config = PHYSICS.replace(correction={"folds": 0})
    centers = {
        "start": np.array([start for start, *_ in closure_fit._LOSSES.values()]),
        "1D": PCNDE.fit(simulated, config, "jax", progress=False).parameters.losses,
    }
    found = {"none": unchanged}
    for (name, center), strength in product(centers.items(), STRENGTHS):
        found[f"{name}, {strength:g}"] = drawn_to(center, strength), unchanged[1]
    return config, found


def main():
    """Fit all subsets, and print medians and largest errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", default="physics", choices=["physics", "fast"])
    parser.add_argument("--out", default="pretraining.csv")
    options = parser.parse_args()
    config, ways = variants(options.preset, synthetic(progress=False))
    rows = {}
    for (pool, (train, left_out)), size in product(pools(True).items(), SIZES):
        order = choose(ModelInputs(train.inflow, train.area_undeformed, train.grid), size)
        rng = np.random.default_rng(size)
        random = {f"random {n}": rng.permutation(len(train))[:size] for n in range(DRAWS)}
        subsets = {"designed": order["case"].to_numpy(), **random}
        for (subset, positions), (way, (context, change)) in product(subsets.items(), ways.items()):
            cases = change(train.select(np.sort(positions)))
            with context:
                model = PCNDE.fit(cases, config, "jax", progress=False)
            rows[way, size, pool, subset] = model.evaluate(left_out).iloc[-1]
        names = ["variant", "cases", "pool", "subset"]
        table = pd.DataFrame(rows).T.rename_axis(names)
        table.to_csv(options.out)  # nothing is lost on Ctrl-C
        print(pool, size, flush=True)
    errors = table[["flow", "area", "pressure", "pressure_drop"]]
    by = [errors.index.get_level_values(name) for name in ("cases", "variant")]
    for kind in ("designed", "random"):
        of_kind = table.index.get_level_values("subset").str.startswith(kind)
        summary = errors[of_kind].groupby([level[of_kind] for level in by], sort=False)
        print(kind, summary.agg(["median", "max"]).round(4).to_string(), sep="\n")


if __name__ == "__main__":
    main()
