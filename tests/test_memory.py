"""Peak memory of the readers on crafted files: at most 20 times the file and 300 MB."""

from __future__ import annotations

import gzip
import io
import lzma
import os
import struct
import subprocess
import sys
import zipfile
import zlib

import h5py
import numpy as np
import pytest

ROWS = b"time,z,flow,area,pressure,area_undeformed\n"
NAMES = ("flow", "area", "pressure")


def vtp(n, count, kind="Float64", *, packed=True):
    """A .vtp file with ``count`` arrays of zeros at ``n`` points, in raw appended blocks."""
    blocks, items = b"", []
    for i, (dtype, components) in enumerate([("Float64", 3), *[(kind, 1)] * count]):
        raw = bytes(n * components * {"Float64": 8, "Float32": 4, "UInt8": 1}[dtype])
        block = zlib.compress(raw, 9)
        block = struct.pack("<4Q", 1, len(raw), 0, len(block)) + block
        name = f'Name="pressure_{i}" NumberOfComponents="{components}" offset="{len(blocks)}"'
        items.append(f'<DataArray type="{dtype}" {name} format="appended"/>')
        blocks += block if packed else struct.pack("<Q", len(raw)) + raw
    compressor = 'compressor="vtkZLibDataCompressor"' if packed else ""
    head = f"""<VTKFile type="PolyData" header_type="UInt64" {compressor}><PolyData>
<Piece NumberOfPoints="{n}"><Points>{items[0]}</Points><PointData>{"".join(items[1:])}</PointData>
</Piece></PolyData><AppendedData encoding="raw">_"""
    return head.encode() + blocks + b"</AppendedData></VTKFile>"


def ascii_vtp(n, count):
    items = [
        f'<DataArray type="UInt8" Name="a{i}" format="ascii">{"0 " * n}</DataArray>'
        for i in range(count)
    ]
    points = '<Points><DataArray type="UInt8" NumberOfComponents="3" format="ascii">'
    return (
        f'<VTKFile type="PolyData"><PolyData><Piece NumberOfPoints="{n}"><PointData>'
        f"{''.join(items)}</PointData>{points}{'0 ' * 3 * n}</DataArray></Points></Piece>"
        "</PolyData></VTKFile>"
    ).encode()


