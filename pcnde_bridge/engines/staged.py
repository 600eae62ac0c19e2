"""Trained equations in their order: coupled flow and area, then pressure."""

import numpy as np

from pcnde_bridge._typing import Array
from pcnde_bridge.config import PCNDEConfig
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.engines.parameters import Parameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import ModelInputs, Solution


def undeformed(area_undeformed: Array, n_times: int) -> Array:
    """Return S_u (case, z) at every time point: the area before the first coupling pass."""
    return np.repeat(area_undeformed[:, None], n_times, axis=1)


def anchor(n_times: int, config: PCNDEConfig) -> int:
    """Return the time point of the intermediate area that anchors the Fourier area.

    It counts from the start of the first cycle; ``n_times`` is the number in one cycle.
    """
    cycles = config.intermediate_area.cycles
    return {
        "undeformed": 0,
        "last_cycle": (cycles - 1) * n_times,
        "last_time_point": cycles * n_times - 1,
    }[config.fourier_area.anchor]


def solve_area(
    engine: Engine, parameters: Parameters, flow: Array, s_u: Array, grid: Grid, config: PCNDEConfig
) -> Array:
    """Solve both area stages: S (case, time, z) from Q (case, time, z) and S_u (case, z)."""
    continuity, series = engine.intermediate_area, engine.fourier_area
    cycles = continuity.solve(parameters.intermediate_area, (flow, s_u), grid, config)
    anchored = flow, cycles[:, anchor(flow.shape[1], config)]
    return series.solve(parameters.fourier_area, anchored, grid, config)


def predict_by_stages(
    engine: Engine, parameters: Parameters, inputs: ModelInputs, config: PCNDEConfig
) -> Solution:
    """Predict with the engine's stages, one after the other.

    Parameters
    ----------
    engine : Engine
        Compute engine.
    parameters : Parameters
        Parameters of a trained model.
    inputs : ModelInputs
        Inflow, vessels and grid.
    config : PCNDEConfig
        Settings of the model.
    """
    inflow, area_undeformed, grid = inputs
    area, settings = undeformed(area_undeformed, inflow.shape[1]), (grid, config)
    for _ in range(config.coupling_passes):
        flow = engine.flow.solve(parameters.flow, (inflow, area), *settings)
        area = solve_area(engine, parameters, flow, area_undeformed, *settings)
    if not parameters.has_pressure:
        return Solution(flow, area)
    fields = flow, area, area_undeformed
    temporal = engine.temporal_pressure.solve(parameters.temporal_pressure, fields, *settings)
    fields = temporal, flow, area_undeformed
    relative = engine.spatial_pressure.solve(parameters.spatial_pressure, fields, *settings)
    return Solution(flow, area, relative * config.physics.reference_pressure)
