"""Both engines against outputs that SciPy alone computed; see tests/reference/README.md."""

from __future__ import annotations

import numpy as np
import pytest
from reference_outputs import assert_near, reference

from pcnde_bridge.config import PAPER, PHYSICS
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.parameters import STAGES, Parameters
from pcnde_bridge.engines.types import ModelInputs


@pytest.fixture(scope="module", params=["jax", pytest.param("julia", marks=pytest.mark.julia)])
def engine(request):
    return select_engine(request.param)


# ---- stages of the paper -------------------------------------------------------------

# At 1e-12, Julia's steps across the kinks of S leave an error of 9e-9 in the area, JAX's 9e-10.
TIGHT = {"rtol": 1e-13, "atol": 1e-15, "max_steps": 16384}
PAPER_CONFIG = PAPER.replace(
    flow={"hidden": (6, 5), **TIGHT},
    fourier_area={"terms": 6},
    temporal_pressure={"hidden": (3,)},
    temporal_flow={"hidden": (6,), "time_input": True, "steps": 4},
)
EQUAL_STEPS = PAPER_CONFIG.replace(flow={"steps": 12})
WITH_TERMS = PAPER_CONFIG.replace(flow={"terms": ("friction", "convection", "inertia")})


@pytest.fixture(scope="module")
def paper():
    return reference("paper_stages")


@pytest.fixture(scope="module")
def paper_grid(paper):
    return Grid(np.arange(16) * 0.8 / 16, paper["z"], float(paper["period"]))


@pytest.mark.parametrize(
    ("config", "tolerance"),
    [
        # S has a kink at every point, where adaptive steps are off by 1e-10.
        pytest.param(PAPER_CONFIG, 1e-9, id="tight"),
        pytest.param(EQUAL_STEPS, 1e-6, id="equal steps"),
    ],
)
def test_flow(engine, paper, paper_grid, config, tolerance):
    inputs = paper["inflow"], paper["area"]
    found = engine.flow.solve(paper["parameters_flow"], inputs, paper_grid, config)
    assert_near(found, paper["flow"], tolerance)


def test_flow_with_physics_terms(engine, paper, paper_grid):
    inputs = paper["inflow"][:2] + 2.0, paper["area"][:2]
    found = engine.flow.solve(paper["parameters_flow"], inputs, paper_grid, WITH_TERMS)
    assert_near(found, paper["flow_with_terms"], 1e-9)


def test_intermediate_area(engine, paper, paper_grid):
    inputs = paper["given_flow"], paper["area_undeformed"]
    vector = paper["parameters_intermediate_area"]
    found = engine.intermediate_area.solve(vector, inputs, paper_grid, PAPER_CONFIG)
    assert_near(found, paper["intermediate_area"], 1e-13)


def test_fourier_area(engine, paper, paper_grid):
    inputs = paper["given_flow"], paper["area_undeformed"]
    vector = paper["parameters_fourier_area"]
    found = engine.fourier_area.solve(vector, inputs, paper_grid, PAPER_CONFIG)
    assert_near(found, paper["fourier_area"], 1e-13)


def test_temporal_pressure(engine, paper, paper_grid):
    inputs = paper["given_flow"], paper["area"], paper["area_undeformed"]
    vector = paper["parameters_temporal_pressure"]
    found = engine.temporal_pressure.solve(vector, inputs, paper_grid, PAPER_CONFIG)
    assert_near(found, paper["temporal_pressure"], 1e-13)


@pytest.mark.parametrize("form", ["continuous", "printed"])
def test_spatial_pressure(engine, paper, paper_grid, form):
    inputs = paper["temporal_pressure"], paper["given_flow"], paper["area_undeformed"]
    config = PAPER_CONFIG.replace(spatial_pressure={"form": form})
    vector = paper["parameters_spatial_pressure"]
    found = engine.spatial_pressure.solve(vector, inputs, paper_grid, config)
    assert_near(found, paper[f"spatial_pressure_{form}"], 1e-13)


def test_temporal_flow(engine, paper, paper_grid):
    inputs = paper["inflow"], paper["given_flow"][:, 0]
    vector = paper["parameters_temporal_flow"]
    found = engine.temporal_flow.solve(vector, inputs, paper_grid, PAPER_CONFIG)
    assert_near(found, paper["temporal_flow"], 1e-12)


@pytest.mark.parametrize(
    ("config", "tolerance"),
    [
        pytest.param(PAPER_CONFIG, 5e-9, id="tight"),
        pytest.param(EQUAL_STEPS, 1e-5, id="equal steps"),
    ],
)
def test_model_of_all_stages(engine, paper, paper_grid, config, tolerance):
    parameters = Parameters(**{stage: paper[f"parameters_{stage}"] for stage in STAGES})
    inputs = ModelInputs(paper["inflow"], paper["area_undeformed"], paper_grid)
    found = engine.predict(parameters, inputs, config)
    for name in ("flow", "area", "pressure"):
        assert_near(getattr(found, name), paper[f"model_{name}"], tolerance)


# ---- closures of preset physics ------------------------------------------------------

MEMBRANE = PHYSICS.replace(wall={"law": "membrane"}, correction={"hidden": (4,), "passes": 40})
LOCAL = MEMBRANE.replace(wall={"law": "local"})
REFINEMENT = 16  # intervals in each of the reference's


