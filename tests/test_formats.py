"""Results of other programs: read with their units, direction and time; predictions out.

No file of SimVascular or svOneDSolver is in the repository; these are made as the programs'
sources and documentation describe them, the centrelines by VTK.
"""

from __future__ import annotations

import dataclasses
import warnings
import xml.etree.ElementTree as ET
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

from pcnde_bridge import (
    PCNDE,
    Cases,
    DataNotFoundError,
    FileError,
    InputError,
    PCNDEError,
    UnitsWarning,
)
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.io import (
    VesselResults,
    read_csv,
    read_hdf5,
    read_labels,
    read_simvascular,
    read_sv1d,
    to_cases,
    write_pvd,
    write_vtp,
)
from pcnde_bridge.io.tables import read_frame
from pcnde_bridge.io.units import FACTORS
from pcnde_bridge.model.prediction import Prediction


@pytest.fixture(scope="module")
def vessel(small_cases) -> VesselResults:
    """Results of one vessel: one cycle without its end point."""
    return results_of(small_cases, 6)


def results_of(cases, case, name="vessel"):
    return VesselResults(
        name,
        *(getattr(cases, field)[case] for field in VARIABLES),
        cases.area_undeformed[case],
        cases.time,
        cases.z,
    )


def replaced(vessel, **changes):
    return dataclasses.replace(vessel, **changes)


