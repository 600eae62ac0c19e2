"""Checksums of arrays."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge._utils.checksum import sha256_arrays


def test_sha256_arrays_sees_contents_not_layout():
    array = np.arange(6.0).reshape(2, 3)
    known = sha256_arrays({"a": array, "t": np.array(["x", "yy"])})
    assert known == sha256_arrays({"a": np.asfortranarray(array), "t": np.array(["x", "yy"])})
    assert known == sha256_arrays({"a": array.astype(">f8"), "t": np.array(["x", "yy"], ">U2")})
    for other in (
        {"b": array, "t": np.array(["x", "yy"])},
        {"a": array.reshape(3, 2), "t": np.array(["x", "yy"])},
        {"a": array.astype(np.float32), "t": np.array(["x", "yy"])},
        {"a": array, "t": np.array(["xy", "y"])},
        {"t": np.array(["x", "yy"]), "a": array},
    ):
        assert sha256_arrays(other) != known
    with pytest.raises(TypeError, match="holds Python objects"):
        sha256_arrays({"a": np.array([None])})
