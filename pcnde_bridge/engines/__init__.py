"""Computing engines: the same equations, computed by Julia or by JAX."""

from __future__ import annotations

import logging
from functools import cache
from typing import Literal, get_args

from pcnde_bridge._utils import interrupts
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.errors import EngineUnavailableError, InputError

__all__ = ["Engine", "EngineName", "select_engine"]

EngineName = Literal["auto", "julia", "jax"]

_log = logging.getLogger("pcnde_bridge")


def select_engine(name: EngineName | Engine = "auto") -> Engine:
    """Start an engine, once per process.

    Parameters
    ----------
    name : {'auto', 'julia', 'jax'} or Engine
        ``auto`` takes Julia when it is usable on this machine as it is, else
        JAX; which, and why, is logged to ``pcnde_bridge`` at level INFO.  An
        engine is returned as it is.

    Raises
    ------
    InputError
        If there is no engine of that name.
    EngineUnavailableError
        If the engine asked for by name cannot be used; says what is missing.
    """
    if not isinstance(name, str) and hasattr(name, "predict"):
        return name
    if name not in get_args(EngineName):
        raise InputError(f"Unknown engine {name!r}; choose one of {list(get_args(EngineName))}.")
    if name == "julia":
        return _julia()
    if name == "jax":
        return _jax()
    why = why_not_julia()
    if why is None:
        try:
            engine = _julia()
        except EngineUnavailableError as error:
            why = str(error)
        else:
            _log.info("Computing with the Julia engine: Julia is usable on this machine.")
            return engine
    _log.info("Computing with the embedded JAX engine: %s", why)
    return _jax()


def why_not_julia() -> str | None:
    """Reason why Julia is not usable as the machine is, found without starting it."""
    from pcnde_bridge.engines.julia.engine import julia_status

    status = julia_status()
    return None if status.usable else status.message


@cache
def _jax() -> Engine:
    try:
        with interrupts.held():
            from pcnde_bridge.engines.jax.engine import JaxEngine
    except ImportError as error:
        raise EngineUnavailableError(
            f"The JAX engine needs jax and diffrax, but {error}. "
            "Install them: pip install jax diffrax."
        ) from error
    return JaxEngine()


@cache
def _julia() -> Engine:
    from pcnde_bridge.engines.julia.engine import JuliaEngine

    return JuliaEngine()
