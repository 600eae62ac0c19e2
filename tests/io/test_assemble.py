"""Assembly of a data set: whole results, direction of the flow, options."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from io_helpers import replaced, results_of

from pcnde_bridge import InputError
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.io import to_cases
from pcnde_bridge.io.resampling import on_points


def test_whole_results_are_taken_as_they_are(small_cases):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = to_cases([results_of(small_cases, i) for i in (3, 6)])
    assert found.period == 1.0
    for name in (*VARIABLES, "area_undeformed"):
        assert np.array_equal(getattr(found, name), getattr(small_cases, name)[[3, 6]])
    assert list(found.labels["geometry"]) == [1, 2]


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
    with pytest.raises(InputError, match="Its sign seems to change along the vessel"):
        to_cases([replaced(vessel, flow=mixed)])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"units": "cgi"}, "Unknown units 'cgi'"),
        ({"units": 3}, "Unknown units 3; give one of"),
        ({"units": {"pressure": "bar"}}, "Unknown unit 'bar' of pressure; known are .*mmHg"),
        ({"units": {"presure": "Pa"}}, "units names 'presure'"),
        ({"flip": "area"}, "flip must be 'flow' or 'z'"),
        ({"time_points": 3}, "time_points must be a whole number ≥ 4"),
        ({"time_points": 10.5}, "time_points must be a whole number"),
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


def test_wall_shear_stress_follows_flow_and_grid(sheared_vessel, vessel):
    stress = sheared_vessel.wall_shear_stress
    coarse = to_cases([sheared_vessel], time_points=10, points=vessel.z[::2])
    np.testing.assert_allclose(coarse.wall_shear_stress[0], stress[::2, ::2], rtol=1e-3)
    # A component changes its sign with the flow, a magnitude does not.
    for given in (-stress, stress):
        other = replaced(sheared_vessel, flow=-vessel.flow, wall_shear_stress=given)
        assert to_cases([other], flip="flow") == to_cases([sheared_vessel])
    back = replaced(other, **{n: v[:, ::-1] for n, v in other.variables().items()})
    turned = to_cases([back], flip="z").wall_shear_stress
    assert np.array_equal(turned, to_cases([sheared_vessel]).wall_shear_stress)
    with pytest.raises(InputError, match="vessel has a wall shear stress, but plain has none"):
        to_cases([replaced(vessel, name="plain"), sheared_vessel])


def test_square_arrays_that_are_transposed_are_recognized(vessel):
    """Before the period is missed, which their waveform seems to lack."""
    square = on_points(vessel, vessel.time.size)
    turned = square.change(np.transpose)
    for options in ({}, {"period": 1.0}, {"units": "cgs"}):
        with pytest.raises(InputError, match=r"arrays look transposed.*np\.swapaxes"):
            to_cases([turned], **options)
    to_cases([square])
