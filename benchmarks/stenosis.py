"""Pressure drop in steady flow: preset ``physics`` beside published formulas.

Run ``python benchmarks/stenosis.py [MODEL] [--figure FILE] [--csv FILE]``.  Without a model file,
the preset is trained on the published cases first.  The vessel is long enough for the flow to
recover behind the stenosis.  The drop is the total loss: the pressure difference between the ends
minus that of Poiseuille flow in the same vessel without a stenosis, over ρU² of the healthy vessel.
A second column has the loss one diameter behind the stenosis, where the flow has not recovered.
"""

from __future__ import annotations

import argparse
import warnings

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from pcnde_bridge import PCNDE, OutsideTrainingWarning, load_cases
from pcnde_bridge.hemodynamics.geometry import Stenosis, Vessel
from pcnde_bridge.hemodynamics.pressure_losses import (
    effective_length,
    pressure_drop,
    profile_pressure_drop,
)

DIAMETER, LENGTH, SPACING = 0.4, 14.0, 0.02  # cm
CENTER = 3.0  # cm, of the stenosis
BLOCKAGES = (0.56, 0.75, 0.86, 0.89)
STENOSIS_LENGTHS = (0.5, 1.6)  # cm: that of the published cases, and four diameters
REYNOLDS = (50, 100, 200, 300, 400, 500)
DENSITY, VISCOSITY = 1.06, 0.04  # g/cm³, poise


def table(model: PCNDE) -> pd.DataFrame:
    """Return the drops over ρU², a row for each stenosis and Reynolds number."""
    z = np.arange(0, LENGTH + SPACING / 2, SPACING)
    healthy = np.pi * DIAMETER**2 / 4
    speed = np.array(REYNOLDS) * VISCOSITY / (DENSITY * DIAMETER)
    inflow = np.repeat((speed * healthy)[:, None], 32, axis=1)

    def vessel(*stenoses: Stenosis) -> np.ndarray:
        return Vessel(stenoses, LENGTH, DIAMETER).area_undeformed(z)

    def loss(area: np.ndarray) -> np.ndarray:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OutsideTrainingWarning)
            pressure = model.predict(inflow, area, z=z, units="cgs").pressure[:, 0]
        return pressure[:, :1] - pressure

    straight = loss(vessel())
    rows = []
    for length in STENOSIS_LENGTHS:
        for blockage in BLOCKAGES:
            throat = (1 - blockage) * healthy
            arguments = speed * healthy, healthy, throat
            area = vessel(Stenosis(blockage, CENTER, length))
            friction = 8 * np.pi * VISCOSITY * np.trapezoid(area**-2 - healthy**-2, z)
            lost = loss(area) - straight
            behind = np.searchsorted(z, CENTER + length / 2 + DIAMETER)
            columns = {
                "physics": lost[:, -1],
                "physics, one diameter behind": lost[:, behind],
                "Mirramezani": profile_pressure_drop(
                    speed * healthy, friction, healthy, throat, DENSITY
                ),
                "Seeley and Young": pressure_drop(*arguments, effective_length(length, throat)),
            }
            relative = {name: drop / (DENSITY * speed**2) for name, drop in columns.items()}
            where = {"blockage": blockage, "length": length, "Re": REYNOLDS}
            rows.append(pd.DataFrame(where | relative))
    found = pd.concat(rows, ignore_index=True)
    for name in ("Mirramezani", "Seeley and Young"):
        found[f"physics / {name}"] = found["physics"] / found[name]
    return found


def draw(found: pd.DataFrame) -> plt.Figure:
    """Draw the drops over the Reynolds number, a panel for each length of the stenosis."""
    figure, axes = plt.subplots(
        1, len(STENOSIS_LENGTHS), figsize=(9, 4.5), sharey=True, layout="constrained"
    )
    styles = {
        "physics": "-",
        "physics, one diameter behind": ":",
        "Mirramezani": "-.",
        "Seeley and Young": "--",
    }
    for axis, (length, part) in zip(axes, found.groupby("length"), strict=True):
        for number, (blockage, rows) in enumerate(part.groupby("blockage")):
            for name, style in styles.items():
                label = name if number == 0 else None
                axis.loglog(rows["Re"], rows[name], style, color=f"C{number}", label=label)
            axis.annotate(f"{blockage:.0%}", (520, rows["physics"].iloc[-1]), va="center")
        axis.set_xticks(REYNOLDS, [str(number) for number in REYNOLDS])
        axis.minorticks_off()
        axis.set_xlim(45, 640)
        axis.set(xlabel="Reynolds number", title=f"stenosis of {length / DIAMETER:g} diameters")
    axes[0].set_ylabel("total loss of pressure / ρU²")
    figure.legend(
        *axes[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=len(styles),
        frameon=False,
    )
    return figure


def main() -> None:
    """Print the table; draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", nargs="?")
    parser.add_argument("--figure")
    parser.add_argument("--csv")
    options = parser.parse_args()
    if options.model:
        model = PCNDE.load(options.model)
    else:
        train, _ = load_cases("published").split("paper")
        model = PCNDE.fit(train, config="physics", progress=False)
    found = table(model)
    print(found.to_string(index=False, float_format=lambda value: f"{value:.3g}"))
    if options.csv:
        found.to_csv(options.csv, index=False)
    if options.figure:
        draw(found).savefig(options.figure, dpi=130)


if __name__ == "__main__":
    main()