def at_times(vessel, time):
    """The same periodic vessel at other instants: the same Fourier series."""
    n = vessel.time.size
    phase = 2j * np.pi * np.arange(n // 2 + 1)

    def series(values):
        weight = np.fft.rfft(values, axis=0) / n
        weight[1 : (n + 1) // 2] *= 2
        return np.real(np.exp(np.outer(time, phase)) @ weight)

    return replaced(
        vessel, time=np.asarray(time), **{f: series(getattr(vessel, f)) for f in VARIABLES}
    )


@pytest.fixture
def prediction(small_cases) -> Prediction:
    chosen = small_cases.select([0, 6, 11])
    return Prediction(
        *(np.array(getattr(chosen, name)) for name in (*VARIABLES, "area_undeformed", "time", "z")),
        period=1.0,
        labels=chosen.labels,
        novelty=np.array([0.1, 0.2, 0.3]),
    )


# ---- checks that all formats share


def test_whole_results_are_taken_as_they_are(small_cases):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = to_cases([results_of(small_cases, i) for i in (3, 6)])
    assert found.period == 1.0
    for name in (*VARIABLES, "area_undeformed"):
        assert np.array_equal(getattr(found, name), getattr(small_cases, name)[[3, 6]])
    assert list(found.labels["geometry"]) == [0, 1]


@pytest.mark.parametrize(
    ("units", "factors"),
    [
        ({"pressure": "mmHg"}, {"pressure": 1 / 1333.22}),
        ({"pressure": "kPa", "z": "mm"}, {"pressure": 1e-4, "z": 10}),
        ({"flow": "L/min"}, {"flow": 0.06}),
        ({"time": "ms"}, {"time": 1e3}),
        (
            "mm-g-s",
            {"flow": 1e3, "area": 100, "area_undeformed": 100, "pressure": 0.1, "z": 10},
        ),
        (
            "si",
            {"flow": 1e-6, "area": 1e-4, "area_undeformed": 1e-4, "pressure": 0.1, "z": 0.01},
        ),
    ],
)
def test_other_units_are_refused_unless_they_are_stated(vessel, units, factors):
    other = replaced(vessel, **{name: f * getattr(vessel, name) for name, f in factors.items()})
    with pytest.raises(InputError, match=r"does not look like CGS units.*--units") as caught:
        to_cases([other])
    suspect = "pressure" if "pressure" in factors else next(iter(factors))
    assert f"--units {suspect}=" in str(caught.value)
    found = to_cases([other], units=units)
    expected = to_cases([vessel])
    for name in (*VARIABLES, "area_undeformed", "time", "z"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-12)


IN_CGS = {
    ("flow", "mL/s"): 1,
    ("flow", "cm^3/s"): 1,
    ("flow", "mm^3/s"): 0.001,
    ("flow", "m^3/s"): 1_000_000,
    ("flow", "mL/min"): 0.016666666666666667,
    ("flow", "L/min"): 16.666666666666667,
    ("area", "cm^2"): 1,
    ("area", "mm^2"): 0.01,
    ("area", "m^2"): 10_000,
    ("pressure", "dyn/cm^2"): 1,
    ("pressure", "Pa"): 10,
    ("pressure", "kPa"): 10_000,
    ("pressure", "mmHg"): 1333.22,
    ("z", "cm"): 1,
    ("z", "mm"): 0.1,
    ("z", "m"): 100,
    ("time", "s"): 1,
    ("time", "ms"): 0.001,
}
"""What one of each unit is in mL/s, cm², dyn/cm², cm or s."""


def test_the_factor_of_every_unit_is_tested():
    assert {(name, unit) for name, units in FACTORS.items() for unit in units} == set(IN_CGS)


@pytest.mark.parametrize(("name", "unit"), IN_CGS)
def test_every_unit(vessel, name, unit):
    of_it = (name, "area_undeformed") if name == "area" else (name,)
    other = {array: getattr(vessel, array) / IN_CGS[name, unit] for array in of_it}
    found, expected = to_cases([replaced(vessel, **other)], units={name: unit}), to_cases([vessel])
    for array in (*VARIABLES, "area_undeformed", "time", "z"):
        np.testing.assert_allclose(getattr(found, array), getattr(expected, array), rtol=1e-12)
    assert found.period == pytest.approx(expected.period, rel=1e-12)


@pytest.mark.parametrize("name", [*VARIABLES, "z"])
def test_what_is_off_by_a_thousand_is_refused(vessel, name):
    for factor in (1e3, 1e-3):
        with pytest.raises(InputError, match="does not look like CGS units"):
            to_cases([replaced(vessel, **{name: factor * getattr(vessel, name)})])


def test_units_that_do_not_go_together_are_refused(vessel):
    """4 cm and 40 mm are both lengths of vessels, but not of this diameter."""
    long = replaced(vessel, z=10 * vessel.z)
    with pytest.raises(InputError, match=r"length over the diameter is 10.*units=\{'z': 'mm'\}"):
        to_cases([long])
    assert to_cases([long], units={"z": "mm"}).z[-1] == pytest.approx(4.0)
    small = replaced(vessel, flow=vessel.flow / 60)
    with pytest.raises(InputError, match=r"flow over area is .*--units flow="):
        to_cases([small])
    with pytest.raises(InputError, match=r"median area is 0\.0105 times the undeformed"):
        to_cases([replaced(vessel, area=vessel.area / 100)])


def test_units_cgs_says_that_unusual_numbers_are_right(vessel):
    low = replaced(vessel, pressure=vessel.pressure / 1333.22)
    with pytest.warns(UnitsWarning):
        found = to_cases([low], units="cgs")
    assert np.array_equal(found.pressure[0], low.pressure)


def test_units_that_the_file_states_count(vessel):
    low = replaced(vessel, pressure=vessel.pressure / 1333.22, units={"pressure": "mmHg"})
    np.testing.assert_allclose(to_cases([low]).pressure[0], vessel.pressure)


def test_flow_against_z_is_refused_with_both_remedies(vessel):
    outwards = replaced(vessel, flow=-vessel.flow)
    with pytest.raises(InputError, match=r"runs against z.*--flip flow.*--flip z"):
        to_cases([outwards])
    assert to_cases([outwards], flip="flow") == to_cases([vessel])
    backwards = replaced(
        vessel,
        area_undeformed=vessel.area_undeformed[::-1],
        **{f: (-1 if f == "flow" else 1) * getattr(vessel, f)[:, ::-1] for f in VARIABLES},
    )
    with pytest.raises(InputError, match="runs against z"):
        to_cases([backwards])
    found = to_cases([backwards], flip="z")
    np.testing.assert_allclose(found.z, vessel.z, atol=1e-15)
    for name in VARIABLES:
        assert np.array_equal(getattr(found, name)[0], getattr(vessel, name))
    mixed = np.where(vessel.z > 3, -1, 1) * vessel.flow
    with pytest.raises(InputError, match="the sign changes on the way"):
        to_cases([replaced(vessel, flow=mixed)])


def test_a_repeated_end_point_needs_the_period(vessel):
    closed = at_times(vessel, np.arange(21) / 20)
    with pytest.raises(InputError, match=r"last instant repeats the first.*--period 1"):
        to_cases([closed])
    found = to_cases([closed], period=1.0)
    assert found.n_times == 20
    np.testing.assert_allclose(found.flow[0], vessel.flow, atol=1e-12)


def test_the_last_whole_cycle_is_taken_at_its_phase(vessel):
    """Two and a half cycles, with another start: what is taken begins at a multiple of T."""
    time = np.arange(3, 53) / 20
    found = to_cases([at_times(vessel, time)], period=1.0)
    assert found.time[0] == 0
    np.testing.assert_allclose(found.flow[0], vessel.flow, atol=1e-11)


def test_what_is_not_periodic_is_refused(vessel):
    time = np.arange(60) / 20
    long = at_times(vessel, time)
    rising = replaced(long, pressure=long.pressure * (1 + time[:, None]))
    with pytest.raises(InputError, match=r"is not periodic.*simulate more cycles"):
        to_cases([rising], period=1.0)
    half = at_times(vessel, np.arange(130) / 100)
    with pytest.raises(InputError, match=r"is not one cycle: .* begins at .*--period"):
        to_cases([half])
    assert to_cases([half], period=1.0).n_times == 100
    with pytest.raises(InputError, match=r"covers 0\.95 s, less than the period of 2 s"):
        to_cases([vessel], period=2.0)


def test_time_is_resampled_on_request_only(vessel):
    for n in (11, 20, 32):
        found = to_cases([vessel], instants=n)
        assert found.period == 1.0
        expected = at_times(vessel, np.arange(n) / n)
        if n >= 20:
            np.testing.assert_allclose(found.flow[0], expected.flow, rtol=1e-9)
        assert found.n_times == n
    # The waveform has three harmonics, so eleven instants still hold all of it.
    np.testing.assert_allclose(
        to_cases([vessel], instants=11).flow[0],
        at_times(vessel, np.arange(11) / 11).flow,
        rtol=1e-9,
    )
    rng = np.random.default_rng(0)
    uneven = at_times(vessel, np.sort((np.arange(200) + rng.uniform(0, 0.5, 200)) / 200))
    for options in ({}, {"period": 1.0}):
        with pytest.raises(InputError, match="--instants"):
            to_cases([uneven], **options)
    found = to_cases([uneven], period=1.0, instants=20)
    expected = at_times(vessel, found.time)
    np.testing.assert_allclose(found.flow[0], expected.flow, rtol=1e-5)


def test_points_are_resampled_on_request_only(vessel):
    found = to_cases([vessel], points=41)
    np.testing.assert_allclose(found.z, np.linspace(0, 4, 41))
    np.testing.assert_allclose(found.flow[0][:, ::2], vessel.flow, rtol=1e-12)
    assert found.area.min() >= vessel.area.min()
    assert found.area.max() <= vessel.area.max()
    some = to_cases([vessel], points=[0.5, 1.0, 1.1, 2.0])
    assert list(some.z) == [0.5, 1.0, 1.1, 2.0]
    for bad in (2, 2.5, True, [0.0, 1.0, 5.0], [[0.0, 1.0]]):
        with pytest.raises(InputError, match="points"):
            to_cases([vessel], points=bad)


def test_vessels_of_one_data_set_have_one_grid(vessel):
    other = replaced(vessel, name="other", z=1.0005 * vessel.z)
    with pytest.raises(InputError, match=r"vessel has 21 values of z .* other 21 .*--points"):
        to_cases([vessel, other])
    assert to_cases([vessel, other], points=21).n_cases == 2
    longer = replaced(vessel, name="other", z=1.2 * vessel.z)
    with pytest.raises(InputError, match="vessels of other lengths"):
        to_cases([vessel, longer], points=21)
    coarse = at_times(vessel, np.arange(16) / 16)
    with pytest.raises(InputError, match=r"20 values of time .*--instants"):
        to_cases([vessel, coarse])
    assert to_cases([vessel, coarse], instants=20).n_cases == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"units": "cgi"}, "Unknown units 'cgi'"),
        ({"units": 3}, "units must be a name or a mapping"),
        ({"units": {"pressure": "bar"}}, "Unknown unit 'bar' of pressure; known are .*mmHg"),
        ({"units": {"presure": "Pa"}}, "units names 'presure'"),
        ({"flip": "area"}, "flip must be 'flow' or 'z'"),
        ({"instants": 3}, "instants must be a whole number ≥ 4"),
        ({"instants": 10.5}, "instants must be a whole number"),
        ({"period": -1.0}, "period must be positive and finite"),
        ({"period": "1"}, "period must be a number"),
    ],
)
def test_bad_options(vessel, options, message):
    with pytest.raises(InputError, match=message):
        to_cases([vessel], **options)


