"""From training cases to parameters: training procedures, optimizers, checkpoints and history.

The engines evaluate the equations; this subpackage defines the fits and their order.
"""

from pcnde_bridge.training.history import Iteration

__all__ = ["Iteration"]
