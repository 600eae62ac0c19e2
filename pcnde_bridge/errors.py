"""Exceptions and warnings of the package, one family each, so that one clause catches all.

Each message says what is wrong, where, and what to do.  Errors about input are also a
:class:`ValueError`, as users of scikit-learn and numpy expect.
"""

from collections.abc import Iterable


class PCNDEError(Exception):
    """Base class of all errors that this package raises intentionally."""


class PCNDEWarning(UserWarning):
    """Base class of the package's warnings: a result was produced but may be unreliable."""


class InputError(PCNDEError, ValueError):
    """An argument, a configuration or an array is not usable."""


class FileError(PCNDEError, ValueError):
    """A file is missing, damaged, of another kind, or of a newer format."""


class DataNotFoundError(FileError, FileNotFoundError):
    """A file or data set was not found on this machine, or could not be downloaded."""


class EngineError(PCNDEError, RuntimeError):
    """An engine failed; the message contains the engine's own message."""


class EngineUnavailableError(EngineError):
    """An engine cannot be used on this machine; the message says what is missing."""


class SolveError(EngineError):
    """A differential equation could not be integrated to the end.

    Parameters
    ----------
    message : str
        Text of the error.
    cases : iterable of int
        Indices of cases that failed, as far as they are known.
    """

    def __init__(self, message: str, cases: Iterable[int] = ()) -> None:
        super().__init__(message)
        self.cases = tuple(map(int, cases))


class MissingExtraError(PCNDEError, ImportError):
    """An optional package is not installed; the message names the extra that installs it."""


class TaskError(PCNDEError, RuntimeError):
    """Some of many tasks failed, so that their results cannot be combined."""
