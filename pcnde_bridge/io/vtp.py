"""Reader of VTK's XML files of lines (``.vtp``) that is safe with damaged files.

VTK's own reader ends the process, or takes all memory, when a damaged file claims to
hold more than it does.  This reader takes no more memory than the file has data for.
Format: https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import base64
import lzma
import re
import warnings
import zlib
from collections.abc import Callable, Mapping
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from pcnde_bridge._typing import Array, IntArray
from pcnde_bridge._utils.files import Budget, reading

_INTEGERS = (f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64))
_TYPES = {name: np.dtype(name.lower()) for name in ("Float32", "Float64", *_INTEGERS)}
_TYPES["String"] = np.dtype("u1")
"""Types of numbers, or of the bytes of a text, by their names in VTK."""

_MOST_TAGS = 1_000_000

_DECOMPRESSORS: Mapping[str | None, Callable[[], Any]] = {
    "vtkZLibDataCompressor": zlib.decompressobj,
    "vtkLZMADataCompressor": lzma.LZMADecompressor,
}


class Lines(NamedTuple):
    """Content of a file of lines.

    Attributes
    ----------
    points : array of shape (point, 3)
        Coordinates.
    lines : list of array of int
        Numbers of the points of each line.
    arrays : dict of str to array of shape (point,) or (point, component)
        Values at the points.
    facts : dict of str to number or str
        Single values of the whole file (field data).
    """

    points: Array
    lines: list[IntArray]
    arrays: dict[str, Array]
    facts: dict[str, Any]


def read_lines(path: Path) -> Lines:
    """Read a ``.vtp`` file.

    Parameters
    ----------
    path : Path
        File with ascii, inline or appended data, compressed by zlib, LZMA or not.

    Raises
    ------
    DataNotFoundError
        If the file does not exist.
    FileError
        If the file is truncated, damaged or of another kind.
    """
    with reading(path, "a .vtp file with lines (VTK XML PolyData)"):
        content = path.read_bytes()
        head, tag, appended = content.partition(b"<AppendedData")
        # Raw appended data are not XML; the part before them is, once it is closed.
        root = xml_root(head + b"</VTKFile>" if tag else head)
        return _lines(root, _Decoder(root.attrib, appended, Budget(len(content))))


def xml_root(content: bytes) -> ElementTree.Element:
    """Parse an XML file of VTK, which must not define entities.

    Raises
    ------
    ValueError, ElementTree.ParseError
        If it is not such a file.
    """
    # In UTF-16, which has zero bytes, entities could hide.
    if any(word in content for word in (b"<!DOCTYPE", b"<!ENTITY", b"\0")):
        raise ValueError("it defines XML entities, or is not UTF-8 text")
    if (count := content.count(b"<")) > _MOST_TAGS:
        raise ValueError(f"it has {count} tags")
    return ElementTree.fromstring(content, ElementTree.XMLParser(encoding="utf-8"))


def _lines(root: ElementTree.Element, decode: _Decoder) -> Lines:
    """Return the content of the only piece of a file."""
    (piece,) = root.findall("PolyData/Piece")
    n = int(piece.attrib["NumberOfPoints"])
    if n < 3:
        raise ValueError(f"it has {n} points")
    arrays: dict[str, Array] = {}
    for item in piece.findall("PointData/DataArray"):
        name = item.attrib["Name"]
        if item.attrib["type"] in _TYPES and name not in arrays:
            arrays[name] = _shaped(decode(item), item.attrib, n)
    (item,) = piece.findall("Points/DataArray")
    points = _shaped(decode(item), {"Name": "Points", "NumberOfComponents": "3"}, n)
    ends, offsets = np.empty(0, dtype=np.int64), [0]
    if int(piece.attrib.get("NumberOfLines", 0)):
        cells = {item.attrib["Name"]: decode(item) for item in piece.findall("Lines/DataArray")}
        ends = cells["connectivity"].astype(np.int64)
        offsets += cells["offsets"].astype(np.int64).tolist()
    lines = [ends[a:b] for a, b in pairwise(offsets) if 0 <= a < b <= ends.size]
    return Lines(points, lines, arrays, _facts(root, decode))


def _shaped(values: npt.NDArray[Any], attributes: Mapping[str, str], n: int) -> Array:
    """Return values as one row, or one number, for each of n points."""
    components = int(attributes.get("NumberOfComponents", 1))
    if components < 1 or values.size != n * components:
        raise ValueError(f"{attributes['Name']} has {values.size} values for {n} points")
    return values.astype(np.float64).reshape((n,) if components == 1 else (n, components))


def _facts(root: ElementTree.Element, decode: _Decoder) -> dict[str, Any]:
    """Return the field data that are single numbers or texts."""
    facts: dict[str, Any] = {}
    for item in root.iterfind("PolyData/FieldData/*"):
        name, kind = item.attrib.get("Name"), item.attrib.get("type")
        if name is None or kind not in _TYPES:
            continue
        values = decode(item)
        if kind == "String":
            text = values.astype(np.uint8).tobytes()
            if text.count(b"\0") == 1 and text.endswith(b"\0"):
                facts[name] = text[:-1].decode("utf-8")
        elif values.size == 1:
            facts[name] = values.item()
    return facts


class _Decoder:
    """Decoder of the numbers of a DataArray, wherever and however they are stored."""

    def __init__(self, attributes: Mapping[str, str], appended: bytes, budget: Budget) -> None:
        orders = {"LittleEndian": "<", "BigEndian": ">"}
        self._order: Any = orders[attributes.get("byte_order", "LittleEndian")]
        self._header = self._type(attributes.get("header_type", "UInt32"))
        self._compressor = attributes.get("compressor")
        self._budget = budget
        tag, _, data = appended.partition(b">")
        self._encoded = b'encoding="raw"' not in tag
        self._appended = data.partition(b"_")[2]
        if self._encoded:
            self._appended = re.sub(rb"\s", b"", self._appended.partition(b"<")[0])

    def __call__(self, item: ElementTree.Element) -> npt.NDArray[Any]:
        """Return the numbers of a DataArray in one row."""
        dtype, text = self._type(item.attrib["type"]), item.text or ""
        match item.attrib["format"]:
            case "ascii":
                return self._spelled(text, np.float64 if dtype.kind == "f" else np.int64)
            case "binary":
                data = self._bytes(re.sub(r"\s", "", text).encode("ascii"), 0, True)
            case "appended":
                data = self._bytes(self._appended, int(item.attrib["offset"]), self._encoded)
            case form:
                raise ValueError(f"unknown format {form!r}")
        # Numbers become 8 bytes each; the bytes that they have are in the file or claimed.
        self._budget.claim(len(data) // dtype.itemsize * 8 - len(data))
        return np.frombuffer(data, dtype)

    def _type(self, name: str) -> np.dtype[Any]:
        return _TYPES[name].newbyteorder(self._order)

    def _spelled(self, text: str, dtype: type) -> npt.NDArray[Any]:
        """Read numbers of a text, without a string for each of them."""
        self._budget.claim(4 * len(text))
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # older versions of numpy warn of other text
            return np.fromstring(text, dtype, sep=" ")

    def _bytes(self, source: bytes, start: int, encoded: bool) -> bytes:
        """Decode the array that starts at a position: its header of sizes, and the data."""
        width = self._header.itemsize
        [first] = self._sizes(_part(source, start, width, encoded)[0])
        if self._compressor is None:
            return _part(source, start, width + first, encoded)[0][width:]
        # The header is a stream of its own: blocks, their size, that of the last, packed sizes.
        header, end = _part(source, start, width * (3 + first), encoded)
        _, size, last, *packed = self._sizes(header)
        sizes = [size] * len(packed)
        if packed and last:
            sizes[-1] = last
        self._budget.claim(sum(sizes))
        blocks, _ = _part(source, end, sum(packed), encoded)
        places = pairwise(accumulate(packed, initial=0))
        return b"".join(
            self._unpacked(blocks[a:b], size) for (a, b), size in zip(places, sizes, strict=True)
        )

    def _sizes(self, header: bytes) -> list[int]:
        return np.frombuffer(header, self._header).tolist()

    def _unpacked(self, block: bytes, size: int) -> bytes:
        """Decompress a block to its size, and no further."""
        if self._compressor not in _DECOMPRESSORS:
            raise ValueError(f"its compressor {self._compressor} is unknown: save it with zlib")
        stream = _DECOMPRESSORS[self._compressor]()
        # One byte more than expected takes the stream to its end, where its checksum is.
        data: bytes = stream.decompress(block, size + 1)
        if len(data) != size or not stream.eof or stream.unused_data:
            raise ValueError("a compressed block is damaged: its size or its checksum is wrong")
        return data


def _part(source: bytes, start: int, length: int, encoded: bool) -> tuple[bytes, int]:
    """Return a number of bytes from a position of the source, and the position after them."""
    end = start + (4 * -(-length // 3) if encoded else length)
    if not 0 <= start <= end <= len(source):
        raise ValueError("it ends too early")
    part = source[start:end]
    data = base64.b64decode(part, validate=True)[:length] if encoded else part
    if len(data) < length:
        raise ValueError("it ends too early")
    return data, end
