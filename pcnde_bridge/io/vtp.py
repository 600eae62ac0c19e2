"""Reader of VTK's XML files of lines (``.vtp``), safe with damaged files.

VTK's own reader ends the process, or takes all memory, when a damaged file claims to
hold more than it does.  This one takes no more memory than the file has data for.  The
format: https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import base64
import lzma
import re
import zlib
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from pcnde_bridge._utils.files import check_claim, check_file
from pcnde_bridge.errors import FileError

_TYPES = {f"{kind}{bits}": f"{kind[0].lower()}{bits // 8}" for kind, bits in (
    ("Float", 32), ("Float", 64), *((k, b) for k in ("Int", "UInt") for b in (8, 16, 32, 64)),
)}  # fmt: skip


class Lines(NamedTuple):
    """What a file holds.

    Attributes
    ----------
    points : array of shape (point, 3)
        Coordinates.
    lines : list of array of int
        The points of each line.
    arrays : dict of str to array of shape (point,) or (point, component)
        Numbers at the points.
    facts : dict of str to number or str
        Single values that belong to the whole file (field data).
    """

    points: npt.NDArray[np.float64]
    lines: list[npt.NDArray[np.int64]]
    arrays: dict[str, npt.NDArray[np.float64]]
    facts: dict[str, Any]


def read_lines(path: Path) -> Lines:
    """Read a ``.vtp`` file.

    Parameters
    ----------
    path : Path
        Data may be ascii, inline or appended, compressed by zlib, LZMA or not.

    Raises
    ------
    DataNotFoundError
        If it is not there.
    FileError
        If it is truncated or damaged, or something else.
    """
    check_file(path, "a .vtp file")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileError(f"Cannot read {path}: {error}.") from error
    if b"<VTKFile" not in content[:4096] or b'type="PolyData"' not in content[:4096]:
        raise FileError(
            f"{path} is not a .vtp file (VTK XML PolyData). Export the centreline as .vtp."
        )
    head, tag, appended = content.partition(b"<AppendedData")
    if b"<!DOCTYPE" in head or b"<!ENTITY" in head:
        raise FileError(f"{path} defines XML entities, which no .vtp file needs; it is not read.")
    try:
        # Appended raw data are no XML; without them the rest is.
        root = ElementTree.fromstring(head + b"</VTKFile>" if tag else head)
        return _lines(root, _Decoder(root.attrib, appended))
    except Exception as error:  # damaged bytes can make nearly anything of it
        raise FileError(
            f"{path} is truncated or damaged, or of a kind that is not read ({error})."
        ) from error


def _lines(root: ElementTree.Element, decode: _Decoder) -> Lines:
    pieces = root.findall("PolyData/Piece")
    if len(pieces) != 1:
        raise ValueError(f"it has {len(pieces)} pieces, not one")
    piece = pieces[0]
    n = int(piece.attrib["NumberOfPoints"])
    arrays: dict[str, npt.NDArray[np.float64]] = {}
    for item in piece.findall("PointData/DataArray"):
        name = item.attrib["Name"]
        if item.attrib["type"] in _TYPES and name not in arrays:
            arrays[name] = _shaped(name, decode(item), item.attrib, n)
    (item,) = piece.findall("Points/DataArray")
    points = _shaped("Points", decode(item), {"NumberOfComponents": "3"}, n)
    if n < 3:
        raise ValueError(f"it has {n} points")
    cells = {item.attrib["Name"]: decode(item) for item in piece.findall("Lines/DataArray")}
    if int(piece.attrib.get("NumberOfLines", 0)) == 0:
        cells = {"connectivity": np.empty(0), "offsets": np.empty(0)}
    ends = cells["connectivity"].astype(np.int64)
    offsets = [0, *cells["offsets"].astype(np.int64).tolist()]
    lines = [ends[a:b] for a, b in pairwise(offsets) if 0 <= a < b <= ends.size]
    return Lines(points, lines, arrays, _facts(root, decode))


def _shaped(
    name: str, values: npt.NDArray[Any], attributes: Mapping[str, str], n: int
) -> npt.NDArray[np.float64]:
    components = int(attributes.get("NumberOfComponents", 1))
    if components < 1 or values.size != n * components:
        raise ValueError(f"{name} has {values.size} values for {n} points")
    shape = (n,) if components == 1 else (n, components)
    return values.astype(np.float64).reshape(shape)


def _facts(root: ElementTree.Element, decode: _Decoder) -> dict[str, Any]:
    facts: dict[str, Any] = {}
    items = [
        *root.findall("PolyData/FieldData/DataArray"),
        *root.findall("PolyData/FieldData/Array"),
    ]
    for item in items:
        name, kind = item.attrib.get("Name"), item.attrib.get("type")
        if name is None or kind not in (*_TYPES, "String"):
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
    """Gives the numbers of a DataArray, wherever and however the file holds them."""

    def __init__(self, attributes: Mapping[str, str], appended: bytes) -> None:
        order = {"LittleEndian": "<", "BigEndian": ">"}[
            attributes.get("byte_order", "LittleEndian")
        ]
        self._order = order
        self._header = np.dtype(order + _TYPES[attributes.get("header_type", "UInt32")])
        self._compressor = attributes.get("compressor")
        tag, _, data = appended.partition(b">")
        self._encoded = b'encoding="raw"' not in tag
        self._appended = data.partition(b"_")[2]
        if self._encoded:
            self._appended = re.sub(rb"\s", b"", self._appended.partition(b"<")[0])

    def __call__(self, item: ElementTree.Element) -> npt.NDArray[Any]:
        kind = item.attrib["type"]
        dtype = np.dtype(self._order + ("u1" if kind == "String" else _TYPES[kind]))
        form, text = item.attrib["format"], item.text or ""
        if form == "ascii":
            return np.array(text.split(), dtype=np.float64 if dtype.kind == "f" else np.int64)
        if form == "binary":
            data = self._bytes(re.sub(r"\s", "", text).encode("ascii"), True)
        elif form == "appended":
            offset = int(item.attrib["offset"])
            if not 0 <= offset <= len(self._appended):
                raise ValueError(f"{item.attrib['Name']} lies outside the file")
            data = self._bytes(self._appended[offset:], self._encoded)
        else:
            raise ValueError(f"unknown format {form!r}")
        return np.frombuffer(data, dtype)

    def _bytes(self, source: bytes, encoded: bool) -> bytes:
        """Decode one array: its header of sizes, and the data."""
        width = self._header.itemsize
        first = int(self._numbers(_part(source, 0, width, encoded)[0])[0])
        unpack = _unpacker(self._compressor)
        if unpack is None:
            data, _ = _part(source, 0, width + first, encoded)
            return data[width:]
        # The header is a stream of its own: blocks, their size, that of the last, packed sizes.
        header, position = _part(source, 0, width * (3 + first), encoded)
        _, size, last, *packed = self._numbers(header).tolist()
        sizes = [size] * len(packed)
        if packed and last:
            sizes[-1] = last
        check_claim(sum(sizes), len(source))
        blocks, _ = _part(source, position, sum(packed), encoded)
        at = np.concatenate([[0], np.cumsum(np.array(packed, dtype=np.int64))]).tolist()
        out = [
            unpack(blocks[a:b], whole) for (a, b), whole in zip(pairwise(at), sizes, strict=True)
        ]
        return b"".join(out)

    def _numbers(self, header: bytes) -> npt.NDArray[Any]:
        return np.frombuffer(header, self._header)


def _part(source: bytes, position: int, length: int, encoded: bool) -> tuple[bytes, int]:
    """Return so many bytes from a position of the source, and where they end."""
    end = position + (4 * -(-length // 3) if encoded else length)
    if length < 0 or end > len(source):
        raise ValueError("it ends too early")
    part = source[position:end]
    data = base64.b64decode(part, validate=True) if encoded else part
    if len(data) < length:
        raise ValueError("it ends too early")
    return data[:length], end


def _unpacker(compressor: str | None) -> Callable[[bytes, int], bytes] | None:
    """Return what unpacks a block to its size, and no further."""
    if compressor is None:
        return None
    if compressor == "vtkZLibDataCompressor":
        make: Callable[[], Any] = zlib.decompressobj
    elif compressor == "vtkLZMADataCompressor":
        make = lzma.LZMADecompressor
    else:
        raise ValueError(f"its compressor {compressor} is not known here: save it with zlib")

    def unpack(block: bytes, size: int) -> bytes:
        data: bytes = make().decompress(block, max(size, 1))
        if len(data) != size:
            raise ValueError("a block has not its size")
        return data

    return unpack
