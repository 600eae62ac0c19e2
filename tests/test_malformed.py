"""Malformed input of every kind: one table, run through Python and the command line.

Each row damages one good file.  Reading it must raise the right exception of our family with
a message that says why; the command line must print that message, no traceback, and end
with code 2; and nothing may be written or overwritten.
"""

from __future__ import annotations

import gzip
import io
import json
import re
import shutil
import struct
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

from pcnde_bridge import (
    PCNDE,
    Cases,
    DataNotFoundError,
    FileError,
    InputError,
    PCNDEConfig,
    PCNDEError,
)
from pcnde_bridge._utils.archive import read_archive, sha256_arrays, write_archive
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.io import (
    read_csv,
    read_hdf5,
    read_simvascular,
    read_sv1d,
    write_vtp,
)
from pcnde_bridge.io.datasets import load_cases
from pcnde_bridge.io.input_tables import read_columns
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.model.published_weights import FILES as WEIGHTS
from pcnde_bridge.model.published_weights import read_published_weights
from pcnde_bridge.training.trainer import Trainer, staged_training

FIELDS = ("flow", "area", "pressure")
REFUSED = FileError, InputError


# ---- good files ------------------------------------------------------------------


@pytest.fixture(scope="session")
def good(tmp_path_factory, small_cases, small_config):
    """Good files of every kind, none of which needs training."""
    folder = tmp_path_factory.mktemp("good")
    few = small_cases.select([0, 1, 5])
    few.save(folder / "cases.npz")
    few.save(folder / "cases.h5")
    with h5py.File(folder / "foreign.h5", "w") as file:  # the older kind, without checksums
        for name in (*FIELDS, "area_undeformed", "time", "z"):
            file.create_dataset(name, data=getattr(few, name), compression="gzip")
        file["labels/geometry"], file["labels/waveform"] = [1, 1, 2], [0, 1, 0]
        file["labels/patient"] = ["a", "b", "c"]
    engine = select_engine("jax")
    grid = few.grid
    parameters = initial_parameters(small_config, few.n_times, few.n_points, 0)
    PCNDE(small_config, parameters, grid, engine).save(folder / "model.npz")
    Trainer(staged_training(few, small_config, engine), folder / "run.checkpoint").start(0)
    (folder / "config.json").write_text(json.dumps(small_config.to_dict()))
    (folder / "split.json").write_text('{"train": [[1, 0], [1, 1]], "test": [[2, 1]]}')
    for name, axis, values in (
        ("inflow.csv", "time", few.inflow),
        ("area.csv", "z", few.area_undeformed),
    ):
        columns = {f"case {i}": row for i, row in enumerate(values)}
        pd.DataFrame({axis: getattr(few, axis), **columns}).to_csv(folder / name, index=False)
    arrays = (getattr(few, name) for name in (*FIELDS, "area_undeformed", "time", "z"))
    prediction = Prediction(*arrays, period=1.0, labels=few.labels)
    prediction.to_frame().to_csv(folder / "tidy.csv", index=False)
    write_vtp(replace_cases(prediction, 1), folder / "centerline.vtp")
    _write_sv1d(folder, few)
    rng = np.random.default_rng(0)
    undeformed = np.broadcast_to(rng.uniform(0.08, 0.12, size=101), (100, 101))
    one = np.ones((100, 101))
    case = np.stack([one, 1e5 * undeformed, undeformed, 1.05 * undeformed, one, 9 * one])
    (folder / "authors" / "case_1_0").mkdir(parents=True)
    np.save(folder / "authors" / "case_1_0" / "averagedTo1DFrom0_case_1_0.npy", case)
    (folder / "weights").mkdir()
    for stage, size in (("flow", 2724), ("intermediate_area", 202), ("fourier_area", 202)):
        with h5py.File(folder / "weights" / WEIGHTS[stage], "w") as file:
            file["p"] = np.zeros(size, dtype=np.float32)
    return folder


def replace_cases(prediction, n):
    fields = [getattr(prediction, name)[:n] for name in (*FIELDS, "area_undeformed")]
    return Prediction(
        *fields, prediction.time, prediction.z, prediction.period, prediction.labels.iloc[:n]
    )


def _write_sv1d(folder, cases):
    (folder / "sv1d").mkdir()
    ends = cases.area_undeformed[0, [0, -1]]
    text = f"""MODEL m_
SEGMENT S0 0 4.0 20 0 1 {ends[0]} {ends[1]} 0.0 MAT1 NONE 0.0 0 0 NOBOUND NONE
SOLVEROPTIONS 0.05 1 19 2 INFLOW FLOW 1e-6 1 1
"""
    (folder / "sv1d" / "solver.in").write_text(text)
    for name in FIELDS:
        np.savetxt(folder / "sv1d" / f"m_S0_{name}.dat", getattr(cases, name)[0].T)


