"""Reliable handling of Ctrl-C during long computations."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def deferred() -> Iterator[None]:
    """Delay Ctrl-C until the block ends, for libraries that it would break while they load."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def watched() -> Iterator[Callable[[], None]]:
    """Watch for Ctrl-C inside the block, so that none is lost.

    Python prints and drops a KeyboardInterrupt that is raised where nobody can receive it:
    in ``__del__`` or in the callback of a weak reference.  After a long call into C such a
    place can be the first Python code to run, and a fit would continue for hours.  Libraries
    can also replace it by another error, as JAX does where it compares settings; such an
    error leaves the block as a KeyboardInterrupt.

    Only the main thread receives signals, and only Python's default handler is watched;
    otherwise nothing changes.  Nested blocks share one watch.

    Yields
    ------
    callable
        Function without arguments, to be called regularly, that raises KeyboardInterrupt
        if a Ctrl-C was dropped.
    """
    before = signal.getsignal(signal.SIGINT)
    known = before is signal.default_int_handler or isinstance(before, _Watch)
    if not known or threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    watch = before if isinstance(before, _Watch) else _Watch()
    signal.signal(signal.SIGINT, watch)
    try:
        yield watch.check
        watch.check()
    except Exception as error:
        if watch.interrupted:
            raise KeyboardInterrupt from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)


class _Watch:
    """Python's default handler of Ctrl-C, with a record of whether one occurred."""

    def __init__(self) -> None:
        self.interrupted = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.interrupted = True
        signal.default_int_handler(number, frame)

    def check(self) -> None:
        if self.interrupted:
            raise KeyboardInterrupt
