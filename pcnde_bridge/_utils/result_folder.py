"""Results of tasks stored in a folder, one file each, so that a killed run can be resumed."""

import contextlib
import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.archive import (
    archive_kind,
    interpreting,
    read_archive,
    write_archive,
)
from pcnde_bridge._utils.files import check_writable, make_folder
from pcnde_bridge.errors import FileError, InputError

_KIND, _VERSION = "pcnde-task", 1
_ARRAY = "result."  # prefix of a result's arrays; the archive's own names never start with it

_log = logging.getLogger("pcnde_bridge")


class ResultFolder:
    """Folder with one file per finished task.

    Parameters
    ----------
    folder : path-like
        Created if it is missing.
    facts : mapping
        Data, for JSON, that the results depend on.

    Raises
    ------
    FileError
        If the folder cannot be written.
    """

    def __init__(self, folder: StrPath, facts: Mapping[str, Any]) -> None:
        self._folder = Path(folder)
        self._facts = json.loads(json.dumps(facts))  # as read from a file: tuples become lists
        make_folder(self._folder)
        check_writable(self._path("result"))

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.npz"

    def read(self, name: str) -> dict[str, Any] | None:
        """Return the result of a task, or None if it has to be computed.

        Raises
        ------
        InputError
            If the stored result depends on other facts.
        """
        path = self._path(name)
        if not path.exists():
            return None
        try:
            facts, arrays = read_archive(path, _KIND, _VERSION, "result")
            with interpreting(path, "result"):
                same = facts["facts"] == self._facts
                values = {_ARRAY + key: value for key, value in facts["values"].items()} | arrays
                result = {key: values[_ARRAY + key] for key in facts["order"]}
        except FileError as error:
            _log.warning("%s The task is repeated.", error)
            return None
        if not same:
            raise InputError(
                f"{path} is the result of other tasks (other cases, settings or seeds). Give "
                "another folder, or remove this one."
            )
        return result

    def write(self, name: str, result: Any) -> None:
        """Store the result of a task.

        Raises
        ------
        InputError
            If the result is not a mapping of names to arrays and JSON data.
        """
        try:
            if not (isinstance(result, Mapping) and all(isinstance(key, str) for key in result)):
                raise TypeError("only mappings of names can be stored")
            arrays = {_ARRAY + k: v for k, v in result.items() if isinstance(v, np.ndarray)}
            values = {k: v for k, v in result.items() if not isinstance(v, np.ndarray)}
            values |= {k: v.item() for k, v in values.items() if isinstance(v, np.generic)}
            content = {"facts": self._facts, "values": values, "order": list(result)}
            write_archive(self._path(name), _KIND, _VERSION, content, arrays)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"The result of {name} cannot be stored in a folder: {error}. Return a mapping of "
                "names to arrays of numbers or text and to data that JSON can represent."
            ) from error


def remove_results(folder: StrPath) -> None:
    """Remove the results stored in a folder, and the folder if it is then empty."""
    for path in Path(folder).glob("*.npz"):
        if archive_kind(path) == _KIND:
            path.unlink()
    with contextlib.suppress(OSError):
        Path(folder).rmdir()
