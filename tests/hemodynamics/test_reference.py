"""The 1D solver against SciPy's solution of its equations; see tests/reference/README.md."""

from __future__ import annotations

import numpy as np
import pytest
from reference_outputs import assert_near, reference

from pcnde_bridge.hemodynamics import (
    OlufsenWall,
    Stenosis,
    Tube1D,
    Vessel,
    Waveform,
    Windkessel,
)

SETTINGS = {
    "linear": {},
    "olufsen": {
        "wall": OlufsenWall(),
        "profile_exponent": 9.0,
        "stenosis_loss": "effective_length",
    },
}


@pytest.fixture(scope="module")
def tube():
    return reference("tube")


@pytest.mark.parametrize("name", SETTINGS)
def test_solver_converges_to_the_reference(tube, name):
    mean, *harmonics = tube["inflow"].tolist()
    waveform = Waveform(mean, tuple(harmonics[:2]), tuple(harmonics[2:]))
    vessel = Vessel((Stenosis(*tube["stenosis"].tolist()),))
    outlet = Windkessel(*tube[f"{name}_outlet"])
    # Second order in time: 2e-6 with the default of 500 steps, 16 times less with 2000.
    for steps, tolerance in ((500, 5e-6), (2000, 3e-7)):
        solver = Tube1D(n_times=20, steps=steps, **SETTINGS[name])
        cases = solver.solve([vessel], [waveform], outlet, n_points=21)
        np.testing.assert_allclose(cases.area_undeformed[0], tube["area_undeformed"], rtol=1e-14)
        assert_near(cases.flow[0], tube[f"{name}_flow"], tolerance)
        assert_near(cases.pressure[0], tube[f"{name}_pressure"], tolerance)
