"""Errors of preset ``physics`` on other time grids, vessels and waveforms.

Run ``python benchmarks/generalize.py [--engine jax] [--json FILE]``.  Trains once on the
published cases, if they are found, and once on the synthetic ones.  Prints relative errors
‖Y − Y_GT‖/‖Y_GT‖ of flow, area and pressure

- for the published test cases, predicted from 100, 50 and 200 time points of the same
  waveforms, and compared at the common time points;
- for vessels whose stenosis is moved, doubled or absent, and for another waveform, all
  computed by the package's own 1D solver.
"""

from __future__ import annotations

import argparse
import json
import warnings
from typing import Any

import numpy as np
from scipy.signal import resample

from pcnde_bridge import (
    PCNDE,
    Cases,
    DataNotFoundError,
    load_cases,
)
from pcnde_bridge.hemodynamics import synthetic
from pcnde_bridge.model import pooled_errors


def errors_on_grid(model: PCNDE, cases: Cases, count: int) -> dict[str, float]:
    """Return errors of a prediction from ``count`` time points, at the common time points."""
    inflow = resample(cases.inflow, count, axis=1)
    predicted = model.predict(inflow, cases.area_undeformed, z=cases.z, period=cases.period)
    cases_step, predicted_step = max(cases.n_times // count, 1), max(count // cases.n_times, 1)
    shared = {name: values[:, ::predicted_step] for name, values in predicted.variables().items()}
    truth = Cases(
        *(getattr(cases, name)[:, ::cases_step] for name in ("flow", "area", "pressure")),
        cases.area_undeformed,
        cases.time[::cases_step],
        cases.z,
        period=cases.period,
        labels=cases.labels,
    )
    return pooled_errors(shared, truth)


def main() -> None:
    """Train, predict, and print the errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--engine", default="jax")
    parser.add_argument("--json")
    options = parser.parse_args()
    # All inputs are outside the training data, and the model would warn each time.
    warnings.simplefilter("ignore")
    found: dict[str, Any] = {}

    def show(name: str, errors: dict[str, float]) -> None:
        found[name] = errors
        values = "  ".join(f"{variable} {error:.5f}" for variable, error in errors.items())
        print(f"{name:44} {values}", flush=True)

    try:
        train, test = load_cases("published").split("paper")
    except DataNotFoundError as error:
        print(error)
    else:
        model = PCNDE.fit(train, config="physics", engine=options.engine, progress=False)
        for count in (100, 50, 200):
            show(f"published, test, {count} time points", errors_on_grid(model, test, count))
    train, test = load_cases("synthetic").split("paper")
    model = PCNDE.fit(train, config="physics", engine=options.engine, progress=False)
    others = {
        "train": train,
        "test": test,
        "stenosis at 1.2 cm": synthetic(4, 4, stenosis_positions=(1.2,)),
        "stenoses at 1.2 and 2.8 cm": synthetic(4, 4, stenosis_positions=(1.2, 2.8)),
        "no stenosis": synthetic(1, 4, stenosis_positions=()),
        "another waveform": synthetic(4, 4, seed=1),
    }
    for name, cases in others.items():
        errors = pooled_errors(model.predict(cases).variables(), cases)
        show(f"synthetic, {name}", errors)
        unchanged = np.linalg.norm(cases.flow - cases.flow[:, :, :1]) / np.linalg.norm(cases.flow)
        print(f"{'':44} (baseline Q = Q_in, no change along the vessel: {unchanged:.5f})")
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:  # noqa: PTH123
            json.dump(found, file, indent=1)


if __name__ == "__main__":
    main()
