"""Errors over the number of training cases: designed and random subsets, on the paper's split.

    python benchmarks/few_cases.py --sizes 3,4,6,9,12 --draws 20 --preset physics --out few.csv

``--left-out`` evaluates on training cases that are left out (a geometry and a waveform, five
times) in place of the test cases, for choices between methods.
"""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd

from pcnde_bridge import load_cases, plots
from pcnde_bridge.engines.types import ModelInputs
from pcnde_bridge.errors import InputError
from pcnde_bridge.evaluation import ResponseSurface, learning_curve
from pcnde_bridge.evaluation.design import choose
from pcnde_bridge.model.metrics import pooled_errors

POOLS = [(9, 8), (1, 0), (5, 4), (9, 0), (1, 8)]
"""Left-out geometry and waveform of each pool of training cases."""


def pools(left_out):
    """Return pairs of training cases to choose from, and cases to evaluate."""
    train, test = load_cases("published").split("paper")
    if not left_out:
        return {"test cases": (train, test)}
    geometry, waveform = (train.labels[name].to_numpy() for name in ("geometry", "waveform"))
    found = {}
    for g, w in POOLS:
        held = (geometry == g) | (waveform == w)
        found[f"without geometry {g}, waveform {w}"] = train.select(~held), train.select(held)
    return found


def polynomials(train, test, sizes):
    """Return the errors of the best polynomial baseline that the designed cases determine."""
    order = choose(ModelInputs(train.inflow, train.area_undeformed, train.grid), max(sizes))
    rows = {}
    for size in sizes:
        cases = train.select(order["case"].to_numpy()[:size])
        for degree in (3, 2, 1, 0):
            try:
                surface = ResponseSurface(degree, degree).fit(cases)
            except InputError:
                continue
            rows[size, f"degree {degree}"] = pooled_errors(surface.predict(test), test)
            break
    return pd.DataFrame(rows).T


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", default="3,4,6,9,12")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--preset", default="physics")
    parser.add_argument("--left-out", action="store_true")
    parser.add_argument("--out", default="few_cases.csv")
    parser.add_argument("--figure", help="file of the learning curve's figure")
    options = parser.parse_args()
    sizes = [int(size) for size in options.sizes.split(",")]
    tables = {}
    for name, (train, test) in pools(options.left_out).items():
        if options.preset == "polynomial":
            table = polynomials(train, test, sizes)
        else:
            table = learning_curve(train, test, sizes, options.preset, "jax", draws=options.draws)
        tables[name] = table
        pd.concat(tables, names=["cases"]).to_csv(options.out)  # nothing is lost on Ctrl-C
        kind = np.where(table.index.get_level_values(1).str.startswith("random"), "random", "other")
        errors = ["flow", "area", "pressure", "pressure_drop"]
        if options.figure:
            plots.learning_curve(table).savefig(options.figure, dpi=130)
        summary = table[errors].groupby([table.index.get_level_values(0), kind])
        print(name, summary.agg(["median", "max"]).round(4).to_string(), sep="\n", flush=True)


if __name__ == "__main__":
    main()
