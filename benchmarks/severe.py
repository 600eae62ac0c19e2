"""Pressure drop and FFR of preset ``physics`` for severe stenoses at maximal flow.

Run ``python benchmarks/severe.py [--engine jax]``.  The reference is the 1D solver with the flow
of hyperemia, four times that at rest.  The model is trained on 8 geometries and 5 waveforms without
the outermost of each, which are the test cases.  Every other row is a change of the vessel or of
the waveform that no training case has.  The solver has no wall shear stress to compare with.
"""

from __future__ import annotations

import argparse
import dataclasses
import warnings

import numpy as np
import pandas as pd

from pcnde_bridge import PCNDE, Cases
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.outlet import Windkessel
from pcnde_bridge.hemodynamics.solver import Tube1D
from pcnde_bridge.hemodynamics.synthetic import OUTLET_RESISTANCE, base_waveform, synthetic
from pcnde_bridge.hemodynamics.waveform import Waveform
from pcnde_bridge.model.metrics import pooled_errors

HYPEREMIA = 4.0
BLOCKAGES = (0.6, 0.75)
FACTORS = (0.5, 1.0)


def solve(*stenoses: tuple[float, float], base: Waveform) -> Cases:
    """Solve vessels with stenoses at (position, length), cm, blocked 60 and 75 %."""
    vessels = [
        Vessel(tuple(Stenosis(blockage, *place) for place in stenoses)) for blockage in BLOCKAGES
    ]
    vessels = [vessel for vessel in vessels for _ in FACTORS]
    z = vessels[0].grid()
    areas = np.stack([vessel.area_undeformed(z) for vessel in vessels])
    outlet = Windkessel(OUTLET_RESISTANCE / HYPEREMIA)
    waveforms = [*base.family(FACTORS)] * len(BLOCKAGES)
    return Tube1D().solve(
        areas, waveforms, outlet, z=z, stenoses=[vessel.stenoses for vessel in vessels]
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--engine", default="jax")
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # most rows lie outside the training data
    train, test = synthetic(8, 5, hyperemia=HYPEREMIA).split("paper")
    model = PCNDE.fit(train, config="physics", engine=options.engine, progress=False)
    base = base_waveform(0, HYPEREMIA)
    sets = {
        "training": train,
        "test": test,
        "moved to 1.3 cm": solve((1.3, 0.5), base=base),
        "two, at 1.2 and 2.8 cm": solve((1.2, 0.5), (2.8, 0.5), base=base),
        "none": solve(base=base),
        "1 cm long": solve((2.0, 1.0), base=base),
        "flow 20 % higher": solve((2.0, 0.5), base=base_waveform(0, 1.2 * HYPEREMIA)),
        "period 0.8 of the training's": solve(
            (2.0, 0.5), base=dataclasses.replace(base, period=0.8 * base.period)
        ),
    }
    rows = {}
    for name, cases in sets.items():
        errors = pooled_errors(model.predict(cases).variables(), cases)
        ffr = cases.ffr()
        shown = {key: errors[key] for key in ("pressure_drop", "one_minus_ffr", "flow")}
        rows[name] = {"lowest FFR": ffr.min(), "highest FFR": ffr.max(), **shown}
    table = pd.DataFrame(rows).T
    print(table.to_string(float_format=lambda value: f"{value:.3f}"))


if __name__ == "__main__":
    main()
