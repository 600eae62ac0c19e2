"""Access to the reference outputs in tests/reference."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np


@functools.cache
def reference(name: str) -> dict[str, np.ndarray]:
    """Return inputs and outputs that a script in tests/reference computed."""
    with np.load(Path(__file__).parent / "reference" / f"{name}.npz") as file:
        return dict(file)


def assert_near(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Compare arrays; the tolerance is relative to the largest expected value."""
    assert found.shape == expected.shape
    error = np.abs(found - expected).max() / np.abs(expected).max()
    assert error <= tolerance, f"error {error:.2g}, tolerance {tolerance:.2g}"
