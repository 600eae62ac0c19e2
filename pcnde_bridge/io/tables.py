"""CSV tables: columns of numbers, and columns of labels whose type is inferred."""

from __future__ import annotations

import bz2
import gzip
import itertools
import lzma
import re
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.files import Budget, check_file, reading, without_apostrophe
from pcnde_bridge.errors import FileError, InputError

# Before version 3.1 pandas rounds one number in six to a neighbor by default; from then on the
# option is deprecated.
_OLD_PANDAS = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)
_EXACT: dict[str, Any] = {"float_precision": "round_trip"} if _OLD_PANDAS else {}
_COMPRESSED: dict[str, Any] = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}
_TABLE = "a table of comma-separated values in UTF-8"
_MOST_COLUMNS, _MOST_UNNAMED, _MOST_VALUES = 100_000, 100, 5_000_000
_LARGEST = np.iinfo(np.int64).max
_TRUTH = {"True": True, "False": False}
_DECIMAL = re.compile(r"-?(inf|(0|[1-9]\d*)(\.\d+)?([eE][+-]?\d+)?)", re.ASCII)
"""Numbers as programs write them; text with further leading zeros is a name."""
_MISSING = ("", "NA", "N/A", "#N/A", "n/a", "<NA>", "NaN", "nan", "-nan", "NULL", "null", "None")
"""Text that stands for an unknown number, as in :func:`pandas.read_csv`."""


def read_frame(path: StrPath, **options: Any) -> pd.DataFrame:
    """Read a CSV file by :func:`pandas.read_csv`, with all digits of its numbers.

    Parameters
    ----------
    path : path-like
        The file, which may be compressed.
    **options
        Options of :func:`pandas.read_csv`.

    Raises
    ------
    FileError
        If the file cannot be read as a table.
    """
    with reading(path, _TABLE):
        _check_unpacked(Path(path))
        _check_widths(Path(path), options.get("comment"))
        header = "" if "sep" in options else first_line(path)
        for mark, name in ((";", "semicolons"), ("\t", "tabs")):
            if mark in header and "," not in header:
                advice = "save it with commas between columns and points in numbers"
                raise FileError(f"The columns of {path} are separated by {name}: {advice}.")
        # Blanks after commas belong neither to names nor to values.
        frame: pd.DataFrame = pd.read_csv(path, skipinitialspace=True, **_EXACT, **options)
    return frame


def _check_unpacked(path: Path) -> None:
    """Refuse a compressed table that is much larger than its file."""
    if path.suffix in _COMPRESSED and path.is_file():
        stored, values = path.stat().st_size, 0
        budget = Budget(stored)
        with _COMPRESSED[path.suffix](path, "rb") as content:
            while block := content.read(1 << 20):
                budget.claim(len(block))
                values += sum(map(block.count, (b",", b";", b"\t", b"\n")))
        if values > _MOST_VALUES + stored // 3:
            raise ValueError(f"it has {values} values in a file of {stored} bytes")


def _check_widths(path: Path, comment: str | None) -> None:
    """Refuse names, or a first row, of so many columns that reading them would never end."""
    if not path.is_file():
        return
    with _opened(path) as text:
        filled = (line for line in text if line.strip() and line[0] != comment)
        widths = [_width(line) for line in itertools.islice(filled, 2)]
    for width, most in zip(widths, (_MOST_COLUMNS, widths[0] + _MOST_UNNAMED), strict=False):
        if width > most:
            raise ValueError(f"it has a row of {width + 1} columns")


def _width(line: str) -> int:
    return sum(map(line.count, ",;\t"))


def _opened(path: Path) -> TextIO:
    return _COMPRESSED.get(path.suffix, open)(path, "rt", encoding="utf-8-sig")


def first_line(path: StrPath) -> str:
    """Return the first line of a table that is neither blank nor a comment.

    Parameters
    ----------
    path : path-like
        The file, which may be compressed.

    Returns
    -------
    str
        The line; empty if there is none, or if the file is a pipe, which is read only once.

    Raises
    ------
    FileError
        If the file cannot be read.
    """
    check_file(Path(path), _TABLE)
    if not Path(path).is_file():
        return ""
    with reading(path, _TABLE), _opened(Path(path)) as text:
        return next((line for line in text if line.strip() and line[0] != "#"), "").rstrip("\n")


