"""Draw the figure of the README: prediction and truth of the hardest test case.

Run ``python benchmarks/figure.py model.npz [docs/prediction.png]``.
"""

import sys

from pcnde_bridge import PCNDE, load_cases
from pcnde_bridge.plots import time_and_space

model = PCNDE.load(sys.argv[1])
cases = load_cases("published").select(geometry=10, waveform=9)
figure = time_and_space(model.predict(cases), cases)
figure.savefig(sys.argv[2] if len(sys.argv) > 2 else "docs/prediction.png", dpi=130)