def test_nothing_to_read():
    with pytest.raises(InputError, match="name at least one file"):
        to_cases([])


# ---- SimVascular


def centreline(path, vessel, *, steps=None, suffix=str, branches=None, drop=(), extra=None):
    """Write a centreline as svSlicer does: arrays by time step, two-point lines."""
    n = vessel.z.size
    data, points, lines = vtkPolyData(), vtkPoints(), vtkCellArray()
    # A bent vessel: the distance along it is what counts.
    angle = vessel.z / 10
    bend = np.stack([10 * np.sin(angle), 10 * (1 - np.cos(angle)), 0 * angle], axis=1)
    points.SetData(numpy_to_vtk(bend, deep=True))
    data.SetPoints(points)
    for i in range(n - 1):
        lines.InsertNextCell(2, [i, i + 1])
    data.SetLines(lines)
    arrays = {
        "BranchId": np.zeros(n, dtype=np.int64) if branches is None else branches,
        "BifurcationId": np.full(n, -1),
        "GlobalNodeId": np.arange(n),
        "CenterlineId": np.ones((n, 2), dtype=np.int32),
        "CenterlineSectionArea": vessel.area_undeformed,
        "CenterlineSectionNormal": np.tile([1.0, 0, 0], (n, 1)),
        "MaximumInscribedSphereRadius": np.sqrt(vessel.area_undeformed / np.pi),
        "Path": vessel.z,
    }
    steps = vessel.time if steps is None else steps
    for i, step in enumerate(steps):
        arrays[f"pressure_{suffix(step)}"] = vessel.pressure[i]
        arrays[f"velocity_{suffix(step)}"] = vessel.flow[i]
        arrays[f"area_{suffix(step)}"] = vessel.area[i]
    arrays |= extra or {}
    for name, values in arrays.items():
        if not any(name.startswith(part) for part in drop):
            array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
            array.SetName(name)
            data.GetPointData().AddArray(array)
    writer = vtkXMLPolyDataWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    assert writer.Write()
    return path


