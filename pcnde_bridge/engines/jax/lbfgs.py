"""L-BFGS of SciPy, for functions that any engine evaluates."""

from __future__ import annotations

from pcnde_bridge._typing import Array
from pcnde_bridge.engines.protocol import Objective, OnAccepted


def lbfgs_of_scipy(
    objective: Objective, start: Array, memory: int, iterations: int, after: OnAccepted
) -> None:
    """See :meth:`pcnde_bridge.engines.protocol.Engine.lbfgs`."""
    from scipy.optimize import OptimizeResult, minimize

    def callback(intermediate_result: OptimizeResult) -> None:
        after(intermediate_result.x.copy(), float(intermediate_result.fun))

    minimize(
        objective,
        start,
        jac=True,
        method="L-BFGS-B",
        callback=callback,
        options={
            "maxiter": iterations,
            "maxfun": 20 * iterations,
            "maxcor": memory,
            "ftol": 0.0,
            "gtol": 0.0,
        },
    )
