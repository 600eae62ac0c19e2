"""Flow stage of the Julia engine against the libraries alone (``engine="julia-reference"``).

Run ``python benchmarks/reference.py [DATA] [--iterations N] [--weights FOLDER]``.  The default
data is that of ``benchmarks/engines.py``; the cases are the first batch of preset ``paper``, and
the parameters those of a new model, or the published weights.  A gradient of the reference takes
seconds to minutes.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from engines import read

from pcnde_bridge import PCNDE
from pcnde_bridge.config import PAPER
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.engines.staged import undeformed
from pcnde_bridge.engines.types import FitData

TIGHT = {"rtol": 1e-12, "atol": 1e-14, "max_steps": 16384}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", nargs="?", help="cases; default: the published data set")
    parser.add_argument("--iterations", type=int, default=0, help="BFGS iterations to compare")
    parser.add_argument("--weights", help="folder of the published weights")
    arguments = parser.parse_args()
    train = read(arguments.data).split("paper").train
    first = np.random.default_rng(0).permutation(train.n_cases)[: PAPER.batch_size]
    cases = train.select(first)
    config = PAPER
    vector = initial_parameters(config, cases.n_times, cases.n_points, seed=0).flow
    if arguments.weights:
        model = PCNDE.from_published_weights(arguments.weights)
        config, vector = model.config, model.parameters.flow
    inputs = cases.inflow, undeformed(cases.area_undeformed, cases.n_times)
    for name, settings in (("paper", {}), ("tight", TIGHT)):
        print(f"tolerances: {name}")
        chosen = config.replace(flow=settings)
        compare("solution", lambda e, c=chosen: e.solve(vector, inputs, cases.grid, c))
        data = FitData(inputs, cases.flow, cases.grid, chosen)
        compare("gradient", lambda e, d=data: e.objective(d, np.ones(len(cases)))(vector)[1])
        if count := arguments.iterations:
            compare("losses of a fit", lambda e, d=data, n=count: e.fit(vector, d, n).losses)


def compare(what, compute) -> None:
    """Print both times and the largest difference relative to the largest value."""
    results, seconds = [], []
    for name in ("julia", "julia-reference"):
        stage = select_engine(name).flow
        compute(stage)  # compiles
        began = time.perf_counter()
        results.append(compute(stage))
        seconds.append(time.perf_counter() - began)
    fast, reference = results
    difference = np.abs(fast - reference).max() / np.abs(reference).max()
    print(
        f"  {what:24} fast {1e3 * seconds[0]:9.3g} ms, reference {1e3 * seconds[1]:9.3g} ms, "
        f"ratio {seconds[1] / seconds[0]:6.3g}, difference {difference:.1e}",
        flush=True,
    )


if __name__ == "__main__":
    main()
