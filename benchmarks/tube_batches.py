"""Time of the 1D solver for each case of a batch, and compilations for new walls.

Run ``python benchmarks/tube_batches.py [--cases N] [--repeats N]``.  Batches of one and of many
cases are timed in turns; their ratio does not depend on the load of the machine as much as the
times do.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from pcnde_bridge.hemodynamics import LinearWall, Stenosis, Tube1D, Vessel, Windkessel, coronary

OUTLET = Windkessel(109_236.9)


def seconds(n_cases: int, wall: LinearWall) -> float:
    """Return the time of a cycle for each case on the default grid, s."""
    blockages = np.linspace(0.4, 0.85, n_cases).tolist()
    vessels = [Vessel((Stenosis(blockage),)) for blockage in blockages]
    waveforms = coronary().family(np.linspace(-0.5, 1.75, n_cases).tolist())
    start = time.perf_counter()
    Tube1D(wall, cycles=1).solve(vessels, waveforms, OUTLET)
    return (time.perf_counter() - start) / n_cases


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", type=int, default=100, help="size of the large batch")
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args()
    sizes = 1, given.cases
    for size in sizes:
        seconds(size, LinearWall())  # compiles
    times = np.array([[seconds(n, LinearWall()) for n in sizes] for _ in range(given.repeats)])
    one, many = 1e3 * np.median(times, axis=0)
    ratio = np.median(times[:, 1] / times[:, 0])
    print(f"{one:.1f} ms a case alone, {many:.1f} ms in a batch of {given.cases}: {ratio:.2f}")

    from pcnde_bridge.hemodynamics import tr_bdf2

    before = tr_bdf2.cycle._cache_size()
    for modulus in np.linspace(1e7, 2e7, 20).tolist():
        seconds(1, LinearWall(modulus))
    print(f"20 stiffnesses: {tr_bdf2.cycle._cache_size() - before} new compilations")


if __name__ == "__main__":
    main()
