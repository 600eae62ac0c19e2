"""Checkpoint files of a training run: the newest state and the one before."""

import logging
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, Generic

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.archive import interpreting, read_archive, write_archive
from pcnde_bridge._utils.files import atomic_write, check_writable
from pcnde_bridge.config import config_from
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.training import history as histories
from pcnde_bridge.training.procedure import Procedure, State
from pcnde_bridge.training.provenance import provenance, provenance_from

_OVERHEAD = 1 << 20  # bytes beside the numbers: names, JSON, the file system

_log = logging.getLogger("pcnde_bridge")


def previous(path: StrPath) -> Path:
    """Return the path of the checkpoint before the newest."""
    return Path(path).with_name(Path(path).name + ".previous")


def remove(path: StrPath) -> None:
    """Remove a run's checkpoints, if there are any."""
    Path(path).unlink(missing_ok=True)
    previous(path).unlink(missing_ok=True)


class Checkpoint(Generic[State]):
    """Writes and reads the state of one run.

    Files are written atomically, and the newest is replaced only after it has been copied, so
    that a run continues after it was killed at any moment or its newest file was damaged.

    Parameters
    ----------
    path : path-like
        Path of the newest checkpoint; :func:`previous` is beside it.
    procedure : Procedure
        Procedure that the checkpoint belongs to: a file of other cases or settings is rejected.
    """

    def __init__(self, path: StrPath, procedure: Procedure[State]) -> None:
        self.path = Path(path)
        self._procedure = procedure

    def check(self, first: State) -> None:
        """Check that all checkpoints of a run can be written, given its first state.

        Raises
        ------
        FileError
            If there is no folder, no permission, or not enough space.
        """
        # Parameters are stored once more after each coupling.
        steps, (_, arrays) = self._procedure.steps(first), self._procedure.to_archive(first)
        copies = 1 + sum(step.task == "coupling" for step in steps)
        numbers = 10 * self._procedure.count_iterations(first)  # six numbers and a text each
        numbers += copies * sum(array.size for array in arrays.values())
        check_writable(previous(self.path))
        # Two files are there while a third is written.
        check_writable(self.path, 3 * 8 * numbers + _OVERHEAD)

    def read(self, seed: int) -> State | None:
        """Return the newest intact state, or None if the run has not begun.

        Parameters
        ----------
        seed : int
            Random seed of the run.

        Raises
        ------
        InputError
            If the newest file belongs to other cases, another configuration or seed.
        FileError
            If the newest file is damaged and there is no intact one before it.
        """
        if not self.path.exists():
            return None
        try:
            return self._read(self.path, seed)
        except FileError as error:
            before = previous(self.path)
            try:
                state = self._read(before, seed)
            except (FileError, InputError):
                raise error from None
            _log.warning("%s Continuing from the checkpoint before it, %s.", error, before)
            before.replace(self.path)
            return state

    def _read(self, path: Path, seed: int) -> State:
        run, what = self._procedure, "checkpoint"
        facts, arrays = read_archive(path, *run.checkpoint_format, what)
        with interpreting(path, what):
            cases, config = facts["cases"], config_from(facts["config"])
            its_seed, engine = facts["seed"], provenance_from(facts["provenance"])["engine"]
            outlet = facts.get("outlet")
        for differs, difference in (
            # First, because the cases in use depend on it.
            (config != run.config, "with another configuration. Give the same one"),
            (cases != run.cases.fingerprint(), "on other cases. Give the same cases"),
            (outlet != _outlet(run), "with another outlet. Give the same one"),
            (its_seed != seed, f"with seed {its_seed}, not {seed}. Give that seed"),
        ):
            if differs:
                raise InputError(f"{path} belongs to a run {difference}, or another {what} file.")
        if engine != run.engine.name:
            words = (
                "%s was written with the %s engine and continues with %s: the result agrees to "
                "the accuracy of the solver, not bit for bit."
            )
            _log.warning(words, path, engine, run.engine.name)
        with interpreting(path, what):
            state = run.from_archive(facts, arrays)
            return replace(state, history=histories.from_arrays(arrays))

    def write(self, state: State) -> None:
        """Write a state and the identity of its run, after copying the file before.

        Raises
        ------
        FileError
            If a file cannot be written; the newest is then still intact.
        """
        before, run = previous(self.path), self._procedure
        if not self.path.exists():
            before.unlink(missing_ok=True)  # of a run that was deleted
        else:
            # A copy, so that the newest file exists at every moment.
            with atomic_write(before) as temporary:
                shutil.copyfile(self.path, temporary)
        facts, arrays = run.to_archive(state)
        facts |= {
            "seed": state.seed,
            "config": run.config.to_dict(),
            "cases": run.cases.fingerprint(),
            "outlet": _outlet(run),
            "provenance": provenance(run.cases, run.engine, state.seed),
            "steps": len(run.steps(state)),
        }
        arrays |= histories.to_arrays(state.history)
        write_archive(self.path, *run.checkpoint_format, facts, arrays)


def _outlet(run: Procedure[State]) -> dict[str, Any] | None:
    return None if run.outlet is None else run.outlet.to_dict()