# ---- how each kind is read -----------------------------------------------------------


class Reader(NamedTuple):
    """A kind of file: where the good one lies, and how Python and ``pcnde`` read it."""

    file: str
    api: Callable[[Path], object]
    cli: Callable[[Path, Path], list[object]] | None


def _fit(*, data=None, **options):
    """Arguments of ``pcnde fit`` with the damaged file in one place."""

    def arguments(bad, out):
        flags = [part for name, value in options.items() for part in (f"--{name}", value or bad)]
        return ["fit", data or bad, "--out", out, "--engine", "jax", *flags]

    return arguments


def _predict(bad, out, **given):
    paths = {"model": bad, "inflow": bad, "area": bad, **given}
    inputs = ["--inflow", paths["inflow"], "--area", paths["area"]]
    return ["predict", paths["model"], *inputs, "--out", out, "--engine", "jax"]


@pytest.fixture(scope="session")
def readers(good, small_cases, small_config) -> dict[str, Reader]:
    few = small_cases.select([0, 1, 5])
    cases, config = good / "cases.npz", good / "config.json"
    fitted = partial(_predict, model=good / "model.npz")
    inputs = {"inflow": good / "inflow.csv", "area": good / "area.csv"}

    def convert(source, *options):
        return lambda bad, out: ["convert", bad, "--from", source, *options, "--out", out]

    def resume(path):
        return PCNDE.fit(few, small_config, "jax", 0, path, progress=False)

    return {
        "cases.npz": Reader("cases.npz", load_cases, _fit(split="none")),
        "cases.h5": Reader("cases.h5", load_cases, _fit(split="none")),
        "authors": Reader("authors", load_cases, _fit(split="none")),
        "split": Reader("split.json", few.split, _fit(data=cases, split=None)),
        "config": Reader(
            "config.json",
            lambda path: PCNDEConfig.from_json(path.read_text("utf-8", "surrogateescape")),
            _fit(data=cases, split="none", config=None),
        ),
        "checkpoint": Reader(
            "run.checkpoint", resume,
            _fit(data=cases, split="none", config=config, checkpoint=None),
        ),
        "model": Reader(
            "model.npz", partial(PCNDE.load, engine="jax"), partial(_predict, **inputs)
        ),
        "inflow": Reader(
            "inflow.csv", lambda path: read_columns(path, "time", few.time),
            partial(fitted, area=inputs["area"]),
        ),
        "area": Reader(
            "area.csv", lambda path: read_columns(path, "z", few.z),
            partial(fitted, inflow=inputs["inflow"]),
        ),
        "vtp": Reader("centerline.vtp", read_simvascular, convert("simvascular")),
        "sv1d": Reader(
            "sv1d", lambda path: read_sv1d(path / "solver.in", period=1.0),
            lambda bad, out: convert("sv1d", "--period", 1)(bad / "solver.in", out),
        ),
        "csv": Reader("tidy.csv", read_csv, convert("csv")),
        "hdf5": Reader("cases.h5", read_hdf5, convert("hdf5")),
        "foreign hdf5": Reader("foreign.h5", read_hdf5, None),
        "weights": Reader("weights", read_published_weights, None),
    }  # fmt: skip


# ---- ways to damage -------------------------------------------------------------------


def replaced_by(content):
    """Replace the whole content."""
    raw = content if isinstance(content, bytes) else content.encode()
    return lambda path: path.write_bytes(raw)


def cut(part):
    return lambda path: path.write_bytes(path.read_bytes()[: int(part * path.stat().st_size)])


def swapped(old, new, count=1):
    """Replace some bytes."""
    old, new = (text.encode() if isinstance(text, str) else text for text in (old, new))

    def damage(path):
        whole = path.read_bytes()
        assert old in whole
        path.write_bytes(whole.replace(old, new, count))

    return damage


def inside(name, damage):
    """Apply the damage to a file in a folder."""
    return lambda folder: damage(folder / name)


def folder_instead(path):
    path.unlink()
    path.mkdir()


def npz(**changes):
    """Other arrays in an ``.npz``: a function of the old one, a new one, or None for none."""

    def damage(path):
        with np.load(path) as archive:
            arrays = dict(archive)
        for name, change in changes.items():
            arrays[name] = change(arrays[name]) if callable(change) else change
        with path.open("wb") as handle:
            np.savez(handle, **{name: a for name, a in arrays.items() if a is not None})

    return damage


def h5(change):
    def damage(path):
        with h5py.File(path, "r+") as file:
            change(file)

    return damage


def put(file, name, values):
    del file[name]
    file[name] = values


def claims(file, name="flow"):
    """A data set of 8 TB that holds nothing."""
    del file[name]
    file.create_dataset(name, (1 << 20, 1 << 20), "f8", chunks=(1 << 10, 1))


def elsewhere(file, name="flow"):
    del file[name]
    file[name] = h5py.ExternalLink("/etc/hostname", "/flow")


