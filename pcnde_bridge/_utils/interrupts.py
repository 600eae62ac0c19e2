"""Ctrl-C that is not lost in long work."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def held() -> Iterator[None]:
    """Let a Ctrl-C wait: for libraries that do not survive one while they are loaded."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def kept() -> Iterator[Callable[[], None]]:
    """Keep a Ctrl-C that comes inside from being lost.

    Gives a function, to be called now and then, that raises a Ctrl-C which Python dropped:
    a KeyboardInterrupt that comes up where nobody can receive it, in ``__del__`` or in the
    callback of a weak reference, is printed and forgotten.  After long work in C such a place
    can be the first of Python to run, and a fit would go on for hours.

    A library can also make another error of it, as JAX does where it compares settings.
    Such an error leaves as the KeyboardInterrupt that it was.

    Only the main thread gets signals, and only Python's own answer to Ctrl-C is watched:
    elsewhere nothing is changed.  One inside another shares its watch.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler and not isinstance(before, _Watch):
        yield lambda: None
        return
    watch = before if isinstance(before, _Watch) else _Watch()
    signal.signal(signal.SIGINT, watch)
    try:
        yield watch.look
        watch.look()
    except Exception as error:
        if watch.came:
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)


class _Watch:
    """Python's own answer to Ctrl-C, which remembers that one came."""

    def __init__(self) -> None:
        self.came = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.came = True
        signal.default_int_handler(number, frame)

    def look(self) -> None:
        if self.came:
            raise KeyboardInterrupt