def test_reads_what_the_slicer_writes(vessel, tmp_path):
    """By the number of the time step, with both ends of the cycle."""
    closed = at_times(vessel, np.arange(21) / 20)
    path = centreline(
        tmp_path / "a.vtp", closed, steps=range(1000, 2001, 50), suffix="{:05d}".format
    )
    with pytest.raises(InputError, match=r"by time step, such as pressure_01000.*--time-step"):
        read_simvascular(path)
    with pytest.raises(InputError, match="Pass period"):
        read_simvascular(path, time_step=1e-3)
    found = read_simvascular([path], time_step=1e-3, period=1.0)
    np.testing.assert_allclose(found.z, vessel.z, atol=1e-12)
    for name in VARIABLES:
        np.testing.assert_allclose(getattr(found, name)[0], getattr(vessel, name), rtol=1e-9)
    assert np.array_equal(found.area_undeformed[0], vessel.area_undeformed)


def test_reads_what_reduced_order_simulations_write(vessel, tmp_path):
    """By the time in s; ``flow`` in place of ``velocity``."""
    extra = {f"flow_{t}": q for t, q in zip(vessel.time, vessel.flow, strict=True)}
    path = centreline(tmp_path / "a.vtp", vessel, drop=("velocity",), extra=extra)
    assert read_simvascular(path) == to_cases([vessel])
    with pytest.raises(InputError, match="leave time_step out"):
        read_simvascular(path, time_step=1e-3)


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
def test_reads_centrelines_however_vtk_writes_them(prediction, tmp_path, way):
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
    with pytest.raises(FileError, match=r"compressor vtkLZ4DataCompressor is not known.*zlib"):
        read_simvascular(path)


def test_one_branch_of_several(vessel, tmp_path):
    branches = np.array([0] * 8 + [-1] * 2 + [1] * 11)
    path = centreline(tmp_path / "a.vtp", vessel, branches=branches)
    with pytest.raises(InputError, match=r"has the branches \[0, 1\]: choose one.*--branch"):
        read_simvascular(path)
    with pytest.raises(InputError, match=r"no branch 2; its branches are \[0, 1\]"):
        read_simvascular(path, branch=2)
    found = read_simvascular(path, branch=1)
    assert found.n_points == 11
    np.testing.assert_allclose(found.z, vessel.z[10:] - vessel.z[10])
    assert np.array_equal(found.flow[0], vessel.flow[:, 10:])


def test_a_plain_line_needs_no_branches(vessel, tmp_path):
    path = centreline(tmp_path / "a.vtp", vessel, drop=("BranchId", "Path"))
    found = read_simvascular(path)
    # Chords of a circle of 10 cm are a little shorter than its arc.
    np.testing.assert_allclose(found.z, vessel.z, rtol=1e-4)
    with pytest.raises(InputError, match="leave branch out"):
        read_simvascular(path, branch=0)


def test_rigid_walls_have_to_be_said(vessel, tmp_path):
    path = centreline(tmp_path / "a.vtp", vessel, drop=("area_",))
    with pytest.raises(InputError, match=r"no area for each time step.*--rigid"):
        read_simvascular(path)
    found = read_simvascular(path, rigid=True)
    assert np.array_equal(found.area, np.broadcast_to(vessel.area_undeformed, found.area.shape))


@pytest.mark.parametrize(
    ("drop", "extra", "message"),
    [
        (("pressure",), {}, r"no arrays pressure_<time step>; it has \['BifurcationId'"),
        (("velocity",), {}, r"no arrays flow_<time step> or velocity_"),
        (("velocity_0.5",), {}, r"no flow_0\.5 \(2 time steps lack flow, 18 are whole\)"),
        (("Centerline",), {}, "no undeformed area"),
        ((), {"velocity_0.3": np.ones((21, 3))}, "velocity_0.3 has 3 numbers at each point"),
    ],
)
def test_centrelines_with_missing_arrays(vessel, tmp_path, drop, extra, message):
    path = centreline(tmp_path / "a.vtp", vessel, drop=drop, extra=extra)
    with pytest.raises(InputError, match=message):
        read_simvascular(path)


