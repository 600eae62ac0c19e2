"""A fit that is killed again and again: what is left on the disk, and what comes of it.

Run ``python benchmarks/kill.py [--presets fast paper physics] [--times 20] [--seed 0]
[--engine jax]``.  The engine ``toy`` is that of the tests, all in numpy, for a busy machine.
For each preset, in little, on synthetic cases:

1. a fit without interruption, in a process of its own;
2. the same fit, killed (SIGKILL) at random moments ``--times`` times.  After each kill
   every checkpoint file must be whole; then the run is started again;
3. the last run ends undisturbed, and its parameters must be those of the first, bit for bit.

Runs are killed ``--times`` times in all: one that was finished too early begins again from
nothing.  Exits with 1 if a file was unreadable or a result differed.
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

LITTLE: dict[str, PCNDEConfig | ClosureConfig] = {
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
    from conftest import ToyEngine
    engine, progress = ToyEngine(), lambda record: time.sleep(0.01)
read = {"ClosureConfig": ClosureConfig, "PCNDEConfig": PCNDEConfig}[kind].from_json
config = read(open(folder + "/config.json").read())
cases = Cases.load(folder + "/cases.npz")
PCNDE.fit(cases, config, engine, checkpoint=checkpoint, progress=progress).save(out)
"""


def main() -> None:
    """Kill, look, continue, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", nargs="+", default=["fast", "paper"], choices=LITTLE)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--engine", default="jax")
    options = parser.parse_args()
    rng = random.Random(options.seed)
    cases = synthetic(3, 4, n_points=41)
    bad = 0
    for preset in options.presets:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            cases.save(folder / "cases.npz")
            config = LITTLE[preset]
            (folder / "config.json").write_text(config.to_json(), encoding="utf-8")
            bad += kill(folder, type(config).__name__, preset, options.times, options.engine, rng)
    sys.exit(1 if bad else 0)


def kill(folder: Path, kind: str, preset: str, times: int, engine: str, rng: random.Random) -> int:
    """Return how much went wrong."""
    checkpoint, out = folder / "run.checkpoint", folder / "model.npz"

    def start(checkpoint: Path, out: Path) -> subprocess.Popen[bytes]:
        arguments = [str(folder), kind, engine, str(checkpoint), str(out), str(TESTS)]
        # What is compiled is kept, so that more of the kills are in the training.
        kept = {
            "JAX_COMPILATION_CACHE_DIR": str(folder / "compiled"),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        }
        return subprocess.Popen([sys.executable, "-c", FIT, *arguments], env={**os.environ, **kept})

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
                            f"{state['finished']} of {state['units']}" if path == checkpoint else at
                        )
            print(f"{preset}: kill {kills}, then {at} finished", flush=True)
            continue
        if process.returncode:
            sys.exit("A continued fit failed.")
        finished += 1
        found = dict(PCNDE.load(out, engine="jax").parameters)
        if not all(np.array_equal(found[name], vector) for name, vector in reference.parameters):
            different += 1
        if kills >= times:
            break
        remove(checkpoint)
    print(
        f"{preset}: {kills} kills, {finished} runs to the end, {different} with another result, "
        f"{unreadable} unreadable files, {len(list(folder.glob('.*')))} temporary files left over",
        flush=True,
    )
    return unreadable + different


if __name__ == "__main__":
    main()
