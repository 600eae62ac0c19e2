"""Ctrl-C where Python drops it: in ``__del__`` and in callbacks of weak references."""

import signal
import sys
import threading

import pytest

from pcnde_bridge import PCNDE, interrupts

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


def test_python_drops_it(drop_ctrl_c, monkeypatch):
    dropped = []
    monkeypatch.setattr(sys, "unraisablehook", lambda given: dropped.append(given.exc_type))
    drop_ctrl_c()
    assert dropped == [KeyboardInterrupt]


def test_a_dropped_one_is_raised_by_the_next_look(drop_ctrl_c):
    with pytest.raises(KeyboardInterrupt), interrupts.kept() as look:
        look()
        drop_ctrl_c()
        look()
        pytest.fail("It was lost.")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_dropped_one_is_raised_at_the_end_if_nobody_looks(drop_ctrl_c):
    with pytest.raises(KeyboardInterrupt), interrupts.kept():
        drop_ctrl_c()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_without_one_nothing_is_raised():
    with interrupts.kept() as look:
        look()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_another_answer_to_ctrl_c_is_left_alone():
    heard = []
    before = signal.signal(signal.SIGINT, lambda *_: heard.append("one"))
    try:
        with interrupts.kept() as look:
            signal.raise_signal(signal.SIGINT)
            look()
    finally:
        signal.signal(signal.SIGINT, before)
    assert heard == ["one"]


@pytest.mark.parametrize("listening", [True, False])
def test_a_dropped_one_ends_training_and_is_not_lost_work(
    small_cases, toy_config, toy_engine, tmp_path, monkeypatch, drop_ctrl_c, listening
):
    solve, calls = toy_engine.flow.fit, []

    def fit(*arguments):
        calls.append(1)
        if len(calls) == 3:
            drop_ctrl_c()
        return solve(*arguments)

    monkeypatch.setattr(toy_engine.flow, "fit", fit)
    heard = []
    path = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        PCNDE.fit(
            small_cases,
            toy_config,
            toy_engine,
            checkpoint=path,
            progress=heard.append if listening else False,
        )
    assert len(calls) == 3
    assert path.exists()
    assert bool(heard) == listening


def test_other_threads_have_no_signals():
    seen = []

    def work():
        with interrupts.kept() as look:
            look()
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.default_int_handler]
