"""Checks that arguments of many functions have in common."""

from __future__ import annotations

import re

import numpy as np
import pytest

from pcnde_bridge import InputError
from pcnde_bridge.baselines import ResponseSurface
from pcnde_bridge.tube1d import Tube1D
from pcnde_bridge.validation import whole


@pytest.mark.parametrize("value", [3, np.int64(3), np.uint8(3)])
def test_whole_numbers_may_be_numpys(value):
    assert type(whole("n", value, 3)) is int
    assert Tube1D(cycles=value) == Tube1D(cycles=3)
    assert type(Tube1D(cycles=value).cycles) is int
    ResponseSurface(value, value)


@pytest.mark.parametrize("value", [2, -1, 3.0, True, np.True_, "3", None, np.array([3])])
def test_what_counts_nothing_is_refused(value):
    with pytest.raises(InputError, match=re.escape(f"n must be a whole number ≥ 3, got {value!r}")):
        whole("n", value, 3)
