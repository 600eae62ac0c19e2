"""Checks of arguments that many functions share."""

from __future__ import annotations

import math
import re
from fractions import Fraction

import numpy as np
import pytest

from pcnde_bridge import InputError
from pcnde_bridge._utils.validation import (
    all_of,
    check_finite,
    check_increasing,
    check_shape,
    finite,
    positive,
    whole,
)
from pcnde_bridge.evaluation.baselines import ResponseSurface
from pcnde_bridge.hemodynamics.solver import Tube1D


@pytest.mark.parametrize("value", [3, np.int64(3), np.uint8(3)])
def test_whole_numbers_may_be_numpys(value):
    assert type(whole("n", value, 3)) is int
    assert Tube1D(cycles=value) == Tube1D(cycles=3)
    assert type(Tube1D(cycles=value).cycles) is int
    ResponseSurface(value, value)


@pytest.mark.parametrize("value", [2, -1, 3.0, True, np.True_, "3", None, np.array([3])])
def test_invalid_counts_are_rejected(value):
    with pytest.raises(InputError, match=re.escape(f"n must be a whole number ≥ 3, got {value!r}")):
        whole("n", value, 3)


@pytest.mark.parametrize("check", [finite, positive])
@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.int8(2), Fraction(2)])
def test_real_numbers_may_be_numpys(check, value):
    assert type(check("x", value)) is float
    assert check("x", value) == 2.0


@pytest.mark.parametrize("check", [finite, positive])
@pytest.mark.parametrize("value", ["1", None, True, np.True_, 1j, [1.0], np.array([1.0])])
def test_values_that_are_not_real_numbers_are_rejected(check, value):
    with pytest.raises(InputError, match=re.escape(f"x must be a number (cm), got {value!r}.")):
        check("x", value, "cm")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_infinite_numbers_are_refused(value):
    with pytest.raises(InputError, match=re.escape(f"x must be finite, got {value!r}.")):
        finite("x", value)
    with pytest.raises(InputError, match=r"x must be positive and finite \(s\), got"):
        positive("x", value, "s")


def test_positive_numbers_are_above_zero():
    assert finite("x", -1) == -1.0
    for value in (0.0, -1):
        with pytest.raises(InputError, match=f"x must be positive and finite, got {value!r}"):
            positive("x", value)


def test_objects_of_one_kind():
    assert all_of(str, "names", iter("ab")) == ("a", "b")
    with pytest.raises(InputError, match=r"names\[1\] must be a str, got int"):
        all_of(str, "names", ["a", 1])
    with pytest.raises(InputError, match=r"names must be a sequence of str, got int"):
        all_of(str, "names", 1)


def test_the_first_value_that_is_not_finite_is_named():
    check_finite("x", np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"x\[1, 0\] is nan: all values must be finite; 2 values"):
        check_finite("x", np.array([[0.0, 1.0], [np.nan, np.inf]]))
    with pytest.raises(InputError, match=r"^x is inf: all values must be finite$"):
        check_finite("x", np.array(np.inf))


@pytest.mark.parametrize("values", [[0.0, 1.0, 1.0], [0.0, 1.0, 0.5], [0.0, 1.0, np.nan]])
def test_rows_that_do_not_increase_are_refused(values):
    check_increasing("z", np.array([0.0, 1.0, 1.5]))
    with pytest.raises(InputError, match=r"z\[2\] is .*: z must be strictly increasing \(cm\)$"):
        check_increasing("z", np.array(values), "cm")


def test_shapes_are_exact():
    check_shape("x", np.zeros((2, 3)), (2, 3))
    with pytest.raises(InputError, match=r"x must have the shape \(2, 3\), but its .* \(2,\)$"):
        check_shape("x", np.zeros(2), (2, 3))
    with pytest.raises(InputError, match=r"\(3, 2\); it looks transposed$"):
        check_shape("x", np.zeros((3, 2)), (2, 3))
    with pytest.raises(
        InputError, match=r"\(case, z\) = \(2, 3\), .* pass np\.transpose\(x, \(1, 0\)"
    ):
        check_shape("x", np.zeros((3, 2)), (2, 3), "case, z")
    with pytest.raises(InputError, match=r"; for a single case pass x\[np\.newaxis\]"):
        check_shape("x", np.zeros(3), (2, 3), "case, z")
