"""The state of a training run on the disk: the newest, and the one before it."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy.typing as npt

from pcnde_bridge._utils.archive import read_archive, write_archive
from pcnde_bridge._utils.files import (
    atomic_write,
    check_writable,
    remove_leftovers,
)
from pcnde_bridge.config import (
    ClosureConfig,
    PCNDEConfig,
    config_from,
)
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.training.history import Iteration
from pcnde_bridge.training.provenance import provenance

Arrays = Mapping[str, npt.NDArray[Any]]

_ROOM = 1 << 20  # bytes beside the numbers: names, JSON, the file system's own

_log = logging.getLogger("pcnde_bridge")


class RunState:
    """How far a run has come, of either kind of model."""

    seed: int
    history: tuple[Iteration, ...]

    @property
    def seconds(self) -> float:
        """Time spent in the finished units."""
        return self.history[-1].seconds if self.history else 0.0


State = TypeVar("State", bound=RunState)


def previous(path: str | os.PathLike[str]) -> Path:
    """Return the file that keeps the checkpoint before the newest."""
    return Path(path).with_name(Path(path).name + ".previous")


def remove(path: str | os.PathLike[str]) -> None:
    """Remove a run's checkpoints, if there are any."""
    Path(path).unlink(missing_ok=True)
    previous(path).unlink(missing_ok=True)


class Checkpoint:
    """Writes and reads the state of one run.

    Every file appears whole or not at all, and the newest is written only when the
    one before it has been kept, so that a run which is killed at any moment, or
    whose newest file the disk damages, continues.

    Parameters
    ----------
    path : path-like
        The newest; :func:`previous` is beside it.
    kind, version : str, int
        As of :func:`~pcnde_bridge._utils.archive.write_archive`.
    cases, config, engine
        Of the run: a file that belongs to other cases or another configuration is refused.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        kind: str,
        version: int,
        cases: Cases,
        config: PCNDEConfig | ClosureConfig,
        engine: Engine,
    ) -> None:
        self.path = Path(path)
        self._kind, self._version = kind, version
        self._cases, self._config, self._engine = cases, config, engine
        self._damaged = False

    def check(self, numbers: int) -> None:
        """Raise if checkpoints of so many numbers could not be written.

        Raises
        ------
        FileError
            Saying why: no folder, no permission, or not enough space.
        """
        for path in (self.path, previous(self.path)):
            remove_leftovers(path)
        # Two are kept while a third is written.
        check_writable(self.path, 3 * 8 * numbers + _ROOM)

    def read(self, seed: int, parse: Callable[[dict[str, Any], Arrays], State]) -> State | None:
        """Return the newest state that is whole, or None if the run has not begun.

        Parameters
        ----------
        seed : int
            Of the run.
        parse : callable
            Makes the state of a file's facts and arrays; it may raise what comes of
            some that are missing or do not belong together.

        Raises
        ------
        InputError
            If the newest belongs to other cases, another configuration or seed.
        FileError
            If the newest is damaged and there is no whole one before it.
        """
        if not self.path.exists():
            return None
        try:
            return self._read(self.path, seed, parse)
        except FileError as error:
            before = previous(self.path)
            try:
                state = self._read(before, seed, parse)
            except (FileError, InputError):
                raise error from None
            _log.warning("%s Continuing from the checkpoint before it, %s.", error, before)
            self._damaged = True
            return state

    def _read(
        self, path: Path, seed: int, parse: Callable[[dict[str, Any], Arrays], State]
    ) -> State:
        facts, arrays = read_archive(path, self._kind, self._version, "checkpoint")
        try:
            other = self._other_run(facts, seed)
            state = None if other else parse(facts, arrays)
            engine = facts["provenance"]["engine"]
        except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
            raise FileError(f"{path} is not a whole checkpoint: {error!r}.") from error
        if state is None:
            raise InputError(f"{path} belongs to a run {other}, or another checkpoint file.")
        if engine != self._engine.name:
            _log.warning(
                "%s was written with the %s engine and continues with %s: the result agrees to "
                "the accuracy of the solver, not bit for bit.",
                path,
                engine,
                self._engine.name,
            )
        return state

    def _other_run(self, facts: Mapping[str, Any], seed: int) -> str | None:
        """Say of which other run the facts are, if they are, and what would be this one."""
        if facts["cases"] != self._cases.fingerprint():
            return "on other cases. Give the same cases"
        if config_from(facts["config"]) != self._config:
            return "with another configuration. Give the same one"
        if facts["seed"] != seed:
            return f"with seed {facts['seed']}, not {seed}. Give that seed"
        return None

    def write(self, seed: int, facts: Mapping[str, Any], arrays: Arrays) -> None:
        """Write what a state is made of, and of which run it is, keeping the one before it.

        Raises
        ------
        FileError
            If a file cannot be written; the newest is then still whole.
        """
        before = previous(self.path)
        if not self.path.exists():
            before.unlink(missing_ok=True)  # of a run that was thrown away
        elif not self._damaged:
            # A copy, so that there is no moment without the newest file.
            with atomic_write(before) as temporary:
                shutil.copyfile(self.path, temporary)
        run = {
            "seed": seed,
            "config": self._config.to_dict(),
            "cases": self._cases.fingerprint(),
            "provenance": provenance(self._cases, self._engine, seed),
        }
        write_archive(self.path, self._kind, self._version, {**run, **facts}, arrays)
        self._damaged = False