@pytest.fixture(scope="module")
def closures():
    return reference("physics_closures")


def closure_grid(closures, refinement=1):
    period = float(closures["period"])
    z = np.linspace(0.0, 4.0, 40 * refinement + 1)
    return Grid(np.arange(32) * period / 32, z, period)


def closure_flow(closures, grid):
    """Return the flow of the losses and its rate, (case, time, z)."""
    share = grid.z / 4 + np.sin(np.pi * grid.z / 4) / 10
    flow = closures["losses_inflow"][:, :, None] - share * closures["losses_stored"][:, :, None]
    # The cases have no harmonic of alternating signs.
    i_omega = 2j * np.pi * np.fft.rfftfreq(32, grid.period / 32)
    return flow, np.fft.irfft(i_omega[:, None] * np.fft.rfft(flow, axis=1), n=32, axis=1)


def vessels(closures, z):
    area, throat, width = closures["geometry"]
    bump = np.exp(-(((z - throat) / width) ** 2))
    return area * (1 - closures["blockage"][:, None] * bump)


@pytest.mark.parametrize(
    ("refinement", "parameters", "name", "tolerance"),
    [
        # The weights change within few intervals where the flow separates.
        pytest.param(REFINEMENT, "losses", "losses", 3e-3, id="without a grid"),
        # Four times as many points divide the error by 9: from 1.1e-3 to 1.2e-4.
        pytest.param(REFINEMENT, "frictionless", "frictionless", 4e-4, id="without friction"),
        # The engines take two steps of second order in each interval for the layer: 1.8e-4.
        pytest.param(1, "losses", "losses_on_grid", 5e-4, id="on the grid"),
    ],
)
def test_pressure_losses(engine, closures, refinement, parameters, name, tolerance):
    grid = closure_grid(closures, refinement)
    flow, flow_rate = closure_flow(closures, grid)
    problem = engine.closures.losses(flow, flow_rate, vessels(closures, grid.z), grid, MEMBRANE)
    found, _ = problem(closures[f"parameters_{parameters}"])
    assert_near(found[:, :, ::refinement], closures[name], tolerance)


def test_wall_shear_stress(engine, closures):
    grid = closure_grid(closures)
    flow, flow_rate = closure_flow(closures, grid)
    parameters = ClosureParameters(
        np.ones(4), closures["parameters_losses"], closures["parameters_wall"], np.zeros(25)
    )
    given = flow, flow_rate, vessels(closures, grid.z)
    problem = engine.closures.wall_shear_stress(parameters, *given, grid, MEMBRANE)
    found, _ = problem(closures["parameters_shear"])
    # The engines take two steps of second order in each interval for the layer: 6e-4.
    assert_near(found, closures["shear_on_grid"], 2e-3)


@pytest.mark.parametrize(
    ("config", "parameters", "refinement", "name", "tolerance"),
    [
        # Linear elements are off by 5e-5 of the displacement, next to the clamped ends.
        pytest.param(MEMBRANE, "wall", REFINEMENT, "membrane_area", 2e-4, id="membrane"),
        pytest.param(MEMBRANE, "wall", 1, "membrane_area_on_grid", 1e-12, id="on the grid"),
        pytest.param(LOCAL, "local", 1, "local_area", 1e-13, id="local law"),
    ],
)
def test_wall(engine, closures, config, parameters, refinement, name, tolerance):
    grid = closure_grid(closures, refinement)
    vector = closures[f"parameters_{parameters}"]
    loads = np.array([1e5 * (1 - grid.z / 8), 2e4 * np.sin(2 * grid.z + 0.3)])
    pressure = np.repeat((closures["loads_in_time"] @ loads)[None], 2, axis=0) + vector[-1]
    problem = engine.closures.area(pressure, vessels(closures, grid.z), grid, config)
    found, _ = problem(vector)
    undeformed = closures["area_undeformed"][:, None]
    assert_near(found[:, :, ::refinement] - undeformed, closures[name] - undeformed, tolerance)


@pytest.mark.parametrize(
    ("name", "loss", "tolerance", "of_change"),
    [
        # The engines leave out products of the displacements by two losses, and take the
        # losses of a flow that is stored in the shares of a uniform pressure.
        pytest.param("coupled", "losses", 5e-6, 2e-4, id="all"),
        # Where the losses are small, these simplifications are, too.
        pytest.param("coupled_weak", "weak_losses", 2e-9, 1e-7, id="weak losses"),
    ],
)
def test_coupled_prediction(engine, closures, name, loss, tolerance, of_change):
    """Outlet, losses, wall and correction together."""
    parameters = ClosureParameters(
        closures["parameters_outlet"],
        closures[f"parameters_{loss}"],
        closures["parameters_wall"],
        closures["parameters_correction"],
    )
    inflow, undeformed = closures["inflow"], closures["area_undeformed"]
    inputs = ModelInputs(inflow, undeformed, closure_grid(closures))
    found = engine.closures.predict(parameters, closures["shift"], inputs, MEMBRANE)
    for quantity in ("flow", "area", "pressure"):
        assert_near(getattr(found, quantity), closures[f"{name}_{quantity}"], tolerance)
    stored = closures[f"{name}_flow"] - inflow[:, :, None]
    assert_near(found.flow - inflow[:, :, None], stored, of_change)