def raw_elsewhere(file, name="flow"):
    shape = file[name].shape
    del file[name]
    file.create_dataset(name, shape, "f8", external=[("/etc/hostname", 0, h5py.h5f.UNLIMITED)])


def archive(change):
    """Facts and arrays of a model or checkpoint, changed; whole again otherwise."""

    def damage(path):
        kind = "pcnde-model" if path.name == "model.npz" else "pcnde-checkpoint"
        facts, arrays = read_archive(path, kind, 99, "file")
        version = facts.pop("format_version")
        del facts["format"]
        made = change(facts, arrays) or {}
        write_archive(path, made.get("kind", kind), made.get("version", version), facts, arrays)

    return damage


def member(name, content=b"", claimed=None, compressed=False):
    """One more member in a zip archive, by any name; zeros of the claimed size."""

    def damage(path):
        how = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
        with (
            zipfile.ZipFile(path, "a", how, compresslevel=1) as file,
            file.open(name, "w", force_zip64=True) as out,
        ):
            out.write(content)
            block = bytes(1 << 20)
            for _ in range((claimed or 0) >> 20):
                out.write(block)

    return damage


def vtp(change):
    """Another array of branches."""

    def damage(path):
        reader, writer = vtkXMLPolyDataReader(), vtkXMLPolyDataWriter()
        for each in (reader, writer):
            each.SetFileName(str(path))
        reader.Update()
        change(reader.GetOutput().GetPointData().GetArray("BranchId"))
        writer.SetInputData(reader.GetOutput())
        writer.Write()

    return damage


def npy_header(shape, descr="<f8"):
    buffer = io.BytesIO()
    facts = {"descr": descr, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, facts)
    return buffer.getvalue()


def table(change):
    def damage(path):
        change(pd.read_csv(path)).to_csv(path, index=False)

    return damage


def scaled(column, factor):
    return table(lambda frame: frame.assign(**{column: factor * frame[column]}))


NPY = "case_1_0/averagedTo1DFrom0_case_1_0.npy"
BOMB = 300 << 20
DEEP = "[" * 100_000
LAUGHS = (
    '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY x "ha"><!ENTITY y "&x;&x;">]>'
    '<VTKFile type="PolyData">&y;</VTKFile>'
)