def test_labels_by_file(small_cases, tmp_path):
    paths = [centreline(tmp_path / f"{i}.vtp", results_of(small_cases, i)) for i in (0, 4, 5)]
    table = tmp_path / "labels.csv"
    table.write_text("file,waveform,geometry,note\n5.vtp,1,2,b\n0.vtp,0,1,a\n4.vtp,0,2,c\n")
    cases = read_simvascular(paths, labels=read_labels(table, paths))
    assert list(cases.labels["geometry"]) == [1, 2, 2]
    assert list(cases.labels["note"]) == ["a", "c", "b"]
    table.write_text("file,waveform,geometry\n5.vtp,1,2\n")
    with pytest.raises(InputError, match=r"has 0 rows for .*0\.vtp; it needs one"):
        read_labels(table, paths)
    table.write_text("name,waveform,geometry\n5.vtp,1,2\n")
    with pytest.raises(InputError, match="lacks the column 'file'"):
        read_labels(table, paths)
    with pytest.raises(FileError, match="Cannot read a table"):
        read_labels(tmp_path / "nowhere.csv", paths)


# ---- svOneDSolver


def sv1d(folder, vessel, *, pieces=(8, 6, 6), step=0.01, every=5, nodes=None):
    """Write an input file and results: a chain of segments, time in columns."""
    path = folder / "solver.in"
    text = ["# A model", "MODEL results_", ""]
    start = 0
    for i, elements in enumerate(pieces):
        end = start + elements
        length = vessel.z[end] - vessel.z[start]
        ends = (i, i + 1) if nodes is None else nodes[i]
        s_u = vessel.area_undeformed
        text.append(f"NODE {i} 0.0 0.0 {vessel.z[start]}")
        text.append(
            f"SEGMENT Group{i}_Seg0 {i} {length} {elements} {ends[0]} {ends[1]} {s_u[start]} "
            f"{s_u[end]} 0.0 MAT1 NONE 0.0 0 0 NOBOUND NONE"
        )
        for field in VARIABLES:
            table = getattr(vessel, field).T[start : end + 1]
            np.savetxt(folder / f"results_Group{i}_Seg0_{field}.dat", table, fmt="%.17g")
        start = end
    text += [
        f"SOLVEROPTIONS {step} {every} {every * (len(vessel.time) - 1)} 2 INFLOW FLOW 1e-6 1 1"
    ]
    path.write_text("\n".join(text) + "\n")
    return path


@pytest.fixture
def straight(vessel):
    """A vessel whose undeformed area is linear, as it is in the solver's segments."""
    return replaced(vessel, area_undeformed=np.linspace(0.125, 0.11, 21))


def test_reads_a_chain_of_segments(straight, tmp_path):
    path = sv1d(tmp_path, at_times(straight, np.arange(41) / 20))
    found = read_sv1d(path, period=1.0)
    np.testing.assert_allclose(found.z, straight.z)
    np.testing.assert_allclose(found.area_undeformed[0], straight.area_undeformed)
    for name in VARIABLES:
        np.testing.assert_allclose(getattr(found, name)[0], getattr(straight, name), rtol=1e-9)
    part = read_sv1d(path, segments=["Group1_Seg0", "Group2_Seg0"], period=1.0)
    np.testing.assert_allclose(part.flow, found.flow[:, :, 8:])


def test_reads_what_the_solver_wrote():
    """Text that svOneDSolver made of ``tests/data/sv1d/tube.in``."""
    path = Path(__file__).with_name("data") / "sv1d" / "tube.in"
    with pytest.raises(InputError, match=r"start from rest: pass the period.*--period"):
        read_sv1d(path)
    found = read_sv1d(path, period=1.0)
    assert (found.n_times, found.n_points, found.period) == (20, 11, 1.0)
    np.testing.assert_allclose(found.z, np.linspace(0, 4, 11))
    phase = 2 * np.pi * found.time
    inflow = 1.3 + 0.4 * np.sin(phase) + 0.1 * np.cos(2 * phase)
    np.testing.assert_allclose(found.inflow[0], inflow, rtol=5e-3)
    np.testing.assert_allclose(found.pressure[0, :, -1], 1e5 * found.flow[0, :, -1], rtol=0.02)
    np.testing.assert_allclose(found.area_undeformed[0, [0, 6, 10]], [0.125, 0.125, 0.11])


def test_a_network_needs_a_choice(straight, tmp_path):
    path = sv1d(tmp_path, straight, nodes=[(0, 1), (1, 2), (1, 3)])
    with pytest.raises(InputError, match=r"Group2_Seg0 does not begin where Group1_Seg0 ends"):
        read_sv1d(path, period=1.0)
    assert read_sv1d(path, segments=["Group0_Seg0", "Group1_Seg0"], period=1.0).n_points == 15
    with pytest.raises(InputError, match=r"has no segments \['Group7'\]"):
        read_sv1d(path, segments=["Group7"], period=1.0)


