"""The state of a training run on the disk: the newest, and the one before it."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy.typing as npt

from pcnde_bridge.archive import read_archive, write_archive
from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.files import atomic_write, check_writable, remove_leftovers

Arrays = Mapping[str, npt.NDArray[Any]]
State = TypeVar("State")

_ROOM = 1 << 20  # bytes beside the numbers: names, JSON, the file system's own

_log = logging.getLogger("pcnde_bridge")


def previous(path: str | os.PathLike[str]) -> Path:
    """Return the file that keeps the checkpoint before the newest."""
    return Path(path).with_name(Path(path).name + ".previous")


def remove(path: str | os.PathLike[str]) -> None:
    """Remove a run's checkpoints, if there are any."""
    Path(path).unlink(missing_ok=True)
    previous(path).unlink(missing_ok=True)


def tell_of_other_engine(path: Path, before: str, now: str) -> None:
    """Warn, if they differ, that a run continues with another engine than it began with."""
    if before != now:
        _log.warning(
            "%s was written with the %s engine and continues with %s: the result agrees to the "
            "accuracy of the solver, not bit for bit.",
            path,
            before,
            now,
        )


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
        As of :func:`~pcnde_bridge.archive.write_archive`.
    """

    def __init__(self, path: str | os.PathLike[str], kind: str, version: int) -> None:
        self.path = Path(path)
        self._kind, self._version = kind, version
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

    def read(self, parse: Callable[[Path, dict[str, Any], Arrays], State]) -> State | None:
        """Return the newest state that is whole, or None if the run has not begun.

        Parameters
        ----------
        parse : callable
            Makes the state of a file's path, facts and arrays, raising FileError
            if they are not whole.

        Raises
        ------
        FileError
            If the newest is damaged and there is no whole one before it.
        """
        if not self.path.exists():
            return None
        try:
            return self._read(self.path, parse)
        except FileError as error:
            before = previous(self.path)
            try:
                state = self._read(before, parse)
            except (FileError, InputError):
                raise error from None
            _log.warning("%s Continuing from the checkpoint before it, %s.", error, before)
            self._damaged = True
            return state

    def _read(self, path: Path, parse: Callable[[Path, dict[str, Any], Arrays], State]) -> State:
        return parse(path, *read_archive(path, self._kind, self._version, "checkpoint"))

    def write(self, facts: Mapping[str, Any], arrays: Arrays) -> None:
        """Write a state, keeping the one before it.

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
        write_archive(self.path, self._kind, self._version, facts, arrays)
        self._damaged = False
