"""Ctrl-C where Python drops it, in ``__del__`` and in callbacks of weak references, or where a
library makes another error of it.
"""

import os
import signal
import subprocess
import sys
import threading

import pytest

from pcnde_bridge import PCNDE, PCNDEConfig
from pcnde_bridge._utils import interrupts
from pcnde_bridge._utils import jax_context as precision
from pcnde_bridge._utils.jax_context import double_precision
from pcnde_bridge.errors import EngineUnavailableError

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


def test_python_drops_it(drop_ctrl_c, monkeypatch):
    dropped = []
    monkeypatch.setattr(sys, "unraisablehook", lambda given: dropped.append(given.exc_type))
    drop_ctrl_c()
    assert dropped == [KeyboardInterrupt]


def test_a_dropped_one_is_raised_by_the_next_look(drop_ctrl_c):
    with pytest.raises(KeyboardInterrupt), interrupts.watched() as look:
        look()
        drop_ctrl_c()
        look()
        pytest.fail("It was lost.")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_dropped_ctrl_c_is_raised_at_the_end_of_the_block(drop_ctrl_c):
    with pytest.raises(KeyboardInterrupt), interrupts.watched():
        drop_ctrl_c()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_another_error_that_was_made_of_it_is_a_ctrl_c_again():
    with pytest.raises(KeyboardInterrupt) as caught, interrupts.watched():
        _make_value_error_of_ctrl_c()
    assert isinstance(caught.value.__cause__, ValueError)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_another_error_without_one_is_left_alone():
    with pytest.raises(ValueError, match="ours"), interrupts.watched():
        raise ValueError("ours")


def test_one_inside_another_shares_its_watch(drop_ctrl_c):
    with pytest.raises(KeyboardInterrupt), interrupts.watched():
        try:
            with interrupts.watched():
                drop_ctrl_c()
        except KeyboardInterrupt:
            pass
        else:
            pytest.fail("The inner one lost it.")
        assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def _make_value_error_of_ctrl_c():
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt as error:
        raise ValueError("comparing settings") from error


def test_without_ctrl_c_nothing_is_raised():
    with interrupts.watched() as look:
        look()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_another_answer_to_ctrl_c_is_left_alone():
    heard = []
    before = signal.signal(signal.SIGINT, lambda *_: heard.append("one"))
    try:
        with interrupts.watched() as look:
            signal.raise_signal(signal.SIGINT)
            look()
    finally:
        signal.signal(signal.SIGINT, before)
    assert heard == ["one"]


class _PressesCtrlC:
    """Setting that presses Ctrl-C when JAX compares it, as it compares static arguments."""

    def __init__(self, press):
        self.press = press

    def __hash__(self):
        return 1

    def __eq__(self, other):
        if self.press:
            signal.raise_signal(signal.SIGINT)
        return self is other


def test_ctrl_c_while_jax_compares_settings():
    jax = pytest.importorskip("jax")
    work = jax.jit(lambda x, setting: x + 1, static_argnames="setting")
    work(1.0, setting=_PressesCtrlC(False))
    with pytest.raises(ValueError, match="KeyboardInterrupt"):
        work(1.0, setting=_PressesCtrlC(True))
    with pytest.raises(KeyboardInterrupt), double_precision():
        work(1.0, setting=_PressesCtrlC(False))
        work(1.0, setting=_PressesCtrlC(True))


def test_ctrl_c_in_the_settings_of_a_fit_on_jax(small_cases, small_config, tmp_path, monkeypatch):
    """Regression test: the checkpoint is stored, and the task is not repeated."""
    compare, calls = PCNDEConfig.__eq__, []

    def interrupted(self, other):
        calls.append(1)
        if len(calls) == 30:
            signal.raise_signal(signal.SIGINT)
        return compare(self, other)

    monkeypatch.setattr(PCNDEConfig, "__eq__", interrupted)
    path = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        PCNDE.fit(small_cases, small_config, "jax", checkpoint=path, progress=False)
    assert len(calls) == 30
    assert path.exists()


@pytest.mark.parametrize("listening", [True, False])
def test_a_dropped_ctrl_c_ends_training_and_the_checkpoint_is_stored(
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
        with interrupts.watched() as look:
            look()
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.default_int_handler]


def test_ctrl_c_waits_while_a_library_loads():
    steps = []
    with pytest.raises(KeyboardInterrupt):
        with interrupts.deferred():
            signal.raise_signal(signal.SIGINT)
            steps.append("loaded")
        steps.append("lost")
    assert steps == ["loaded"]


FORKS = {
    "after JAX": ("import pcnde_bridge; jax.devices()", True),
    "before JAX": ("import pcnde_bridge", False),
    "before the import": ("jax.devices()", True),
}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
@pytest.mark.parametrize("name", FORKS)
def test_a_fork_of_the_users_jax_is_refused(name):
    start, refused = FORKS[name]
    code = f"""
import multiprocessing, jax
{start}

def work(_):
    import jax.numpy as jnp
    from pcnde_bridge import EngineError
    from pcnde_bridge._utils.jax_context import double_precision
    try:
        with double_precision():
            return float(jnp.ones(3).sum())
    except EngineError as error:
        return str(error)

with multiprocessing.get_context("fork").Pool(1) as pool:
    print(pool.map_async(work, [0]).get(60)[0])
"""
    found = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    assert ("JAX does not survive a fork" in found.stdout) == refused
    assert refused or found.stdout == "3.0\n"


def test_a_platform_that_is_not_there(monkeypatch):
    def fail():
        raise RuntimeError("Unable to initialize backend 'cuda'")

    monkeypatch.setattr("jax.devices", fail)
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    precision._start.cache_clear()
    with (
        pytest.raises(EngineUnavailableError, match=r"no device.*JAX_PLATFORMS, which is 'cuda'"),
        precision.double_precision(),
    ):
        pass
