"""Centerlines as svSlicer and SimVascular's reduced-order simulations write them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from io_helpers import at_times, centerline, edited, lines, predicted, replaced, stored

from pcnde_bridge import FileError, InputError
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.io import read_simvascular, to_cases, write_pvd


def test_reads_what_the_slicer_writes(vessel, tmp_path):
    """By the number of the time step, with both ends of the cycle."""
    closed = at_times(vessel, np.arange(21) / 20)
    path = centerline(
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
    path = centerline(tmp_path / "a.vtp", vessel, drop=("velocity",), extra=extra)
    assert read_simvascular(path) == to_cases([vessel])
    with pytest.raises(InputError, match="leave time_step out"):
        read_simvascular(path, time_step=1e-3)


def test_one_branch_of_several(vessel, tmp_path):
    branches = np.array([0] * 8 + [-1] * 2 + [1] * 11)
    path = centerline(tmp_path / "a.vtp", vessel, branches=branches)
    with pytest.raises(InputError, match=r"has the branches \[0, 1\]: choose one.*--branch"):
        read_simvascular(path)
    with pytest.raises(InputError, match=r"has the branches \[0, 1\], not 2: choose one"):
        read_simvascular(path, branch=2)
    found = read_simvascular(path, branch=1)
    assert found.n_points == 11
    np.testing.assert_allclose(found.z, vessel.z[10:] - vessel.z[10])
    assert np.array_equal(found.flow[0], vessel.flow[:, 10:])


def test_a_plain_line_needs_no_branches(vessel, tmp_path):
    path = centerline(tmp_path / "a.vtp", vessel, drop=("BranchId", "Path"))
    found = read_simvascular(path)
    # Chords of a circle of 10 cm are a little shorter than its arc.
    np.testing.assert_allclose(found.z, vessel.z, rtol=1e-4)
    with pytest.raises(InputError, match="leave branch out"):
        read_simvascular(path, branch=0)


def test_rigid_walls_have_to_be_said(vessel, tmp_path):
    path = centerline(tmp_path / "a.vtp", vessel, drop=("area_",))
    with pytest.raises(InputError, match=r"no area for each time step.*--rigid"):
        read_simvascular(path)
    found = read_simvascular(path, rigid=True)
    assert np.array_equal(found.area, np.broadcast_to(vessel.area_undeformed, found.area.shape))


@pytest.mark.parametrize(
    ("drop", "extra", "message"),
    [
        (("pressure",), {}, r"no pressure_<time step> .*; it has \['BifurcationId'"),
        (("velocity",), {}, r"no flow_<time step> or velocity_"),
        (("velocity_0.5",), {}, r"no flow_0\.5 .*\(18 of 20 time steps have flow\)"),
        (("Centerline",), {}, "no undeformed area"),
        ((), {"velocity_0.3": np.ones((21, 3))}, "velocity_0.3 has 3 numbers at each point"),
    ],
)
def test_centerlines_with_missing_arrays(vessel, tmp_path, drop, extra, message):
    path = centerline(tmp_path / "a.vtp", vessel, drop=drop, extra=extra)
    with pytest.raises(InputError, match=message):
        read_simvascular(path)


@pytest.mark.parametrize("kind", ["reversed", "shuffled"])
@pytest.mark.parametrize("drop", [("Path",), ("Path", "BranchId"), ()])
def test_points_are_ordered_along_the_vessel(vessel, tmp_path, kind, drop):
    n = vessel.z.size
    order = np.arange(n)[::-1] if kind == "reversed" else np.random.default_rng(0).permutation(n)
    path = centerline(tmp_path / "a.vtp", stored(vessel, order), drop=drop)
    place = np.argsort(order)  # of each point, from the inlet on
    pairs = list(itertools.pairwise(place))
    for cells in ([place], pairs, pairs[::-1], [place[:5], place[4:], place[2:9]]):
        found = read_simvascular(edited(path, lines(*cells)))
        np.testing.assert_allclose(found.z, vessel.z, rtol=1e-3, atol=1e-12)
        assert np.array_equal(found.area_undeformed[0], vessel.area_undeformed)
        for name in VARIABLES:
            assert np.array_equal(getattr(found, name)[0], getattr(vessel, name))


@pytest.mark.parametrize(
    "cells",
    [
        [],
        [range(10)],
        [range(10), range(10, 21)],
        [range(21), (4, 20)],
        [[*range(21), 0]],
        [[0, 1, 2, 0], range(3, 21)],
    ],
)
def test_points_without_an_order_are_refused(vessel, tmp_path, cells):
    path = centerline(tmp_path / "a.vtp", vessel, drop=("Path",))
    with pytest.raises(InputError, match=r"no array Path, and no line .* points of branch 0: .*"):
        read_simvascular(edited(path, lines(*cells)))


def test_a_branch_follows_its_own_part_of_the_lines(vessel, tmp_path):
    branches = np.array([1] * 11 + [-1] * 2 + [0] * 8)
    order = np.arange(21)[::-1]
    path = centerline(tmp_path / "a.vtp", stored(vessel, order), branches=branches, drop=("Path",))
    found = read_simvascular(edited(path, lines(order)), branch=1)
    assert np.array_equal(found.flow[0], vessel.flow[:, 10:])


@pytest.mark.parametrize("step", ["0.001", True, 0, np.nan, [1.0]])
def test_a_time_step_is_a_positive_number(vessel, tmp_path, step):
    path = centerline(tmp_path / "a.vtp", vessel, steps=range(20), suffix="{:05d}".format)
    with pytest.raises(InputError, match="time_step must be"):
        read_simvascular(path, time_step=step)
    assert read_simvascular(path, time_step=np.float32(0.05)).n_times == 20


@pytest.mark.parametrize("name", ["wss_{}", "WSS_{}", "wall_shear_stress_{}", "vWSS_{}"])
def test_wall_shear_stress_of_a_centerline(sheared_vessel, tmp_path, name):
    stress = sheared_vessel.wall_shear_stress
    values = stress[..., None] * [0.6, 0.0, -0.8] if name.startswith("v") else stress
    extra = {name.format(t): row for t, row in zip(sheared_vessel.time, values, strict=True)}
    found = read_simvascular(centerline(tmp_path / "a.vtp", sheared_vessel, extra=extra))
    np.testing.assert_allclose(found.wall_shear_stress[0], stress, rtol=1e-14)
    extra.popitem()
    path = centerline(tmp_path / "a.vtp", sheared_vessel, extra=extra)
    with pytest.raises(InputError, match=r"no wall_shear_stress_0\.95 .*19 of 20 time steps"):
        read_simvascular(path)


def time_steps(folder, vessel):
    """A file for each time step, as ParaView's and SimVascular's exports are."""
    paths = []
    for i in range(vessel.time.size):
        extra = {name: getattr(vessel, name)[i] for name in ("pressure", "area")}
        extra["velocity"] = vessel.flow[i]
        path = folder / f"flow_{100 * (i + 1):05d}.vtp"
        paths.append(centerline(path, vessel, steps=(), extra=extra))
    return paths


def test_a_file_for_each_time_step(vessel, tmp_path):
    paths = time_steps(tmp_path, vessel)
    found = read_simvascular(paths[::-1], time_step=vessel.time[1] / 100)
    for name in VARIABLES:
        assert np.array_equal(getattr(found, name)[0], getattr(vessel, name))
    assert found.n_times == vessel.time.size
    with pytest.raises(InputError, match=r"flow_….vtp: .* pass the time step in s"):
        read_simvascular(paths)
    (tmp_path / "other").mkdir()
    other = time_steps(tmp_path / "other", replaced(vessel, z=1.01 * vessel.z))
    other[1].rename(paths[1])
    with pytest.raises(InputError, match=r"has other points than the first file"):
        read_simvascular(paths[:2], time_step=0.01)


def test_an_animation_comes_back(small_cases, tmp_path):
    prediction = predicted(small_cases, [0, 6, 11])
    write_pvd(prediction, tmp_path / "a.pvd")
    found = read_simvascular(tmp_path / "a.pvd")
    expected = prediction.to_cases()
    assert found.fingerprint() == expected.fingerprint()
    (tmp_path / "a.pvd").write_text('<!DOCTYPE VTKFile [<!ENTITY x "5">]><VTKFile/>')
    with pytest.raises(FileError, match=r"is not a \.pvd file"):
        read_simvascular(tmp_path / "a.pvd")
    (tmp_path / "a.pvd").write_text("<VTKFile/>")
    with pytest.raises(InputError, match="no results"):
        read_simvascular(tmp_path / "a.pvd")
