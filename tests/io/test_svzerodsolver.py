"""Files of svZeroDSolver with one vessel."""

import json
import math

import numpy as np
import pytest

from pcnde_bridge.errors import FileError, InputError
from pcnde_bridge.hemodynamics import (
    CoronaryOutlet,
    Reflection,
    Stenosis,
    Tube1D,
    Vessel,
    Waveform,
    Windkessel,
    coronary,
)
from pcnde_bridge.io import ZeroDVessel, read_sv0d, write_sv0d

OUTLETS = {
    "RESISTANCE": Windkessel(1e5, distal_pressure=2e3),
    "RCR": Windkessel(1e4, 9e4, 1e-6, 1e3),
    "CORONARY": CoronaryOutlet(3e4, 5e4, 2e4, 4e-7, 3e-6, Waveform(4e4, (-3e4,), (2e4,)), 5e3),
}

# As in svZeroDSolver's own test "steadyFlow_R_coronary".
STEADY = {
    "boundary_conditions": [
        {"bc_name": "INFLOW", "bc_type": "FLOW", "bc_values": {"Q": [5.0, 5.0], "t": [0.0, 1.0]}},
        {
            "bc_name": "OUT",
            "bc_type": "CORONARY",
            "bc_values": {
                "Ca": 0.0001,
                "Cc": 0.0001,
                "Pim": [1000.0, 1000.0],
                "P_v": 0.0,
                "Ra1": 100.0,
                "Ra2": 100.0,
                "Rv1": 100.0,
                "t": [0.0, 1.0],
            },
        },
    ],
    "simulation_parameters": {"number_of_cardiac_cycles": 2},
    "vessels": [
        {
            "boundary_conditions": {"inlet": "INFLOW", "outlet": "OUT"},
            "vessel_id": 0,
            "vessel_length": 10.0,
            "vessel_name": "branch0_seg0",
            "zero_d_element_type": "BloodVessel",
            "zero_d_element_values": {"R_poiseuille": 100.0, "C": 1e-7},
        }
    ],
}


@pytest.mark.parametrize("kind", OUTLETS)
def test_a_written_file_is_read_again(kind, tmp_path):
    vessel = Vessel((Stenosis(0.6),), 4.0, 0.4)
    ours = ZeroDVessel.of(vessel, coronary(), OUTLETS[kind], Tube1D())
    write_sv0d(tmp_path / "vessel.json", ours)
    content = json.loads((tmp_path / "vessel.json").read_text())
    assert [c["bc_type"] for c in content["boundary_conditions"]] == ["FLOW", kind]
    again = read_sv0d(tmp_path / "vessel.json")
    assert (again.length, again.inlet, again.elements) == (4.0, "flow", ours.elements)
    time = np.linspace(0, 1, 7)
    np.testing.assert_allclose(again.waveform.flow(time), coronary().flow(time), rtol=1e-12)
    for name, value in vars(OUTLETS[kind]).items():
        found = getattr(again.outlet, name)
        if isinstance(value, Waveform):
            np.testing.assert_allclose(found.flow(time), value.flow(time), rtol=1e-12)
        else:
            assert found == value


def test_elements_and_geometry():
    healthy, length = math.pi * 0.04, 4.0
    tube = Tube1D()
    ours = ZeroDVessel.of(Vessel(), coronary(), OUTLETS["RCR"], tube)
    assert ours.elements["R_poiseuille"] == pytest.approx(8 * math.pi * 0.04 * 4 / healthy**2)
    assert ours.elements["C"] == pytest.approx(2 * healthy * length / tube.wall.stiffness(healthy))
    assert ours.elements["L"] == pytest.approx(1.06 * length / healthy)
    narrow = Vessel((Stenosis(0.7),))
    lossy = ZeroDVessel.of(narrow, coronary(), OUTLETS["RCR"], tube).elements
    excess = (1 / 0.3 - 1) ** 2
    assert lossy["stenosis_coefficient"] == pytest.approx(1.52 * 1.06 / 2 / healthy**2 * excess)
    loss = lossy["stenosis_coefficient"]
    mixed = ZeroDVessel(
        coronary(), OUTLETS["RCR"], 4.0, ours.elements | {"stenosis_coefficient": loss}
    )
    vessel, wall = mixed.geometry(tube)
    assert vessel.diameter == pytest.approx(0.4)
    assert vessel.stenoses[0].blockage == pytest.approx(0.7)
    assert wall.stiffness(healthy) == pytest.approx(tube.wall.stiffness(healthy))


def test_the_solver_stands_in_for_a_vessel(tmp_path):
    """Outlet 5·300 = 1500 dyn/cm², inlet 5·100 more, as svZeroDSolver's test expects."""
    (tmp_path / "in.json").write_text(json.dumps(STEADY))
    given = read_sv0d(tmp_path / "in.json")
    vessel, wall = given.geometry(Tube1D())
    tube = Tube1D(wall, n_times=4, steps=40)
    cases = tube.solve([vessel], [given.waveform], given.outlet, n_points=11)
    assert cases.pressure[0, -1, -1] == pytest.approx(1500.0, rel=1e-6)
    assert cases.pressure[0, -1, 0] == pytest.approx(2000.0, rel=1e-2)


def changed(**changes):
    return json.loads(json.dumps(STEADY)) | changes


@pytest.mark.parametrize(
    ("content", "error", "words"),
    [
        ("{", FileError, "not"),
        ({"vessels": [{}]}, FileError, "vessel_name"),
        (changed(vessels=STEADY["vessels"] * 0), InputError, "name one of its vessels"),
        (changed(boundary_conditions=[]), InputError, "inlet None and the outlet None"),
    ],
)
def test_files_that_cannot_be_used(content, error, words, tmp_path):
    path = tmp_path / "in.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(error, match=words):
        read_sv0d(path)


def test_vessels_that_cannot_be_written(tmp_path):
    with pytest.raises(InputError, match="no outlet Reflection"):
        write_sv0d(tmp_path / "x.json", ZeroDVessel(coronary(), Reflection(), 4.0))
    with pytest.raises(InputError, match="one value of R"):
        write_sv0d(tmp_path / "x.json", ZeroDVessel(coronary(), Windkessel([1.0, 2.0]), 4.0))
    with pytest.raises(InputError, match="positive R_poiseuille"):
        ZeroDVessel(coronary(), Windkessel(1.0), 4.0).geometry(Tube1D())
