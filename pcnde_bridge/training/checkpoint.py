"""Checkpoint files of a training run: the newest state and the one before."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pcnde_bridge._typing import AnyArray, StrPath
from pcnde_bridge._utils.archive import interpreting, read_archive, write_archive
from pcnde_bridge._utils.files import atomic_write, check_writable, remove_leftovers
from pcnde_bridge.config import Config, config_from
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.training.provenance import provenance

_OVERHEAD = 1 << 20  # bytes beside the numbers: names, JSON, the file system

_log = logging.getLogger("pcnde_bridge")

_Restored = TypeVar("_Restored")
Restore = Callable[[dict[str, Any], Mapping[str, AnyArray]], _Restored]
"""Makes a state of a file's facts and arrays; may raise if they do not belong together."""


def previous(path: StrPath) -> Path:
    """Return the path of the checkpoint before the newest."""
    return Path(path).with_name(Path(path).name + ".previous")


def remove(path: StrPath) -> None:
    """Remove a run's checkpoints, if there are any."""
    Path(path).unlink(missing_ok=True)
    previous(path).unlink(missing_ok=True)


class Checkpoint:
    """Writes and reads the state of one run.

    Files are written atomically, and the newest is replaced only after it has been copied, so
    that a run continues after it was killed at any moment or its newest file was damaged.

    Parameters
    ----------
    path : path-like
        Path of the newest checkpoint; :func:`previous` is beside it.
    kind, version : str, int
        Format, see :func:`~pcnde_bridge._utils.archive.write_archive`.
    cases, config, engine
        Run that the checkpoint belongs to: a file of other cases or settings is rejected.
    """

    def __init__(
        self, path: StrPath, kind: str, version: int, cases: Cases, config: Config, engine: Engine
    ) -> None:
        self.path = Path(path)
        self._kind, self._version = kind, version
        self._cases, self._config, self._engine = cases, config, engine
        self._damaged = False

    def check(self, numbers: int) -> None:
        """Check that checkpoints with this count of numbers can be written.

        Raises
        ------
        FileError
            If there is no folder, no permission, or not enough space.
        """
        for path in (self.path, previous(self.path)):
            remove_leftovers(path)
        # Two files are there while a third is written.
        check_writable(self.path, 3 * 8 * numbers + _OVERHEAD)

    def read(self, seed: int, restore: Restore[_Restored]) -> _Restored | None:
        """Return the newest intact state, or None if the run has not begun.

        Parameters
        ----------
        seed : int
            Random seed of the run.
        restore : callable
            Makes the state of a file's facts and arrays.

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
            return self._read(self.path, seed, restore)
        except FileError as error:
            before = previous(self.path)
            try:
                state = self._read(before, seed, restore)
            except (FileError, InputError):
                raise error from None
            _log.warning("%s Continuing from the checkpoint before it, %s.", error, before)
            self._damaged = True
            return state

    def _read(self, path: Path, seed: int, restore: Restore[_Restored]) -> _Restored:
        facts, arrays = read_archive(path, self._kind, self._version, "checkpoint")
        with interpreting(path, "checkpoint"):
            difference = self._difference(facts, seed)
            state = None if difference else restore(facts, arrays)
            engine = facts["provenance"]["engine"]
        if state is None:
            raise InputError(f"{path} belongs to a run {difference}, or another checkpoint file.")
        if engine != self._engine.name:
            words = (
                "%s was written with the %s engine and continues with %s: the result agrees to "
                "the accuracy of the solver, not bit for bit."
            )
            _log.warning(words, path, engine, self._engine.name)
        return state

    def _difference(self, facts: Mapping[str, Any], seed: int) -> str | None:
        """Describe how the file's run differs from this one, and what to give instead."""
        if facts["cases"] != self._cases.fingerprint():
            return "on other cases. Give the same cases"
        if config_from(facts["config"]) != self._config:
            return "with another configuration. Give the same one"
        if facts["seed"] != seed:
            return f"with seed {facts['seed']}, not {seed}. Give that seed"
        return None

    def write(self, seed: int, facts: Mapping[str, Any], arrays: Mapping[str, AnyArray]) -> None:
        """Write a state and the identity of its run, after copying the file before.

        Raises
        ------
        FileError
            If a file cannot be written; the newest is then still intact.
        """
        before = previous(self.path)
        if not self.path.exists():
            before.unlink(missing_ok=True)  # of a run that was deleted
        elif not self._damaged:
            # A copy, so that the newest file exists at every moment.
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
