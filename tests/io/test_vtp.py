"""Centerline files in every encoding that VTK writes."""

from __future__ import annotations

import numpy as np
import pytest
from io_helpers import centerline, edited
from vtkmodules.vtkCommonCore import vtkBitArray, vtkStringArray
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

from pcnde_bridge import FileError
from pcnde_bridge.io import read_simvascular, to_cases, write_vtp

WAYS = {
    "ascii": lambda writer: writer.SetDataModeToAscii(),
    "inline": lambda writer: writer.SetDataModeToBinary(),
    "raw": lambda writer: writer.EncodeAppendedDataOff(),
    "not compressed": lambda writer: writer.SetCompressorTypeToNone(),
    "raw, not compressed": lambda writer: (
        writer.SetCompressorTypeToNone(),
        writer.EncodeAppendedDataOff(),
    ),
    "LZMA": lambda writer: writer.SetCompressorTypeToLZMA(),
    "64 bits": lambda writer: writer.SetHeaderTypeToUInt64(),
    "big endian": lambda writer: writer.SetByteOrderToBigEndian(),
    "small blocks": lambda writer: writer.SetBlockSize(64),
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS.keys())
def test_reads_centerlines_however_vtk_writes_them(prediction, tmp_path, way):
    (path, *_) = write_vtp(prediction, tmp_path / "p.vtp")
    expected = read_simvascular(path)
    reader, writer = vtkXMLPolyDataReader(), vtkXMLPolyDataWriter()
    reader.SetFileName(str(path))
    reader.Update()
    writer.SetFileName(str(path))
    writer.SetInputData(reader.GetOutput())
    way(writer)
    before = path.read_bytes()
    assert writer.Write()
    assert path.read_bytes() != before
    assert read_simvascular(path) == expected


def test_a_compressor_that_is_not_known(prediction, tmp_path):
    (path, *_) = write_vtp(prediction, tmp_path / "p.vtp")
    path.write_bytes(path.read_bytes().replace(b"vtkZLib", b"vtkLZ4"))
    with pytest.raises(FileError, match=r"compressor vtkLZ4DataCompressor is unknown.*zlib"):
        read_simvascular(path)


def field(array, name, *values):
    array.SetName(name)
    for value in values:
        array.InsertNextValue(value)
    return lambda data: data.GetFieldData().AddArray(array)


@pytest.mark.parametrize("ascii_", [True, False])
def test_field_data_that_say_nothing_of_the_vessel_are_skipped(vessel, tmp_path, ascii_):
    path = centerline(tmp_path / "a.vtp", vessel)
    edited(path, field(vtkBitArray(), "flags", 1, 0, 1), ascii_=ascii_)
    edited(path, field(vtkStringArray(), "period", "one second"), ascii_=ascii_)
    assert read_simvascular(path) == to_cases([vessel])
    text = path.read_bytes().replace(b'type="Bit"', b'type="Variant"')
    path.write_bytes(text)
    assert read_simvascular(path) == to_cases([vessel])


def test_a_compressor_that_is_not_used_does_not_matter(vessel, tmp_path):
    path = centerline(tmp_path / "a.vtp", vessel)
    edited(path, lambda data: None, "LZ4", ascii_=True)
    assert b"vtkLZ4DataCompressor" in path.read_bytes()
    np.testing.assert_allclose(read_simvascular(path).flow[0], vessel.flow)
    with pytest.raises(FileError, match="vtkLZ4DataCompressor is unknown"):
        read_simvascular(edited(path, lambda data: None, "LZ4"))
