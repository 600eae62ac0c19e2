"""L-BFGS of SciPy, for objectives evaluated by any engine."""

from __future__ import annotations

from pcnde_bridge._typing import Array
from pcnde_bridge.engines.types import Objective, OnIterate


def lbfgs_of_scipy(
    objective: Objective, start: Array, memory: int, iterations: int, on_iterate: OnIterate
) -> None:
    """Run SciPy's L-BFGS-B; see :data:`pcnde_bridge.engines.types.LBFGS`."""
    from scipy.optimize import OptimizeResult, minimize

    def callback(intermediate_result: OptimizeResult) -> None:
        on_iterate(intermediate_result.x.copy(), float(intermediate_result.fun))

    limits = {"maxiter": iterations, "maxfun": 20 * iterations, "maxcor": memory}
    options = {**limits, "ftol": 0.0, "gtol": 0.0}
    minimize(objective, start, jac=True, method="L-BFGS-B", callback=callback, options=options)