# (kind of file, defect, function that creates it, exception, message)
TABLE = [
    # ---- data sets
    ("cases.npz", "empty", replaced_by(b""), FileError, r"is not an \.npz file that Cas"),
    ("cases.npz", "a text", replaced_by("time,flow\n0,1\n"), FileError,
     r"is not an \.npz file that Cases"),
    ("cases.npz", "a pickle", replaced_by(b"\x80\x04K\x01."), FileError,
     r"is not an \.npz file that Cases"),
    ("cases.npz", "half", cut(0.5), FileError, "truncated or damaged"),
    ("cases.npz", "a folder", folder_instead, DataNotFoundError, "holds no folders named case_G_W"),
    ("cases.npz", "no flow", npz(flow=None), FileError, "incomplete: it lacks flow"),
    ("cases.npz", "NaN", npz(flow=lambda a: a * np.nan), FileError, r"flow\[0, 0, 0\] is nan"),
    ("cases.npz", "inf", npz(pressure=lambda a: a + np.inf), FileError, r"\] is inf"),
    ("cases.npz", "negative area", npz(area=lambda a: -a), FileError, "areas must be positive"),
    (
        "cases.npz", "axes swapped", npz(flow=lambda a: a.transpose(0, 2, 1)), FileError,
        r"looks like \(case, z, time\): pass np\.transpose",
    ),
    ("cases.npz", "one axis less", npz(area=lambda a: a[0]),
     FileError, r"pass area\[np\.newaxis\]"),
    ("cases.npz", "no cases", npz(area_undeformed=lambda a: a[:0]), FileError, "there is no case"),
    ("cases.npz", "text for numbers", npz(z=lambda a: a.astype(str)), FileError, "real numbers"),
    ("cases.npz", "z falls", npz(z=lambda a: a[::-1]), FileError, "strictly increasing"),
    ("cases.npz", "uneven time", npz(time=lambda a: a**2), FileError, "uniform steps"),
    ("cases.npz", "period of 20 ms", npz(period=0.02), FileError, "time must cover one period"),
    (
        "cases.npz", "end point twice", npz(
            time=np.arange(21) / 20,
            **{name: lambda a: np.concatenate([a, a[:, :1]], 1) for name in FIELDS},
        ), FileError, "the last time point repeats the first",
    ),
    ("cases.npz", "blockage in %", npz(**{"labels/blockage": lambda a: 100 * a}), FileError,
     "blockage is a fraction"),
    ("cases.npz", "a case twice", npz(**{"labels/waveform": lambda a: 0 * a}), FileError,
     "give each case its own pair"),
    ("cases.npz", "changed by hand", npz(flow=lambda a: a + 1e-9), FileError, "was changed after"),
    ("cases.npz", "objects", npz(flow=np.array([{}], dtype=object)), FileError, "damaged"),
    ("cases.npz", "of the future", npz(format_version=99), FileError, "newer pcnde_bridge"),
    ("cases.npz", "of someone else", npz(format="x"), FileError,
     "not a pcnde_bridge data set"),
    ("cases.npz", "zip bomb", member("bomb.npy", claimed=BOMB, compressed=True), FileError,
     "it claims 3.* bytes in a file of"),
    ("cases.npz", "path traversal", member("../evil.npy", npy_header((0,))), FileError,
     r"member '\.\./evil\.npy' leads out of it"),
    ("cases.npz", "absolute path", member("/tmp/evil.npy", npy_header((0,))), FileError,
     "leads out of it"),
    ("cases.npz", "claims 8 PB", member("huge.npy", npy_header((1 << 50,))), FileError, "damaged"),
    ("cases.npz", "of someone else, no format", npz(format=None), FileError,
     "not a pcnde_bridge data set"),
    ("cases.npz", "no period", npz(period=None, fingerprint=None), FileError,
     "incomplete: it lacks period, fingerprint"),
    ("cases.npz", "two periods", npz(period=np.ones(2)), FileError, "data that are not usable"),
    ("cases.npz", "no waveforms", npz(**{"labels/waveform": None}), FileError,
     "labels lacks the column 'waveform'"),
    ("cases.h5", "empty", replaced_by(b""), FileError, "is not an HDF5 file that Cases"),
    ("cases.h5", "an .npz", replaced_by(b"PK\x03\x04"), FileError,
     "is not an HDF5 file that Cases"),
    ("cases.h5", "half", cut(0.5), FileError, "truncated or damaged"),
    ("cases.h5", "no labels", h5(lambda f: f.pop("labels")), FileError, "truncated or damaged"),
    ("cases.h5", "negative area", h5(lambda f: put(f, "area_undeformed", -np.ones((3, 21)))),
     FileError, "areas must be positive"),
    ("cases.h5", "flow of text", h5(lambda f: put(f, "flow", "12")), FileError, "real numbers"),
    ("cases.h5", "claims 8 TB", h5(claims), FileError, r"it claims 87960930\d+ bytes"),
    ("cases.h5", "link to another file", h5(elsewhere), FileError, "is stored in another file"),
    ("cases.h5", "bytes of another file", h5(raw_elsewhere), FileError, "stored in another file"),
    # ---- the authors' files
    ("authors", "no cases", lambda p: (p / NPY).parent.rename(p / "case"), DataNotFoundError,
     "holds no folders named case_G_W"),
    ("authors", "file missing", inside(NPY, Path.unlink), FileError, "There is no file"),
    ("authors", "half", inside(NPY, cut(0.5)), FileError, "truncated or damaged"),
    ("authors", "a text", inside(NPY, replaced_by("1 2 3")), FileError, "truncated or damaged"),
    ("authors", "claims 8 PB", inside(NPY, replaced_by(npy_header((1 << 50,)))), FileError,
     "truncated or damaged"),
    ("authors", "huge header", inside(
        NPY, replaced_by(b"\x93NUMPY\x02\x00" + struct.pack("<I", 1 << 30) + b" " * 100)
     ), FileError, "truncated or damaged"),
    ("authors", "objects", inside(NPY, lambda p: np.save(p, np.array([{}]), allow_pickle=True)),
     FileError, "truncated or damaged"),
    ("authors", "wrong shape", inside(NPY, lambda p: np.save(p, np.ones((6, 101, 100)))),
     FileError, r"\(6, 101, 100\) instead of float64 \(6, 100, 101\)"),
    ("authors", "NaN", inside(NPY, lambda p: np.save(p, np.load(p) * np.nan)), FileError, "is nan"),
    # ---- split and settings
    ("split", "missing", Path.unlink, DataNotFoundError, "no split file"),
    ("split", "empty", replaced_by(""), FileError, "not a readable JSON file"),
    ("split", "half", cut(0.5), FileError, "not a readable JSON file"),
    ("split", "too deep", replaced_by(DEEP), FileError, "not a readable JSON file"),
    ("split", "not UTF-8", replaced_by(b"\xff\xfe{"), FileError, "not a readable JSON file"),
    ("split", "a list", replaced_by("[1]"), InputError, "must hold"),
    ("split", "no test", replaced_by('{"train": [[1, 0]]}'), InputError, "has no 'test'"),
    ("split", "empty test", replaced_by('{"train": [[1, 0]], "test": []}'),
     InputError, "non-empty"),
    ("split", "in both", replaced_by('{"train": [[1, 0]], "test": [[1, 0]]}'), InputError,
     "in both 'train' and 'test'"),
    ("split", "unknown case", replaced_by('{"train": [[1, 0]], "test": [[9, 9]]}'), InputError,
     "not in this data set"),
    ("split", "fractions", replaced_by('{"train": [[1.5, 0]], "test": [[1, 0]]}'), InputError,
     "two whole numbers"),
    ("config", "half", cut(0.5), REFUSED, "settings|not JSON"),
    ("config", "too deep", replaced_by(DEEP), REFUSED, "settings|not JSON"),
    ("config", "a list", replaced_by("[]"), InputError, "mapping of groups|JSON object"),
    ("config", "unknown name", replaced_by('{"flows": {}}'), InputError, "no setting 'flows'"),
    ("config", "no such setting: self", replaced_by('{"self": {}}'), InputError,
     "no setting 'self'"),
    ("config", "a number for a group", replaced_by('{"flow": 3}'), InputError,
     r"PCNDEConfig\.flow must be"),
    ("config", "not UTF-8", replaced_by(b"\xff\xfe\x00"), REFUSED, "settings|not JSON"),
    ("config", "negative", replaced_by('{"flow": {"epochs": -1}}'), InputError, "must be positive"),
    ("config", "infinite", replaced_by('{"flow": {"rtol": 1e999}}'), InputError, "be finite"),
    ("config", "a number's text", replaced_by('{"batch_size": "12"}'), InputError, "must be int"),
    ("config", "a huge number", replaced_by('{"flow": {"rtol": 1' + "0" * 400 + "}}"), InputError,
     "must be finite"),
    # ---- model and checkpoint
    ("model", "missing", Path.unlink, DataNotFoundError, "There is no file"),
    ("model", "a folder", folder_instead, FileError, "is a folder, not a pcnde_bridge model"),
    ("model", "empty", replaced_by(b""), FileError, "truncated or damaged"),
    ("model", "half", cut(0.5), FileError, "is truncated or damaged"),
    ("model", "a checkpoint", archive(lambda f, a: {"kind": "pcnde-checkpoint"}), FileError,
     "not a pcnde_bridge model but a 'pcnde-checkpoint' file"),
    ("model", "of the future", archive(lambda f, a: {"version": 99}), FileError, "newer pcnde_br"),
    ("model", "no settings", archive(lambda f, a: f.pop("config") and None), FileError,
     "is not a complete model"),
    ("model", "no time", archive(lambda f, a: a.pop("time") is None), FileError,
     "is not a complete model"),
    ("model", "fewer weights", archive(lambda f, a: a.update(flow=a["flow"][:-1])), FileError,
     "is not a complete model"),
    ("model", "NaN weights", archive(lambda f, a: a.update(flow=a["flow"] * np.nan)), FileError,
     "is not a complete model"),
    ("model", "zip bomb", member("bomb.npy", claimed=BOMB, compressed=True), FileError,
     "it claims 3.* bytes in a file of"),
    ("model", "path traversal", member("../../evil.npy", npy_header((0,))), FileError,
     "leads out of it"),
    ("model", "claims 8 PB", member("huge.npy", npy_header((1 << 50,))),
     FileError, "damaged|trunc"),
    ("checkpoint", "a text", replaced_by("hello"), FileError, "not a pcnde_bridge checkpoint"),
    ("checkpoint", "half", cut(0.5), FileError, "checkpoint"),
    ("checkpoint", "of another seed", archive(lambda f, a: f.update(seed=7)), InputError,
     "run with seed 7, not 0"),
    ("checkpoint", "of other cases", archive(lambda f, a: f.update(cases="0" * 64)), InputError,
     "belongs to a run on other cases"),
    ("checkpoint", "no batches", archive(lambda f, a: a.pop("batches") is None), FileError,
     "is not a complete checkpoint"),
    ("checkpoint", "zip bomb", member("bomb.npy", claimed=BOMB, compressed=True), FileError,
     "it claims 3.* bytes in a file of"),
    # ---- inputs of a prediction
    ("inflow", "missing", Path.unlink, DataNotFoundError, "There is no file"),
    ("inflow", "empty", replaced_by(""), FileError, "is not a table"),
    ("inflow", "a picture", replaced_by(b"\x89PNG\r\n\x1a\n\x00\x00\xff\xfe"), FileError,
     "is not a table"),
    ("inflow", "an open quote", replaced_by('time,a\n0,"1\n'), REFUSED, "inflow.csv"),
    ("inflow", "a short cycle", table(lambda f: f[:-3]), InputError, "has 17 rows"),
    ("inflow", "end point twice", table(lambda f: pd.concat([f, f[:1].assign(time=1.0)])),
     InputError, "the cycle's end repeats its start: leave it out"),
    ("inflow", "in ms", scaled("time", 1e3), InputError, "looks like ms: pass --units time=ms"),
    ("inflow", "a gap", table(lambda f: f.assign(**{"case 1": [np.nan] * 3 + [1.0] * 17})),
     InputError, "line 2, column case 1: not a number"),
    ("area", "words", table(lambda f: f.assign(**{"case 0": "wide"})), InputError, "not a number"),
    ("area", "z in mm", scaled("z", 10), InputError, "looks like mm: pass --units z=mm"),
    ("area", "time for z", swapped("z,", "time,"), InputError, "must have the columns z"),
    # ---- centerlines
    ("vtp", "missing", Path.unlink, DataNotFoundError, "There is no file"),
    ("vtp", "a folder", folder_instead, FileError, "is a folder"),
    ("vtp", "empty", replaced_by(b""), FileError, r"is not a \.vtp file"),
    ("vtp", "a mesh", swapped("PolyData", "UnstructuredGrid", -1), FileError, "is not a .vtp file"),
    ("vtp", "half", cut(0.5), FileError, "truncated or damaged"),
    ("vtp", "entities", replaced_by(LAUGHS), FileError, "defines XML entities"),
    ("vtp", "claims 10^15 points", swapped('Points="21"', 'Points="999999999999999"'),
     FileError, "values for 999999999999999 points"),
    ("vtp", "-1 points", swapped('NumberOfPoints="21"', 'NumberOfPoints="-1"'),
     FileError, "damaged"),
    ("vtp", "no pressure", swapped('Name="pressure_', 'Name="pressur3_', -1), InputError,
     "no pressure_<time step>"),
    ("vtp", "one step without flow", swapped('Name="flow_0.5"', 'Name="flow_x.x"'), InputError,
     r"no flow_0\.5 .*\(19 of 20 time steps have flow"),
    ("vtp", "two branches", vtp(lambda ids: ids.SetValue(20, 1)), InputError,
     r"has the branches \[0, 1\]: choose one"),
    ("vtp", "no branch", vtp(lambda ids: ids.Fill(-1)), InputError, r"has the branches \[\]"),
    # ---- svOneDSolver
    ("sv1d", "no input file", inside("solver.in", Path.unlink), DataNotFoundError, "no file"),
    ("sv1d", "input of someone else", inside("solver.in", replaced_by("a b c")), FileError,
     "not an input file of svOneDSolver"),
    ("sv1d", "half a segment", inside("solver.in", swapped(" 4.0 20", " 4.0")), FileError,
     "line 2, 'SEGMENT .*elements and areas must be pos"),
    ("sv1d", "no elements", inside("solver.in", swapped(" 4.0 20", " 4.0 0")), FileError, "line 2"),
    ("sv1d", "path traversal", inside("solver.in", swapped("m_", "../m_")), FileError,
     "leads out of the file's folder"),
    ("sv1d", "time step 0", inside("solver.in", swapped("S 0.05", "S 0.00")),
     FileError, "with steps above 0"),
    ("sv1d", "no flow", inside("m_S0_flow.dat", Path.unlink), DataNotFoundError, "run the solver"),
    ("sv1d", "ragged", inside("m_S0_area.dat", cut(0.9)), FileError, "rows|not a table of numbers"),
    ("sv1d", "binary", inside("m_S0_area.dat", replaced_by(b"\x00\xff\x01")),
     FileError, "not a table"),
    ("sv1d", "NaN", inside("m_S0_pressure.dat", lambda p: np.savetxt(p, np.full((21, 20), np.nan))),
     InputError, r"pressure\[0, 0, 0\] is nan: all values must be finite"),
    ("sv1d", "flow out of the inlet", inside(
        "m_S0_flow.dat", lambda p: np.savetxt(p, -np.loadtxt(p))), InputError, "--flip flow"),
    ("sv1d", "mmHg", inside("m_S0_pressure.dat", lambda p: np.savetxt(p, np.loadtxt(p) / 1333.22)),
     InputError, "--units pressure=mmHg"),
    # ---- tidy tables
    ("csv", "missing", Path.unlink, DataNotFoundError, "There is no file"),
    ("csv", "a folder", folder_instead, FileError, "is a folder, not a table"),
    ("csv", "binary", replaced_by(bytes(range(256)) * 9), FileError, "is not a table"),
    ("csv", "no pressure", table(lambda f: f.drop(columns="pressure")),
     InputError, "lacks the colu"),
    ("csv", "a row less", table(lambda f: f[:-1]), InputError, "give each once"),
    ("csv", "a row twice", table(lambda f: pd.concat([f, f[:1]])), InputError, "once"),
    ("csv", "negative area", scaled("area", -1), InputError, "areas must be positive"),
    ("csv", "z off by 1000", scaled("z", 1e3), InputError, "does not look like CGS"),
    ("csv", "pressure in Pa", scaled("pressure", 0.1), InputError, "--units pressure=Pa"),
    ("csv", "flow in mm³/s", scaled("flow", 1e3), InputError, r"--units flow=mm\^3/s"),
    ("csv", "time in ms", scaled("time", 1e3), InputError, "--units time=ms"),
    ("csv", "a label gone", table(lambda f: f.assign(geometry=None)),
     InputError, "label is missing"),
    # ---- HDF5 of others
    ("hdf5", "empty", replaced_by(b""), FileError, "not an HDF5 file, or it is trunc"),
    ("hdf5", "half", cut(0.5), FileError, "not an HDF5 file, or it is trunc"),
    ("hdf5", "no flow", h5(lambda f: f.pop("flow")), InputError, r"lacks the data sets \['flow'\]"),
    ("hdf5", "transposed", h5(lambda f: put(f, "flow", f["flow"][()].transpose(0, 2, 1))),
     InputError,
     r"looks like \(case, z, time\)"),
    ("hdf5", "text", h5(lambda f: put(f, "flow", "x")), InputError, "not numbers"),
    ("hdf5", "in furlongs", h5(lambda f: f["z"].attrs.update(units="furlong")), InputError,
     "unknown unit 'furlong'"),
    ("hdf5", "claims 8 TB", h5(claims), FileError, r"it claims 87960930\d+ bytes"),
    ("hdf5", "link to another file", h5(elsewhere), FileError, "is stored in another file"),
    # ---- published weights: no command reads them
    ("weights", "missing", inside(WEIGHTS["flow"], Path.unlink),
     DataNotFoundError, "There is no file .*ptr"),
    ("weights", "a text", inside(WEIGHTS["flow"], replaced_by("p")),
     FileError, "not a file of the authors' publi"),
    ("weights", "half", inside(WEIGHTS["flow"], cut(0.5)),
     FileError, "not a file of the authors' published"),
    ("weights", "no p", inside(WEIGHTS["flow"], h5(lambda f: f.pop("p"))), FileError, "weights"),
    ("weights", "too few", inside(WEIGHTS["flow"], h5(lambda f: put(f, "p", np.ones(7)))),
     FileError,
     "should hold 2724 finite numbers"),
    ("weights", "NaN", inside(WEIGHTS["flow"], h5(lambda f: put(f, "p", np.full(2724, np.nan)))),
     FileError, "finite numbers"),
    ("weights", "claims 8 TB", inside(WEIGHTS["flow"], h5(partial(claims, name="p"))), FileError,
     "it claims"),
]  # fmt: skip


