"""From training cases to parameters: training procedures, optimizers, checkpoints and history.

The engines evaluate the equations; this room decides what is fitted and in which order.
"""

from pcnde_bridge.training.history import Iteration

__all__ = ["Iteration"]
