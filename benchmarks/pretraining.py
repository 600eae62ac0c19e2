"""Do 1D simulations and priors help with 3, 4 or 6 cases?  Errors on training cases left out.

    python benchmarks/pretraining.py --preset physics --out pretraining_physics.csv
    python benchmarks/pretraining.py --preset fast --out pretraining_fast.csv

The pools are those of ``few_cases.py --left-out``; each has one designed subset of each size, and
four random ones.  Variants of ``physics`` draw the losses to their start values, to those of theory
(Poiseuille, Bernoulli, a momentum balance and a laminar jet), or to those of a fit to 1D
simulations.  There, 1D simulations are further pools, and the cases outside a subset are left out.
Variants of ``fast`` start from a fit to 1D simulations, or are trained on the cases and as many 1D
simulations together.
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

SIZES, PRIOR, HYPEREMIA = (3, 4, 6), 32.0, 4.0
DRAWS = {"physics": 4, "fast": 2}
THEORY = np.array([1, 1, 1, 1, 4 / 3, 1, 1, 0.01, 3, 1])
FIELDS = "flow", "area", "pressure", "area_undeformed"


def drawn_to(center, prior):
    """Return a context in which few cases draw the losses to a vector.

    The sum of squares of N cases is multiplied by 1 + (prior/N²)²·|ln(losses/center)|².
    """
    fit_losses = closure_fit.fit_losses

    def fit(held, *given, **options):
        def problem(weight):
            strength, plain = prior / np.count_nonzero(weight) ** 2, held.problem(weight)

            def drawn(x):
                error, jacobian = plain(x)
                size, change = np.linalg.norm(error), strength * np.log(x / center)
                slope = size * strength * np.diag(1 / x) + np.outer(change, error @ jacobian / size)
                return np.append(error, size * change), np.concatenate([jacobian, slope])

            return drawn

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
        "theory": THEORY,
        "1D": PCNDE.fit(simulated, config, "jax", progress=False).parameters.losses,
    }
    found = {name: (drawn_to(center, PRIOR), unchanged[1]) for name, center in centers.items()}
    found["none"] = unchanged
    return config, found


def main():
    """Fit all subsets, and print medians and largest errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", default="physics", choices=["physics", "fast"])
    parser.add_argument("--out", default="pretraining.csv")
    options = parser.parse_args()
    simulated = synthetic(progress=False)
    config, ways = variants(options.preset, simulated)
    groups = {"3D": pools(True)}
    if options.preset == "physics":
        hyperemia = synthetic(hyperemia=HYPEREMIA, progress=False)
        groups |= {"1D": {"at rest": (simulated, None)}, "1D, 4 Q": {"flow": (hyperemia, None)}}
    rows = {}
    every = [(group, *pool) for group, members in groups.items() for pool in members.items()]
    for (group, pool, (train, left_out)), size in product(every, SIZES):
        order = choose(ModelInputs(train.inflow, train.area_undeformed, train.grid), size)
        rng, draws = np.random.default_rng(size), DRAWS[options.preset]
        random = {f"random {n}": rng.permutation(len(train))[:size] for n in range(draws)}
        subsets = {"designed": order["case"].to_numpy(), **random}
        for (subset, positions), (way, (context, change)) in product(subsets.items(), ways.items()):
            cases = change(train.select(np.sort(positions)))
            with context:
                model = PCNDE.fit(cases, config, "jax", progress=False)
            others = np.setdiff1d(np.arange(len(train)), positions)
            test = train.select(others) if left_out is None else left_out
            kind = f"{group}, {subset.split()[0]}"
            rows[kind, way, size, pool, subset] = model.evaluate(test).iloc[-1]
        names = ["kind", "variant", "cases", "pool", "subset"]
        table = pd.DataFrame(rows).T.rename_axis(names)
        table.to_csv(options.out)  # nothing is lost on Ctrl-C
        print(pool, size, flush=True)
    errors = table[["flow", "area", "pressure", "pressure_drop"]]
    summary = errors.groupby(["kind", "cases", "variant"], sort=False).agg(["median", "max"])
    print(summary.round(4).to_string())


if __name__ == "__main__":
    main()