def test_results_that_do_not_fit_the_input_file(straight, tmp_path):
    path = sv1d(tmp_path, straight)
    table = tmp_path / "results_Group1_Seg0_area.dat"
    whole = table.read_text()
    table.write_text("\n".join(whole.splitlines()[:-1]))
    with pytest.raises(FileError, match=r"area\.dat has 6 rows, .* segment 7 nodes: it is trunc"):
        read_sv1d(path, period=1.0)
    table.write_text("\n".join(line.rsplit(" ", 1)[0] for line in whole.splitlines()))
    with pytest.raises(FileError, match="has 19 time steps, the segment before 20"):
        read_sv1d(path, period=1.0)
    table.unlink()
    with pytest.raises(DataNotFoundError, match="output TEXT"):
        read_sv1d(path, period=1.0)


# ---- CSV and HDF5


def test_tidy_tables_round_trip(prediction, tmp_path):
    prediction.save(tmp_path / "p.csv")
    found = read_csv(tmp_path / "p.csv", period=1.0)
    assert list(found.labels["patient"]) == ["patient 1", "patient 2", "patient 3"]
    for name in (*VARIABLES, "area_undeformed"):
        np.testing.assert_allclose(getattr(found, name), getattr(prediction, name), rtol=1e-14)
    prediction.save(tmp_path / "p.csv.gz")
    assert read_csv(tmp_path / "p.csv.gz", period=1.0) == found
    frame = read_frame(tmp_path / "p.csv").sample(frac=1.0, random_state=1)
    frame.to_csv(tmp_path / "shuffled.csv", index=False)
    assert read_csv(tmp_path / "shuffled.csv", period=1.0) == found


def test_an_unknown_blockage_comes_back_from_a_table(prediction, tmp_path):
    prediction.labels["blockage"] = [0.5, np.nan, np.nan]
    prediction.labels["age"] = [np.nan, 61.0, 70.0]
    prediction.save(tmp_path / "p.csv")
    found = read_csv(tmp_path / "p.csv", period=1.0)
    assert list(found.labels["blockage"].isna()) == [False, True, True]
    assert list(found.labels["age"].isna()) == [True, False, False]
    frame = prediction.to_frame()
    frame.loc[0, "patient"] = None
    frame.to_csv(tmp_path / "p.csv", index=False)
    with pytest.raises(InputError, match=r"a label is missing in the columns \['patient'\]"):
        read_csv(tmp_path / "p.csv", period=1.0)


def test_labels_of_which_a_part_would_be_lost_are_refused(prediction, tmp_path):
    prediction.save(tmp_path / "p.csv")
    prediction.to_frame().drop(columns="patient").to_csv(tmp_path / "q.csv", index=False)
    with pytest.raises(InputError, match=r"p\.csv.* has the labels .*'patient'.*q\.csv"):
        read_csv([tmp_path / "p.csv", tmp_path / "q.csv"], period=1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.drop(columns="area"), r"lacks the columns \['area'\]"),
        (lambda f: f.iloc[:-1], "419 rows, but 20 instants and 21 points make 420"),
        (lambda f: pd.concat([f, f]), "840 rows, .*columns that tell them apart"),
        (lambda f: f.assign(area_undeformed=0.1 + f["time"]), "area_undeformed changes with time"),
        (lambda f: f.assign(flow="x"), "line 2, column flow: not a number"),
        (lambda f: f.iloc[:0], "has no rows"),
    ],
)
def test_tables_that_are_not_whole(vessel, tmp_path, change, message):
    time, z = (grid.ravel() for grid in np.meshgrid(vessel.time, vessel.z, indexing="ij"))
    fields = {field: getattr(vessel, field).ravel() for field in VARIABLES}
    fields["area_undeformed"] = np.tile(vessel.area_undeformed, vessel.time.size)
    frame = pd.DataFrame({"time": time, "z": z, **fields})
    frame.to_csv(tmp_path / "a.csv", index=False)
    assert read_csv(tmp_path / "a.csv") == to_cases([vessel])
    change(frame).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(InputError, match=message):
        read_csv(tmp_path / "a.csv")


def test_reads_hdf5_of_others_and_of_ours(small_cases, vessel, tmp_path):
    small_cases.save(tmp_path / "ours.h5")
    assert read_hdf5(tmp_path / "ours.h5") == small_cases
    with h5py.File(tmp_path / "theirs.h5", "w") as file:
        file["results/Q"] = vessel.flow
        file["results/S"] = vessel.area
        file["p"] = vessel.pressure / 1333.22
        file["p"].attrs["units"] = "mmHg"
        file["A0"], file["t"], file["s"] = vessel.area_undeformed, vessel.time, vessel.z
    with pytest.raises(InputError, match=r"lacks the data sets \['flow', .*--names flow=path"):
        read_hdf5(tmp_path / "theirs.h5")
    names = {"flow": "/results/Q", "area": "results/S", "pressure": "p"}
    names |= {"area_undeformed": "A0", "time": "t", "z": "s"}
    found = read_hdf5(tmp_path / "theirs.h5", names=names)
    np.testing.assert_allclose(found.pressure[0], vessel.pressure, rtol=1e-14)
    with pytest.raises(InputError, match="it can name"):
        read_hdf5(tmp_path / "theirs.h5", names={"Q": "flow"})


