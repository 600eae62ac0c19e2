"""Draw the figures of README and documentation.

Run ``python benchmarks/figure.py PHYSICS PAPER [FOLDER]`` with models of the presets ``physics``
and ``paper`` that were trained on the published cases.  Writes ``prediction.png`` (the hardest
test case, with 90 % intervals) and ``drop.png`` (drop and FFR over the blockage) into the folder,
by default ``docs``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pcnde_bridge import PCNDE, Cases, Prediction, load_cases
from pcnde_bridge.data.units import MMHG
from pcnde_bridge.evaluation.baselines import StenosisLoss

SAMPLES = 64
TRUTH = {"ls": "none", "marker": "o", "ms": 3.5, "mfc": "none", "color": "black"}


def band(axis: Axes, x: np.ndarray, limits: tuple[np.ndarray, np.ndarray], color: str) -> None:
    """Draw a 90 % interval."""
    axis.fill_between(x, *limits, color=color, alpha=0.25, lw=0)


def prediction_figure(prediction: Prediction, cases: Cases) -> Figure:
    """Draw the inputs of a case on the left, and its results beside them."""
    figure, axes = plt.subplots(2, 3, figsize=(10, 4.8), layout="constrained")
    time, z = cases.time, cases.z
    peak = int(cases.inflow[0].argmax())
    low, high = prediction.interval(0.9)["pressure"]
    drops = np.array([sample.pressure_drop()[0] for sample in prediction.each_sample()]) / MMHG
    ffr = np.array([sample.ffr()[0] for sample in prediction.each_sample()])

    axis = axes[0, 0]
    axis.plot(time, cases.inflow[0], color="C3")
    axis.set(title="in: inflow", xlabel="time (s)", ylabel="Q (mL/s)")
    axis = axes[1, 0]
    radius = np.sqrt(cases.area_undeformed[0] / np.pi)
    axis.fill_between(z, -10 * radius, 10 * radius, color="C3", alpha=0.3)
    axis.set(title="in: vessel", xlabel="z (cm)", ylabel="radius (mm)")

    axis = axes[0, 1]
    axis.plot(z[::4], cases.pressure[0, peak, ::4] / MMHG, **TRUTH, label="3D, averaged")
    axis.plot(z, prediction.pressure[0, peak] / MMHG, color="C0", label="physics")
    band(axis, z, (low[0, peak] / MMHG, high[0, peak] / MMHG), "C0")
    axis.set(title="out: pressure at peak inflow", xlabel="z (cm)", ylabel="p (mmHg)")
    axis.legend(frameon=False, loc="lower left")
    axis = axes[1, 1]
    axis.plot(z[::2], cases.wall_shear_stress[0, peak, ::2], **TRUTH)
    axis.plot(z, prediction.wall_shear_stress[0, peak], color="C0")
    axis.set(title="out: wall shear stress at peak inflow", xlabel="z (cm)", ylabel="dyn/cm²")

    axis = axes[0, 2]
    axis.plot(time[::3], cases.pressure_drop()[0, ::3] / MMHG, **TRUTH)
    axis.plot(time, prediction.pressure_drop()[0] / MMHG, color="C0")
    band(axis, time, tuple(np.quantile(drops, (0.05, 0.95), axis=0)), "C0")
    axis.set(title="out: drop across the stenosis", xlabel="time (s)", ylabel="Δp (mmHg)")
    axis = axes[1, 2]
    axis.plot(time[::3], cases.flow[0, ::3, -1], **TRUTH)
    axis.plot(time, prediction.flow[0, :, -1], color="C0")
    axis.plot(time, cases.inflow[0], ":", color="C3", label="inflow")
    axis.set(title="out: flow at the outlet", xlabel="time (s)", ylabel="Q (mL/s)")
    axis.legend(frameon=False)
    bounds = "to".join(f" {value:.4f} " for value in np.quantile(ffr, (0.05, 0.95)))
    figure.supxlabel(
        f"out: FFR {prediction.ffr()[0]:.4f}, 90 % interval{bounds}(3D {cases.ffr()[0]:.4f})",
        fontsize="medium",
    )
    return figure


def drop_figure(physics: PCNDE, paper: PCNDE, train: Cases, cases: Cases) -> Figure:
    """Draw mean drop and 1 − FFR of all blockages under one waveform."""
    blockage = 100 * (1 - cases.area_undeformed.min(axis=1) / cases.area_undeformed[:, 0])
    prediction = physics.predict(cases, samples=SAMPLES)
    formula = Prediction(
        **StenosisLoss().fit(train).predict(cases),
        area_undeformed=cases.area_undeformed,
        time=cases.time,
        z=cases.z,
        period=cases.period,
        labels=cases.labels,
    )

    def mean_drop(case: Cases | Prediction) -> np.ndarray:
        return case.pressure_drop(units="mmHg").mean(axis=1)

    def one_minus_ffr(case: Cases | Prediction) -> np.ndarray:
        return 100 * (1 - case.ffr())

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    labels = ("mean drop (mmHg)", "1 − FFR (%)")
    for axis, quantity, label in zip(axes, (mean_drop, one_minus_ffr), labels, strict=True):
        axis.plot(blockage, quantity(cases), **TRUTH, label="3D, averaged")
        axis.plot(blockage, quantity(prediction), "C0", label="physics, 90 % interval")
        samples = np.array([quantity(sample) for sample in prediction.each_sample()])
        band(axis, blockage, tuple(np.quantile(samples, (0.05, 0.95), axis=0)), "C0")
        axis.plot(blockage, quantity(paper.predict(cases)), "C1--", label="paper")
        axis.plot(blockage, quantity(formula), "C2:", label="Seeley and Young")
        axis.set(xlabel="blocked area (%)", ylabel=label)
    axes[0].legend(frameon=False)
    return figure


def main() -> None:
    """Draw both figures."""
    physics, paper = (PCNDE.load(path) for path in sys.argv[1:3])
    folder = Path(sys.argv[3] if len(sys.argv) > 3 else "docs")
    cases = load_cases("published")
    hardest = cases.select(geometry=10, waveform=9)
    figure = prediction_figure(physics.predict(hardest, samples=SAMPLES), hardest)
    figure.savefig(folder / "prediction.png", dpi=130)
    strongest = cases.select(waveform=9)
    figure = drop_figure(physics, paper, cases.split("paper").train, strongest)
    figure.savefig(folder / "drop.png", dpi=130)


if __name__ == "__main__":
    main()
