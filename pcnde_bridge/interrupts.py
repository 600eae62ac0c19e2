"""Ctrl-C that is not lost in long work."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def kept() -> Iterator[Callable[[], None]]:
    """Give a function, to be called now and then, that raises a Ctrl-C which Python dropped.

    A KeyboardInterrupt that comes up where nobody can receive it, in ``__del__`` or in the
    callback of a weak reference, is printed and forgotten.  After long work in C such a place
    can be the first of Python to run, and a fit would go on for hours.

    Only the main thread gets signals, and only Python's own answer to Ctrl-C is watched:
    elsewhere the function does nothing.
    """
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield lambda: None
        return
    came = False

    def answer(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came = True
        signal.default_int_handler(number, frame)

    def check() -> None:
        if came:
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, answer)
    try:
        yield check
        check()
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
