"""Errors on left-out training cases: the choice of settings without the test cases.

Run ``python benchmarks/left_out.py [DATA] [--preset fast] [--change JSON] [--folds pairs]
[--seeds 0 1] [--engine jax]``.  Each fold leaves whole geometries and waveforms out of the
training cases of the paper's split, fits the rest and evaluates the left-out cases.  Prints the
relative errors, ×1e-4: the mean of the seeds for each fold, and the mean and root mean square over
the folds.
"""

from __future__ import annotations

import argparse
import json
import warnings

import numpy as np

from pcnde_bridge import PCNDE, PRESETS, load_cases
from pcnde_bridge.model.metrics import ERRORS, pooled_errors

FOLDS = {
    "pairs": [([9], [8]), ([1], [0]), ([4], [5]), ([6], [2])],
    "correction": [
        ([9], [8]),
        ([], [8]),
        ([], [7, 8]),
        ([8, 9], []),
        ([1, 2], []),
        ([4, 5, 6], []),
    ],
}
"""Left-out geometries and waveforms of each fold."""


def main() -> None:
    """Fit every fold with every seed and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", default="published")
    parser.add_argument("--preset", default="fast", choices=sorted(PRESETS))
    parser.add_argument("--change", type=json.loads, default={}, help="settings as JSON")
    parser.add_argument("--folds", default="pairs", choices=sorted(FOLDS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--engine", default="jax")
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # left-out cases lie outside the training data
    config = PRESETS[options.preset].replace(**options.change)
    train = load_cases(options.data).split("paper").train
    table = []
    print(*ERRORS)
    for geometries, waveforms in FOLDS[options.folds]:
        labels = train.labels
        out = (labels["geometry"].isin(geometries) | labels["waveform"].isin(waveforms)).to_numpy()
        retained, left_out = train.select(np.flatnonzero(~out)), train.select(np.flatnonzero(out))
        errors = []
        for seed in options.seeds:
            model = PCNDE.fit(retained, config, engine=options.engine, seed=seed, progress=False)
            found = pooled_errors(model.predict(left_out).variables(), left_out)
            errors.append([1e4 * found.get(name, np.nan) for name in ERRORS])
        table.append(np.mean(errors, axis=0))
        print(f"without geometries {geometries}, waveforms {waveforms}:", table[-1].round(1))
    print("mean:", np.mean(table, axis=0).round(1))
    print("root mean square:", np.sqrt(np.mean(np.square(table), axis=0)).round(1))


if __name__ == "__main__":
    main()