def test_the_table_lists_each_input_once():
    names = [(kind, what) for kind, what, *_ in TABLE]
    assert len(names) == len(set(names)) >= 60


def test_the_good_files_are_good(readers, good):
    """Otherwise a row could be rejected for another reason than its defect."""
    for kind, reader in readers.items():
        if kind != "checkpoint":  # it would train
            assert reader.api(good / reader.file) is not None


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def bad(request, good, readers, tmp_path):
    """Damaged file of a row, alone in a folder."""
    kind, _, damage, *_ = request.param
    reader = readers[kind]
    path = tmp_path / "in" / reader.file
    path.parent.mkdir()
    if (good / reader.file).is_dir():
        for file in (good / reader.file).rglob("*"):
            if file.is_file():
                copy = path / file.relative_to(good / reader.file)
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy.write_bytes(file.read_bytes())
    else:
        path.write_bytes((good / reader.file).read_bytes())
    damage(path)
    return path


def rows(table):
    names = [f"{kind}, {what}" for kind, what, *_ in table]
    pairs = [(row, row) for row in table]
    return pytest.mark.parametrize(("bad", "row"), pairs, indirect=["bad"], ids=names)


@rows(TABLE)
@pytest.mark.filterwarnings("ignore::pcnde_bridge.UnitsWarning")
def test_python(bad, row, readers):
    kind, _, _, error, message = row
    before = contents(bad.parent)
    with pytest.raises(error, match=message):
        readers[kind].api(bad)
    assert contents(bad.parent) == before