def numbers(path: StrPath, column: pd.Series[Any]) -> Array:
    """Return a column of a table as numbers.

    Parameters
    ----------
    path : path-like
        File of the table, for the message.
    column : Series
        The column with its name.

    Raises
    ------
    InputError
        If a value is not a number; the message names its line and column.
    """
    if column.dtype in (bool, object):  # also whole numbers beyond all floats
        column = column.map(str)
    values = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64)
    if (missing := np.isnan(values)).any():
        line = line_of(path, int(np.argmax(missing)))
        raise InputError(f"{path}, line {line}, column {column.name}: not a number.")
    return values


def line_of(path: StrPath, row: int) -> int:
    """Return the line in a CSV file of a row of its table, for messages.

    Parameters
    ----------
    path : path-like
        The file, which may be ``.gz``.
    row : int
        Number of the row; 0 is the first below the names of the columns.

    Returns
    -------
    int
        Number of the line, counting blank lines, which are no rows.
    """
    if not Path(path).is_file():  # a pipe cannot be read again
        return row + 2
    with _opened(Path(path)) as text:
        filled = (number for number, line in enumerate(text, start=1) if line.strip())
        return next(itertools.islice(filled, row + 1, None), row + 2)


def read_labeled(
    paths: Iterable[Path], numeric: Collection[str], **options: Any
) -> list[tuple[Path, pd.DataFrame]]:
    """Read CSV files with columns of numbers and columns of labels.

    Parameters
    ----------
    paths : iterable of path-like
        The files.
    numeric : collection of str
        Names of the columns of numbers, read as :func:`pandas.read_csv` does.
    **options
        Options of :func:`pandas.read_csv` that choose columns.

    Returns
    -------
    list of (Path, DataFrame)
        Each file with its table.  A column of labels holds numbers or truth values if all
        its values in all files are such, as ``12`` and ``0.50``, but not ``007``; else it
        holds the text of the files.  Only an empty value is missing (NaN): ``NA`` is text.

    Raises
    ------
    FileError
        If a file cannot be read as a table.
    """
    tables: list[tuple[Path, pd.DataFrame]] = []
    texts: dict[str, set[str]] = {}
    for path in paths:
        check_file(path, _TABLE)
        if path.is_fifo():
            raise FileError(f"{path} is a pipe, but this table is read twice: save it as a file.")
        header = [str(name) for name in read_frame(path, nrows=0, **options)]
        names = [name for name in header if name not in numeric]
        frame = read_frame(
            path,
            dtype=dict.fromkeys(names, str),
            keep_default_na=False,
            na_values={name: _MISSING for name in header if name in numeric},
        )[header]
        for name in names:
            texts.setdefault(name, set()).update(frame[name].unique())
        tables.append((path, frame))
    for name, found in texts.items():
        plain = {text: without_apostrophe(text) for text in found - {""}}
        values = _label_values(set(plain.values()))
        for _, frame in tables:
            if name in frame:
                labels = frame[name].map({text: values[label] for text, label in plain.items()})
                frame[name] = labels.infer_objects()
    return [(path, frame.rename(columns=without_apostrophe)) for path, frame in tables]


def _label_values(texts: Collection[str]) -> dict[str, Any]:
    """Return the value of each text of a label: numbers for all of them, or the texts."""
    if all(text in _TRUTH for text in texts):
        return _TRUTH
    if all(map(_DECIMAL.fullmatch, texts)):
        values = {text: int(text) if text.strip("-").isdigit() else float(text) for text in texts}
        fits = all(isinstance(value, float) or abs(value) <= _LARGEST for value in values.values())
        # Different texts must be different numbers: 1 and 1.0 are not.
        if fits and len(set(values.values())) == len(texts):
            return values
    return {text: text for text in texts}


def read_labels(path: StrPath, files: Sequence[StrPath]) -> pd.DataFrame:
    """Read the labels of files from a CSV table.

    Parameters
    ----------
    path : path-like
        Table with the columns ``file``, ``geometry``, ``waveform`` and any others; one
        row for each file, named as in ``files`` or without its folder.
    files : sequence of path-like
        The files.

    Returns
    -------
    DataFrame
        The labels in the order of the files, without the column ``file``.

    Raises
    ------
    FileError
        If the table cannot be read.
    InputError
        If a file has no row, or several.
    """
    [(_, table)] = read_labeled([Path(path)], ("geometry", "waveform", "blockage"))
    if "file" not in table:
        raise InputError(f"{path} lacks the column 'file'; it has {list(table.columns)}.")
    rows = []
    for file in files:
        found = table.index[table["file"].map(str).isin([str(file), Path(file).name])]
        if found.size != 1:
            raise InputError(f"{path} has {found.size} rows for {file}; it needs one.")
        rows += found.tolist()
    return table.loc[rows].drop(columns="file").reset_index(drop=True)
