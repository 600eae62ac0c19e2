"""Choice of an engine, and what is told about it."""

from __future__ import annotations

import logging

import pytest

from pcnde_bridge import InputError, select_engine
from pcnde_bridge.engines.julia import environment


@pytest.fixture
def no_julia(monkeypatch, tmp_path):
    status = environment.JuliaStatus(message="There is no Julia. " + "Details. " * 20)
    monkeypatch.setattr(environment, "julia_status", lambda: status)
    monkeypatch.setenv("PCNDE_CACHE", str(tmp_path))


def test_the_choice_is_told_in_one_short_line_once_per_user(no_julia, caplog):
    caplog.set_level(logging.INFO, "pcnde_bridge")
    for _ in range(3):
        assert select_engine("auto").name == "jax"
    [record] = caplog.records
    assert "pcnde doctor" in record.message
    assert len(record.message) <= 80
    caplog.set_level(logging.DEBUG, "pcnde_bridge")
    select_engine("auto")
    assert "There is no Julia. Details." in caplog.text


def test_an_unknown_engine():
    with pytest.raises(InputError, match="Unknown engine 'fortran'; choose one of"):
        select_engine("fortran")