def npz(shape, dtype, header):
    """An archive with three arrays of zeros, and a header or the format of a data set."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        facts = {"header": f'{{"format": "{header}", "format_version": 1}}'}
        if header == "pcnde-cases":
            facts = {"format": header, "format_version": 1, "fingerprint": "0", "period": 1.0}
            facts |= {"time": np.arange(float(shape[1])), "z": np.arange(float(shape[2]))}
            facts |= {"area_undeformed": np.ones((shape[0], shape[2]))}
        for name, value in facts.items():
            with archive.open(f"{name}.npy", "w") as member:
                np.save(member, np.array(value))
        for name in NAMES:
            with archive.open(f"{name}.npy", "w") as member:
                np.save(member, np.zeros(shape, dtype))
    return file.getvalue()


def hdf5(shape, dtype, chunks, **text):
    file = io.BytesIO()
    with h5py.File(file, "w") as group:
        for name in NAMES:
            group.create_dataset(name, shape, dtype, chunks=chunks, compression="gzip")[0] = 1
        group["time"], group["z"] = np.arange(float(shape[1])), np.arange(float(shape[2]))
        group["area_undeformed"] = np.ones((shape[0], shape[2]))
        for name, values in text.items():
            group.create_dataset(f"labels/{name}", data=values, dtype=h5py.string_dtype())
    return file.getvalue()


def pvd(n):
    sets = (f'<DataSet timestep="{i}" file="part.vtp"/>' for i in range(n))
    return f"<VTKFile><Collection>{''.join(sets)}</Collection></VTKFile>".encode()


SV1D = "MODEL m_\nSOLVEROPTIONS 0.001 1 399999 2\n" + (
    "SEGMENT S0 0 4.0 {} 0 1 .1 .1 0.0 MAT1 NONE 0.0 0 0 NOBOUND NONE\n"
)
FILES = {
    "packed.vtp": lambda: vtp(30_000, 60),
    "bomb.vtp": lambda: vtp(100_000, 200),
    "bytes.vtp": lambda: vtp(100_000, 60, "UInt8", packed=False),
    "singles.vtp": lambda: vtp(100_000, 60, "Float32", packed=False),
    "ascii.vtp": lambda: ascii_vtp(20_000, 200),
    "nested.vtp": lambda: b"<VTKFile>" + b"<a>" * 3_000_000,
    "one file again and again.pvd": lambda: pvd(100),
    "zeros.csv.gz": lambda: gzip.compress(ROWS + b"0,0,0,0,0,0\n" * 2_000_000),
    "blank.csv.gz": lambda: gzip.compress(ROWS + b",,,,,\n" * 4_000_000),
    "blank.csv.xz": lambda: lzma.compress(ROWS + b",,,,,\n" * 4_000_000),
    "labels.csv.gz": lambda: gzip.compress(
        ROWS[:-1] + b",a\n" + b"".join(b",,,,,,%d\n" % i for i in range(1_800_000))
    ),
    "labels.csv": lambda: (
        ROWS[:-1] + b",a\n" + b"".join(b"0,0,1,1,1,1,%d\n" % i for i in range(500_000))
    ),
    "columns.csv": lambda: b"," * 5_000_000,
    "inflow.csv.gz": lambda: gzip.compress(b"t,Q\n" + b"0,0\n" * 6_000_000),
    "inflow.dat": lambda: b"".join(b"%d 1\n" % i for i in range(1_000_000)),
    "cases.npz": lambda: npz((1, 2800, 2800), "i1", "pcnde-cases"),
    "model.npz": lambda: npz((1, 2800, 2800), "i1", "pcnde-model"),
    "checkpoint.npz": lambda: npz((1, 1000, 1000), "f8", "pcnde-checkpoint"),
    "bomb.npz": lambda: npz((1, 9000, 3000), "f8", "pcnde-cases"),
    "packed.h5": lambda: hdf5((1, 1000, 900), "i1", (1, 1000, 900)),
    "bomb.h5": lambda: hdf5((300, 1000, 1000), "f8", (1, 100, 1000)),
    "a long text.h5": lambda: hdf5((1, 4, 3), "f8", None, a=["a"] * 999 + ["b" * 2_000_000]),
    "elements.in": lambda: SV1D.format(900_000_000).encode(),
    "table.in": lambda: SV1D.format(19).encode(),
}

CHILD = """
import resource, sys
from pathlib import Path
from pcnde_bridge import PCNDEError, load_cases, load_model
from pcnde_bridge._utils.archive import read_archive
from pcnde_bridge.io import read_csv, read_hdf5, read_simvascular, read_sv1d
from pcnde_bridge.io.input_tables import read_cycle
import h5py, scipy.interpolate, scipy.signal, xml.etree.ElementTree
path = Path(sys.argv[1])
readers = {".vtp": read_simvascular, ".pvd": read_simvascular, ".npz": load_cases,
           ".h5": read_hdf5, ".in": lambda path: read_sv1d(path, period=1.0)}
named = {"inflow": lambda path: read_cycle(path, 0.0, 1.0), "model": load_model,
         "checkpoint": lambda path: read_archive(path, "pcnde-checkpoint", 1, "checkpoint")}
read = named.get(path.name.split(".")[0]) or readers.get(path.suffix, read_csv)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    read(path)
except PCNDEError as error:
    print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss has other units")
@pytest.mark.parametrize("name", FILES)
def test_peak_memory(name, tmp_path):
    path = tmp_path / name
    path.write_bytes(FILES[name]())
    (tmp_path / "part.vtp").write_bytes(vtp(30_000, 60))
    if name == "table.in":
        for variable in NAMES:
            (tmp_path / f"m_S0_{variable}.dat").write_bytes((b"1 " * 400_000 + b"\n") * 20)
    stored = sum(
        file.stat().st_size for file in tmp_path.iterdir() if name == "table.in" or file == path
    )
    environment = {**os.environ, "MALLOC_ARENA_MAX": "1"}
    command = [sys.executable, "-c", CHILD, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, env=environment)
    assert done.returncode == 0, done.stderr
    assert 1024 * int(done.stdout.splitlines()[-1]) <= 20 * stored + 300e6, done.stdout[-300:]