def test_text_of_hdf5_is_unicode_however_it_is_stored(vessel, tmp_path):
    with h5py.File(tmp_path / "cases.h5", "w") as file:
        for name in (*VARIABLES, "area_undeformed", "time", "z"):
            file[name] = getattr(vessel, name)
        file["labels/patient"] = ["Müller"]  # of variable length
        file["labels/surgeon"] = np.char.encode(["Søren"], "utf-8")  # of fixed length
    labels = read_hdf5(tmp_path / "cases.h5").labels
    assert labels.loc[0, ["patient", "surgeon"]].tolist() == ["Müller", "Søren"]


# ---- predictions out


def test_centrelines_round_trip(prediction, tmp_path):
    paths = write_vtp(prediction, tmp_path / "p.vtp")
    assert [path.name for path in paths] == ["p_000.vtp", "p_001.vtp", "p_002.vtp"]
    found = read_simvascular(paths)
    assert found == prediction.to_cases()
    assert read_simvascular(paths[1]) == prediction.to_cases().select([1])


def test_a_label_may_be_a_truth_value(prediction, tmp_path):
    labels = prediction.labels.assign(treated=[True, False, True])
    paths = write_vtp(replaced(prediction, labels=labels), tmp_path / "p.vtp")
    assert read_simvascular(paths).labels["treated"].tolist() == [1, 0, 1]


def test_the_animation_has_a_file_for_each_step(prediction, tmp_path):
    write_pvd(prediction, tmp_path / "p & <q>.pvd")
    rows = list(ET.parse(tmp_path / "p & <q>.pvd").getroot().iter("DataSet"))
    assert len(rows) == 3 * 20
    assert {float(row.get("timestep")) for row in rows} == set(prediction.time.tolist())
    reader = vtkXMLPolyDataReader()
    reader.SetFileName(str(tmp_path / rows[4].get("file")))
    reader.Update()
    case, step = int(rows[4].get("part")), 1
    pressure = reader.GetOutput().GetPointData().GetArray("pressure")
    found = [pressure.GetValue(i) for i in range(pressure.GetNumberOfValues())]
    assert found == prediction.pressure[case, step].tolist()


def test_to_xarray(prediction):
    drawn = {name: np.stack([getattr(prediction, name)] * 2) for name in VARIABLES}
    dataset = replaced(prediction, samples=drawn).to_xarray()
    assert dataset["flow"].dims == ("case", "time", "z")
    assert dataset["pressure"].attrs["units"] == "dyn/cm^2"
    assert dataset["area_samples"].dims == ("sample", "case", "time", "z")
    assert dataset.attrs["period"] == 1.0
    one = dataset["flow"].sel(z=2.0).isel(case=1).to_numpy()
    assert np.array_equal(one, prediction.flow[1, :, 10])
    assert list(dataset["patient"].to_numpy()) == ["patient 1", "patient 2", "patient 3"]
    assert "pressure" not in replaced(prediction, pressure=None).to_xarray()


def test_save_by_ending(prediction, tmp_path):
    assert prediction.save(tmp_path / "p.h5") == [tmp_path / "p.h5"]
    assert Cases.load(tmp_path / "p.h5") == prediction.to_cases()
    flow_only = replaced(prediction, pressure=None)
    assert flow_only.save(tmp_path / "q.vtp") == sorted(tmp_path.glob("q_*.vtp"))
    assert len(list(tmp_path.glob("q_*.vtp"))) == 3
    with pytest.raises(InputError, match=r"no pressure stages.*\.csv or \.vtp"):
        flow_only.save(tmp_path / "q.npz")
    for name in ("p", "p.xlsx", "p.h5.gz", "absent/p.csv"):
        with pytest.raises(FileError, match="Cannot"):
            prediction.save(tmp_path / name)


@pytest.mark.parametrize(
    ("hidden", "extra", "use"),
    [
        ("vtkmodules", "vtk", lambda p, folder: p.save(folder / "p.vtp")),
        ("vtkmodules", "vtk", lambda p, folder: p.save(folder / "p.pvd")),
        ("xarray", "xarray", lambda p, folder: p.to_xarray()),
    ],
)
def test_a_missing_package_is_named_with_its_extra(
    prediction, tmp_path, monkeypatch, hidden, extra, use
):
    def refuse(name):
        assert name.partition(".")[0] == hidden
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr("pcnde_bridge._utils.optional.importlib.import_module", refuse)
    with pytest.raises(PCNDEError, match=rf'pip install "pcnde-bridge\[{extra}\]"') as caught:
        use(prediction, tmp_path)
    assert isinstance(caught.value, ImportError)


# ---- command line