@rows([row for row in TABLE if row[0] != "weights"])
def test_command_line(bad, row, readers, run_pcnde):
    kind, _, _, _, message = row
    out = bad.parent / ("out.csv" if kind in ("model", "inflow", "area") else "out.npz")
    out.write_bytes(b"precious")
    before = contents(bad.parent)
    code, printed, err = run_pcnde(*readers[kind].cli(bad, out))
    assert (code, printed) == (2, "")
    assert "Traceback" not in err
    with pytest.raises(AssertionError, match=message):
        raise AssertionError(err)
    assert contents(bad.parent) == before


# ---- fuzzing -----------------------------------------------------------------------
#
# HYPOTHESIS_PROFILE=long pytest tests/test_malformed.py -k fuzz --hypothesis-show-statistics
# tries 2000 inputs of each kind; the suite fewer (tests/conftest.py).

NASTY = [
    b"nan", b"inf", b"-1", b"0", b"1e999", b"9" * 30, b"9" * 400, b"\x00", b"\xff\xfe", b'"', b",",
    b"\n", b"[", b"{", b"]" * 9, b"\\u0000", b"null", b"true", b"-0.0", b"1e-320", b"../../x",
    b"<", b"",
]  # fmt: skip


@st.composite
def edits(draw):
    """Places (as parts of the length), what to do there, and with what."""
    kind = st.sampled_from(["flip", "cut", "insert", "delete", "repeat", "token"])
    part = st.floats(0, 1, exclude_max=True)
    some = st.tuples(kind, part, st.integers(1, 64), st.binary(max_size=8), st.sampled_from(NASTY))
    return draw(st.lists(some, min_size=1, max_size=4))


