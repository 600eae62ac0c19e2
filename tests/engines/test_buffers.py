"""Memory of predictions that are gone serves the next, and none that is in use."""

from __future__ import annotations

import gc

import numpy as np

from pcnde_bridge.engines import buffers
from pcnde_bridge.engines.buffers import Buffers


def address(array):
    return array.ctypes.data


def test_memory_serves_again_once_nothing_refers_to_it():
    pool = Buffers()
    first = pool.empty((4, 5))
    assert (first.shape, first.dtype) == ((4, 5), np.dtype(float))
    assert first.flags.c_contiguous
    assert first.flags.writeable
    where = address(first)
    view = first[1:, ::2]
    view[:] = 3.0
    del first
    gc.collect()
    second = pool.empty((4, 5))
    second[:] = 7.0
    assert address(second) != where
    assert (view == 3.0).all()
    del view
    gc.collect()
    assert address(pool.empty((5, 4))) == where


def test_another_size_has_memory_of_its_own():
    pool = Buffers()
    pool.empty((4, 5))
    gc.collect()
    larger = pool.empty((40, 5))
    larger[:] = 1.0
    assert larger.sum() == 200


def test_no_more_is_kept_than_two_predictions_have(monkeypatch):
    pool = Buffers()
    many = [pool.empty((10,)) for _ in range(20)]
    del many
    gc.collect()
    assert len(pool._free) == 6
    monkeypatch.setattr(buffers, "_LARGEST", 79)
    pool = Buffers()
    pool.empty((10,))
    gc.collect()
    assert len(pool._free) == 0