def test_convert(small_cases, tmp_path, run_pcnde):
    chosen = {i: results_of(small_cases, i) for i in (0, 4, 5)}
    for i, each in chosen.items():
        centreline(
            tmp_path / f"{i}.vtp", at_times(each, np.arange(21) / 20),
            steps=range(21), suffix="{:05d}".format,
        )  # fmt: skip
    files = [tmp_path / f"{i}.vtp" for i in chosen]
    table = tmp_path / "labels.csv"
    table.write_text("file,waveform,geometry\n5.vtp,1,2\n0.vtp,0,1\n4.vtp,0,2\n")
    out = tmp_path / "mine.h5"
    code, printed, err = run_pcnde(
        "convert", *files, "--from", "simvascular", "--time-step", 0.05, "--period", 1,
        "--points", 41, "--instants", 32, "--labels", table, "--out", out,
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert "Saved Cases(3 cases: 2 geometries, 2 waveforms; 32 instants over 1 s" in printed
    found = Cases.load(out)
    assert (found.n_times, found.n_points) == (32, 41)
    np.testing.assert_allclose(found.flow[:, :, 0][:, ::8], small_cases.inflow[[0, 4, 5], ::5])
    found.select([0]).save(tmp_path / "one.h5")
    options = ["--out", tmp_path / "again.npz", "--flip", "flow", "--units", "pressure=dyn/cm^2"]
    code, _, err = run_pcnde("convert", tmp_path / "one.h5", "--from", "hdf5", *options)
    assert code == 2
    assert "runs against z" in err
    code, _, _ = run_pcnde(
        "convert", tmp_path / "one.h5", "--from", "hdf5", "--names", "flow=flow,z=z",
        "--out", tmp_path / "again.npz",
    )  # fmt: skip
    assert code == 0
    assert Cases.load(tmp_path / "again.npz") == found.select([0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--from", "csv", "--branch", "1"], "--branch goes with --from simvascular, not csv"),
        (["--from", "hdf5", "--segments", "a"], "--segments goes with --from sv1d, not hdf5"),
        (["--from", "hdf5", "--names", "flow"], "--names must look like flow="),
        (["--from", "sv1d", "--units", "z="], "--units must look like flow="),
        (["--from", "openfoam"], "--from"),
        ([], "--from"),
    ],
)
def test_convert_refuses_wrong_options(tmp_path, run_pcnde, options, message):
    out = tmp_path / "mine.h5"
    code, printed, err = run_pcnde("convert", tmp_path / "a", *options, "--out", out)
    assert (code, printed) == (2, "")
    assert message in err
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def inputs(small_cases, tmp_path):
    """Arguments of ``pcnde predict`` for two cases."""
    for name, axis, values in (
        ("inflow.csv", "time", small_cases.inflow[:2]),
        ("area.csv", "z", small_cases.area_undeformed[:2]),
    ):
        table = {axis: getattr(small_cases, axis), "a": values[0], "b": values[1]}
        pd.DataFrame(table).to_csv(tmp_path / name, index=False)
    return ["--inflow", tmp_path / "inflow.csv", "--area", tmp_path / "area.csv"]


@pytest.fixture
def model(small_cases, toy_config, toy_engine, monkeypatch):
    """A model that ``pcnde`` finds under any name, and that nothing has to compile."""
    parameters = initial_parameters(toy_config, 20, 21, 0)
    grid = Grid(small_cases.time, small_cases.z, 1.0)
    made = PCNDE(toy_config, parameters, grid, toy_engine)
    monkeypatch.setattr(PCNDE, "load", lambda *_, **__: made)
    return made


def test_predict_writes_centrelines(small_cases, model, inputs, tmp_path, run_pcnde):
    code, printed, _ = run_pcnde("predict", "model.npz", *inputs, "--out", tmp_path / "p.vtp")
    assert code == 0
    assert "Saved 2 cases" in printed
    found = read_simvascular(sorted(tmp_path.glob("p_*.vtp")), units="cgs")
    expected = model.predict(small_cases.inflow[:2], small_cases.area_undeformed[:2])
    assert np.array_equal(found.flow, expected.flow)


def test_predict_refuses_what_it_could_not_write_before_it_computes(
    model, inputs, tmp_path, run_pcnde, monkeypatch
):
    def compute(*_, **__):
        raise AssertionError("a prediction was computed")

    monkeypatch.setattr(PCNDE, "predict", compute)
    model.parameters = model.parameters.without_pressure()
    before = sorted(tmp_path.iterdir())
    for out, message in (
        ("p.npz", "no pressure stages"),
        ("p.h5", "no pressure stages"),
        ("nowhere/p.csv", "give a file in an existing folder"),
        ("p.txt", "must end in .csv"),
    ):
        code, printed, err = run_pcnde("predict", "model", *inputs, "--out", tmp_path / out)
        assert (code, printed) == (2, "")
        assert message in err
    code, _, err = run_pcnde(
        "predict", "model", *inputs, "--samples", 3, "--out", tmp_path / "p.vtp"
    )
    assert code == 2
    assert "written to a .csv only" in err
    assert sorted(tmp_path.iterdir()) == before
