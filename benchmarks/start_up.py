"""CPU time from the start of Python to the first prediction with Julia, step by step.

Run ``python benchmarks/start_up.py MODEL``, with a model of ``pcnde fit published --preset
physics --out MODEL``, twice: the first run may compile packages.
"""

import resource
import sys


def step(name: str, before: float) -> float:
    """Print the CPU time of this process since ``before``, and return the time until now."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    now = used.ru_utime + used.ru_stime
    print(f"{name:20} {now - before:.2f} s, together {now:.2f} s")
    return now


def main() -> None:
    """Run all steps."""
    from pcnde_bridge import load_model
    from pcnde_bridge.engines import select_engine
    from pcnde_bridge.engines.julia import runtime
    from pcnde_bridge.hemodynamics import Stenosis, Vessel, coronary

    now = step("import", 0.0)
    julia = runtime.start().Main
    julia.seval("nothing")
    now = step("Julia, PythonCall", now)
    call = julia.seval(runtime._LOAD)
    now = step("PCNDECore", now)
    call("versions")
    now = step("first call", now)
    engine = select_engine("julia")
    now = step("engine, self-check", now)
    load_model(sys.argv[1], engine).predict(Vessel((Stenosis(0.6),)), coronary())
    step("prediction", now)


if __name__ == "__main__":
    main()
