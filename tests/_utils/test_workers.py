"""Parts of the data on workers."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial

import pytest

from pcnde_bridge._utils import workers as module
from pcnde_bridge._utils.workers import Parts, Worker, started_workers
from pcnde_bridge.errors import InputError, TaskError


@pytest.fixture
def workers(monkeypatch):
    """Two workers, each a thread."""
    monkeypatch.setattr(module, "_PATIENCE", 0.05)
    pools = [ThreadPoolExecutor(1) for _ in range(2)]
    yield [Worker(pool.submit, str(number)) for number, pool in enumerate(pools)]
    for pool in pools:
        pool.shutdown()


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_have_the_order_of_the_parts(workers, count):
    parts = Parts((partial(pow, n) for n in range(count)), workers)
    assert (
        parts(3) == Parts(partial(pow, n) for n in range(count))(3) == [n**3 for n in range(count)]
    )


def test_an_error_of_a_part_is_that_of_the_call(workers):
    with pytest.raises(ZeroDivisionError):
        Parts([partial(divmod, 1)], workers)(0)


def test_a_worker_that_ended_is_an_error(workers):
    class Ended:
        def result(self, timeout):
            raise self.error

    for error in (TimeoutError(), BrokenProcessPool()):
        ended = Ended()
        ended.error = error
        with pytest.raises(TaskError, match="A worker ended"):
            Worker(None, "", lambda: False).result(ended)


def test_processes_hold_their_parts():
    with started_workers(2) as found:
        assert Parts([partial(pow, 2), partial(pow, 3), partial(pow, 4)], found)(2) == [4, 9, 16]
    with started_workers(None) as found:
        assert found == []
    with pytest.raises(InputError, match="number of processes or a dask client, got str"):
        started_workers("two").__enter__()
