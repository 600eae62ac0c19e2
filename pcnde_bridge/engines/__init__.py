"""Compute engines: the equations and their gradients, in JAX and in Julia.

Engines know arrays only; :func:`select_engine` starts one of them.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

from pcnde_bridge._utils import interrupts
from pcnde_bridge._utils.files import is_first_time
from pcnde_bridge.errors import EngineUnavailableError, InputError

if TYPE_CHECKING:
    from pcnde_bridge.engines.protocol import Engine

__all__ = ["EngineChoice", "EngineName", "select_engine"]

EngineName = Literal["auto", "julia", "julia-reference", "jax"]
EngineChoice: TypeAlias = "EngineName | Engine"

_log = logging.getLogger("pcnde_bridge")


def select_engine(name: EngineChoice = "auto") -> Engine:
    """Start an engine, once per process.

    Parameters
    ----------
    name : {'auto', 'julia', 'julia-reference', 'jax'} or Engine
        ``auto`` selects Julia if it is installed and usable on this machine,
        otherwise JAX, which is logged to ``pcnde_bridge`` at level INFO once per user, and
        each time with the reason at level DEBUG.  ``julia-reference`` computes the flow by
        the Julia libraries alone, slowly, as a standard for the others.  An engine is
        returned unchanged.

    Raises
    ------
    InputError
        If there is no engine of that name.
    EngineUnavailableError
        If the named engine cannot be used; the message says what is missing.
    """
    if not isinstance(name, str) and hasattr(name, "predict"):
        return name
    if name not in get_args(EngineName):
        raise InputError(f"Unknown engine {name!r}; choose one of {list(get_args(EngineName))}.")
    if name != "jax":
        from pcnde_bridge.engines.julia.engine import julia_engine, reference_engine
        from pcnde_bridge.engines.julia.environment import julia_status

        if name == "julia":
            return julia_engine()
        if name == "julia-reference":
            return reference_engine()
        status = julia_status()
        try:
            if status.usable:
                return julia_engine()
            reason = status.message
        except EngineUnavailableError as error:
            reason = str(error)
        _log.debug("Julia is not used: %s", reason)
        if is_first_time("jax-engine"):
            _log.info("Using the JAX engine, because Julia is not ready (see pcnde doctor).")
    with interrupts.deferred():
        from pcnde_bridge.engines.jax.engine import jax_engine
    return jax_engine()
