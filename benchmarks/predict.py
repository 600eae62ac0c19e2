"""Time of predicting cases in one call, after compilation.

Run ``python benchmarks/predict.py model.npz [--json FILE]``.  Prints the time of
one call for 1, 10 and 100 of the published cases, its ratio to predicting the
cases one by one, and to the same five stages one after the other, all measured
in turns in this one run.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from typing import Any

from pcnde_bridge import PCNDE, load_cases
from pcnde_bridge.inference import predict_by_stages


def measure(functions: dict[str, Callable[[], Any]], turns: int = 15) -> dict[str, float]:
    """Median seconds of each function, called in turns after a first call that compiles."""
    for function in functions.values():
        function()
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(turns):
        for name, function in functions.items():
            began = time.perf_counter()
            function()
            seconds[name].append(time.perf_counter() - began)
    return {name: statistics.median(values) for name, values in seconds.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model")
    parser.add_argument("--engine", default="jax")
    parser.add_argument("--json")
    options = parser.parse_args()
    model = PCNDE.load(options.model, engine=options.engine)
    cases = load_cases("published")
    rows = []
    for count in (1, 10, 100):
        some = cases.select(slice(0, count))
        singles = [some.select(i) for i in range(count)]
        given = (some.inflow, some.area_undeformed, model.grid, model.config)
        found = measure(
            {
                "one call": lambda some=some: model.predict(some),
                "case by case": lambda singles=singles: [model.predict(case) for case in singles],
                "by stages": lambda given=given: predict_by_stages(
                    model.engine, model.parameters, *given
                ),
            }
        )
        ratios = {f"{name} / one call": found[name] / found["one call"] for name in list(found)[1:]}
        rows.append({"cases": count, "one call (ms)": 1e3 * found["one call"], **ratios})
        print("  ".join(f"{name}: {value:.4g}" for name, value in rows[-1].items()))
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:  # noqa: PTH123
            json.dump({"engine": model.engine.name, "rows": rows}, file, indent=1)


if __name__ == "__main__":
    main()
