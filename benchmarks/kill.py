"""Resumption of fits that are killed at random moments.

Run ``python benchmarks/kill.py [--presets fast paper physics] [--times 20] [--seed 0]
[--engine jax]``.  The engine ``toy`` is the numpy engine of the tests, for a busy machine.
For each preset, with small settings and synthetic cases:

1. a fit runs without interruption in its own process;
2. the same fit is killed (SIGKILL) at random moments.  After each kill every checkpoint
   file must be readable; then the run is started again;
3. the last run ends undisturbed; its parameters must equal the first ones bit for bit.

There are ``--times`` kills in all: a run that finishes too early starts again from the
beginning.  The exit code is 1 if a file was unreadable or a result differed.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from pcnde_bridge import (
    FAST,
    PAPER,
    PCNDE,
    PHYSICS,
    ClosureConfig,
    PCNDEConfig,
)
from pcnde_bridge.errors import PCNDEError
from pcnde_bridge.hemodynamics.synthetic import synthetic
from pcnde_bridge.model.describe import describe
from pcnde_bridge.training.checkpoint import previous, remove

SMALL: dict[str, PCNDEConfig | ClosureConfig] = {
    "fast": FAST.replace(
        full_batch={"iterations": 20, "later_iterations": 10, "pressure_iterations": 10}
    ),
    "paper": PAPER.replace(
        flow={"epochs": 20, "couple_every": 10},
        temporal_pressure={"iterations": 20},
        spatial_pressure={"iterations": 10},
    ),
    "physics": PHYSICS.replace(correction={"evaluations": 15}),
}

TESTS = Path(__file__).parents[1] / "tests"

FIT = """
import sys, time
from pcnde_bridge import PCNDE, Cases, ClosureConfig, PCNDEConfig
folder, kind, engine, checkpoint, out, tests = sys.argv[1:]
progress = False
if engine == "toy":
    sys.path.insert(0, tests)
    from helpers import ToyEngine
    engine, progress = ToyEngine(), lambda record: time.sleep(0.01)
read = {"ClosureConfig": ClosureConfig, "PCNDEConfig": PCNDEConfig}[kind].from_json
config = read(open(folder + "/config.json").read())
cases = Cases.load(folder + "/cases.npz")
PCNDE.fit(cases, config, engine, checkpoint=checkpoint, progress=progress).save(out)
"""


def main() -> None:
    """Kill the fits, check their files, resume them, and compare the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", nargs="+", default=["fast", "paper"], choices=SMALL)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="random seed for the moments")
    parser.add_argument("--engine", default="jax")
    options = parser.parse_args()
    rng = random.Random(options.seed)
    cases = synthetic(3, 4, n_points=41)
    failures = 0
    for preset in options.presets:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            cases.save(folder / "cases.npz")
            config = SMALL[preset]
            (folder / "config.json").write_text(config.to_json(), encoding="utf-8")
            failures += kill(
                folder, type(config).__name__, preset, options.times, options.engine, rng
            )
    sys.exit(1 if failures else 0)


def kill(folder: Path, kind: str, preset: str, times: int, engine: str, rng: random.Random) -> int:
    """Return the number of unreadable files and different results."""
    checkpoint, out = folder / "run.checkpoint", folder / "model.npz"

    def start(checkpoint: Path, out: Path) -> subprocess.Popen[bytes]:
        arguments = [str(folder), kind, engine, str(checkpoint), str(out), str(TESTS)]
        # Compiled code is cached, so that more kills happen during training.
        cache = {
            "JAX_COMPILATION_CACHE_DIR": str(folder / "compiled"),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        }
        return subprocess.Popen(
            [sys.executable, "-c", FIT, *arguments], env={**os.environ, **cache}
        )

    for _ in range(2):  # the first compiles
        began = time.monotonic()
        remove(folder / "reference.checkpoint")
        if start(folder / "reference.checkpoint", folder / "reference.npz").wait():
            sys.exit("The fit without interruption failed.")
        seconds = time.monotonic() - began
    reference = PCNDE.load(folder / "reference.npz", engine="jax")
    print(f"{preset}: {seconds:.0f} s without interruption", flush=True)
    kills, unreadable, different, finished = 0, 0, 0, 0
    while True:
        process = start(checkpoint, out)
        try:
            process.wait(rng.uniform(0, seconds) if kills < times else None)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
            kills += 1
            at = "nothing"
            for path in (checkpoint, previous(checkpoint)):
                if path.exists():
                    try:
                        state = describe(path)
                    except PCNDEError as error:
                        unreadable += 1
                        print(error)
                    else:
                        at = (
                            f"{state['finished']} of {state['steps']}" if path == checkpoint else at
                        )
            print(f"{preset}: kill {kills}, {at} finished", flush=True)
            continue
        if process.returncode:
            sys.exit("A resumed fit failed.")
        finished += 1
        found = dict(PCNDE.load(out, engine="jax").parameters)
        if not all(np.array_equal(found[name], vector) for name, vector in reference.parameters):
            different += 1
        if kills >= times:
            break
        remove(checkpoint)
    print(
        f"{preset}: {kills} kills, {finished} completed runs, {different} with a different result, "
        f"{unreadable} unreadable files, {len(list(folder.glob('.*')))} temporary files remain",
        flush=True,
    )
    return unreadable + different


if __name__ == "__main__":
    main()
