"""Compute the reference outputs in this folder, with NumPy and SciPy alone.

Run ``python tests/reference/compute.py`` (about a minute); see README.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import paper_stages
import physics_closures
import tube

SCRIPTS = (paper_stages, physics_closures, tube)


def main() -> None:
    for script in SCRIPTS:
        path = Path(script.__file__).with_suffix(".npz")
        np.savez_compressed(path, **script.compute())
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