def edited(whole, changes):
    for kind, part, length, noise, nasty in changes:
        at = int(part * len(whole))
        if kind == "flip" and whole:
            whole = whole[:at] + bytes([whole[at] ^ (length | 1)]) + whole[at + 1 :]
        elif kind == "cut":
            whole = whole[:at]
        elif kind == "insert":
            whole = whole[:at] + noise + whole[at:]
        elif kind == "delete":
            whole = whole[:at] + whole[at + length :]
        elif kind == "repeat":
            whole = whole[:at] + 2 * whole[at : at + length] + whole[at + length :]
        elif kind == "token":
            words = list(re.finditer(rb"[-+.\w]+", whole[at : at + 4096]))
            if words:
                start, end = words[0].span()
                whole = whole[: at + start] + nasty + whole[at + end :]
    return whole


# The file within a folder that is edited.
INNER = {"authors": NPY, "weights": WEIGHTS["flow"], "sv1d": "solver.in"}
KINDS = [
    "cases.npz", "cases.h5", "model", "checkpoint", "config", "split", "inflow", "area", "vtp",
    "sv1d", "sv1d table", "csv", "hdf5", "foreign hdf5", "weights", "authors",
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.filterwarnings("ignore")
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(changes=edits())
def test_fuzz(kind, good, readers, tmp_path_factory, small_cases, small_config, changes):
    """Any damaged file is read, or rejected with an error of the package."""
    inner = "m_S0_flow.dat" if kind == "sv1d table" else INNER.get(kind)
    reader = readers["sv1d" if kind == "sv1d table" else kind]
    folder = tmp_path_factory.getbasetemp() / "fuzz"
    path = folder / reader.file
    if not path.exists():
        shutil.copytree(good, folder, dirs_exist_ok=True)
    file, source = (path, good / reader.file) if inner is None else (
        path / inner, good / reader.file / inner
    )  # fmt: skip
    file.write_bytes(edited(source.read_bytes(), changes))
    read = reader.api
    if kind == "checkpoint":  # without training

        def read(path):
            cases = small_cases.select([0, 1, 5])
            procedure = staged_training(cases, small_config, select_engine("jax"))
            return Trainer(procedure, path).start(0)

    try:
        read(path)
    except PCNDEError as error:
        assert str(error)
    finally:
        file.write_bytes(source.read_bytes())


def as_read(found):
    """All that a reader returned, in a form that compares every number and text."""
    if isinstance(found, Cases):
        return found.fingerprint(), found.period
    facts, arrays = found if isinstance(found, tuple) else found.to_archive()
    return json.dumps(facts, sort_keys=True), sha256_arrays(dict(sorted(arrays.items())))


@pytest.mark.parametrize("kind", ["cases.npz", "cases.h5", "model", "checkpoint", "vtp", "csv.gz"])
@pytest.mark.parametrize("count", [100, pytest.param(5000, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore")
def test_every_single_change_is_noticed(kind, count, good, readers, tmp_path):
    """Of files that this package wrote, or that have checksums, one byte is another one."""
    read, path = readers[kind if kind != "csv.gz" else "csv"].api, tmp_path / "file"
    if kind == "csv.gz":
        path = tmp_path / "tidy.csv.gz"
        path.write_bytes(gzip.compress((good / "tidy.csv").read_bytes(), mtime=0))
    else:
        path = tmp_path / readers[kind].file
        shutil.copy(good / readers[kind].file, path)
    if kind == "checkpoint":  # without training
        read = partial(read_archive, kind="pcnde-checkpoint", version=99, what="checkpoint")
    whole, rng = path.read_bytes(), np.random.default_rng(count)
    expected, noticed = as_read(read(path)), 0
    for place in rng.integers(0, len(whole), size=count):
        other = bytes([whole[place] ^ int(rng.integers(1, 256))])
        path.write_bytes(whole[:place] + other + whole[place + 1 :])
        try:
            found = read(path)
        except PCNDEError:
            noticed += 1
        else:
            assert as_read(found) == expected, (
                place,
                whole[max(0, place - 40) : place + 40],
                other,
            )
    assert noticed > count / 2
