"""Centerline files in every encoding that VTK writes."""

from __future__ import annotations

import numpy as np
import pytest
from io_helpers import centerline, edited
from vtkmodules.vtkCommonCore import vtkBitArray, vtkStringArray
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

from pcnde_bridge import FileError, InputError
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


def test_every_changed_letter_of_a_compressed_block_is_noticed(vessel, tmp_path):
    path = centerline(tmp_path / "v.vtp", vessel)
    content = path.read_bytes()
    whole = read_simvascular(path)
    start = content.index(b"<AppendedData") + 400
    changed = 0
    for place in range(start, len(content) - 60, 97):
        letter = b"A" if content[place : place + 1] != b"A" else b"B"
        path.write_bytes(content[:place] + letter + content[place + 1 :])
        try:
            changed += read_simvascular(path) != whole
        except (FileError, InputError):
            continue
    assert changed == 0


def test_capital_letters_in_names(vessel, tmp_path):
    path = centerline(tmp_path / "v.vtp", vessel)
    expected = read_simvascular(path)

    def capital(data):
        points = data.GetPointData()
        for i in range(points.GetNumberOfArrays()):
            name = points.GetArrayName(i)
            if name.startswith(("pressure_", "velocity_", "area_")):
                points.GetArray(i).SetName(name.capitalize())

    edited(path, capital)
    assert read_simvascular(path) == expected


def test_encodings_that_hide_entities_are_refused(vessel, tmp_path):
    path = edited(centerline(tmp_path / "v.vtp", vessel), lambda data: None, ascii_=True)
    text = path.read_text()
    hidden = '<!DOCTYPE VTKFile [<!ENTITY x "5">]>' + text.partition("?>")[2]
    mark = b'<!--<VTKFile type="PolyData"-->'.decode("utf-16-le", "replace")
    for encoding in ("utf-8", "utf-16"):
        head = f'<?xml version="1.0" encoding="{encoding}"?>'
        path.write_bytes((head + (mark if encoding == "utf-16" else "") + hidden).encode(encoding))
        with pytest.raises(FileError, match="defines XML entities, or is not UTF-8"):
            read_simvascular(path)
