"""Time of independent fits with different numbers of worker processes.

Run ``python benchmarks/scaling.py [DATA] [--preset fast] [--fits 4] [--workers 1 2] [--turns 3]
[--executor processes] [--json FILE]``; ``dask`` is a local cluster.  Every worker has one thread
of XLA, so that one worker does not use the cores of another.  The same seeds are fitted with
each number of workers, in turns; workers are started and have compiled before the measurement.
Prints the median seconds, the ratio to the first, and whether all parameters equal those of the
first run bit for bit.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np

from pcnde_bridge import load_cases
from pcnde_bridge._utils.parallel import run
from pcnde_bridge.config import resolve_config
from pcnde_bridge.model.fit_task import FitTask, fit_model


@contextlib.contextmanager
def started(kind: str, workers: int) -> Iterator[Executor]:
    """Start workers of one XLA thread each."""
    os.environ["NPROC"] = "1"
    if kind == "processes":
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            yield pool
        return
    from dask.distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        yield client.get_executor()


def main() -> None:
    """Measure the times and print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", default="published")
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--config", default="{}", help="changes of the preset, as JSON")
    parser.add_argument("--fits", type=int, default=4)
    parser.add_argument("--workers", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--executor", default="processes", choices=["processes", "dask"])
    parser.add_argument("--json")
    options = parser.parse_args()
    train = load_cases(options.data).split("paper").train
    config = resolve_config(options.preset).replace(**json.loads(options.config))
    tasks = {f"seed {k}": FitTask(train, config, "jax", k) for k in range(options.fits)}

    def fit_all(executor: Executor) -> dict[str, dict[str, Any]]:
        return run(fit_model, tasks, executor=executor, progress=False).check()

    rows = []
    with contextlib.ExitStack() as stack:
        pools = {n: stack.enter_context(started(options.executor, n)) for n in options.workers}
        seconds: dict[int, list[float]] = {workers: [] for workers in pools}
        equal: dict[int, bool] = dict.fromkeys(pools, True)
        first: dict[str, dict[str, Any]] = {}
        for turn in range(options.turns + 1):
            for workers, pool in pools.items():
                began = time.perf_counter()
                results = fit_all(pool)
                if turn:  # the first compiles
                    seconds[workers].append(time.perf_counter() - began)
                first = first or results
                equal[workers] &= identical(results, first)
        base = statistics.median(next(iter(seconds.values())))
        for workers, values in seconds.items():
            taken = statistics.median(values)
            row = {
                "workers": workers,
                "fits": options.fits,
                "seconds": taken,
                "ratio": base / taken,
                "identical": equal[workers],
                "load": os.getloadavg()[0],
            }
            rows.append(row)
            print(
                "  ".join(
                    f"{k} {v:.3g}" if k in ("seconds", "ratio") else f"{k} {v}"
                    for k, v in row.items()
                )
            )
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:  # noqa: PTH123
            json.dump(rows, file, indent=1)


def identical(results: dict[str, dict[str, Any]], others: dict[str, dict[str, Any]]) -> bool:
    """Return whether all results are equal, except the history, which contains times."""
    compare: Callable[[Any, Any], bool] = np.array_equal
    return all(
        compare(value, others[name][key])
        for name, result in results.items()
        for key, value in result.items()
        if key not in ("facts", "history")
    )


if __name__ == "__main__":
    main()
