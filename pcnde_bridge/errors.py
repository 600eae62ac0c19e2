"""The package's exceptions and warnings: one family each, so that one clause catches all.

Each message says what was wrong, where, and what to do about it.  Bad input is
also a :class:`ValueError`, as scikit-learn and numpy users expect.
"""

from __future__ import annotations


class PCNDEError(Exception):
    """Base class of every error that this package raises on purpose."""


class PCNDEWarning(UserWarning):
    """Base class of the package's warnings: a result is there, but less sure than it looks."""


class InputError(PCNDEError, ValueError):
    """An argument, a configuration or an array is not usable."""


class FileError(PCNDEError, ValueError):
    """A file is missing, truncated, foreign, or of a newer format."""


class DataNotFoundError(FileError, FileNotFoundError):
    """A data set was not found on this machine, or could not be downloaded."""


class EngineError(PCNDEError, RuntimeError):
    """A computing engine failed; the message holds the engine's own words."""


class EngineUnavailableError(EngineError):
    """An engine cannot be used on this machine; the message says what is missing."""


class SolveError(EngineError):
    """A differential equation could not be integrated to the end."""


class MissingExtraError(PCNDEError, ImportError):
    """An optional package is not installed; the message names the extra that brings it."""


class TaskError(PCNDEError, RuntimeError):
    """Some of many tasks failed, so that nothing can be made of the rest."""
