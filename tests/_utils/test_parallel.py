"""Many tasks on any executor: equal results, separate failures, and stored results."""

from __future__ import annotations

import os
import signal
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from parallel_tasks import fail_until, held_parts, kill_once, nproc, sleep_unless_last, slowly, work

from pcnde_bridge import (
    FileError,
    InputError,
    SolveError,
    TaskError,
)
from pcnde_bridge._utils.archive import read_archive, write_archive
from pcnde_bridge._utils.parallel import (
    Outcome,
    processes,
    run,
)
from pcnde_bridge._utils.result_folder import remove_results
from pcnde_bridge._utils.workers import Parts, started_workers


def refuse(task):
    raise AssertionError("was done before")


def same(results, others):
    return list(results) == list(others) and all(
        np.array_equal(results[name]["numbers"], others[name]["numbers"])
        and results[name]["sum"] == others[name]["sum"]
        and results[name]["where"] == others[name]["where"]
        for name in results
    )


SEEDS = {f"seed {k}": k for k in range(6)}


@pytest.fixture(scope="module")
def serial():
    return run(work, SEEDS, progress=False).check()


@pytest.fixture(scope="module")
def pool():
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        yield pool


def test_in_this_process(serial):
    assert list(serial) == list(SEEDS)
    assert serial["seed 3"]["where"] == {"seed": 3}


def test_any_executor_gives_the_same(serial, pool):
    with ThreadPoolExecutor(3) as threads:
        assert same(run(work, SEEDS, executor=threads, progress=False).check(), serial)
    assert same(run(work, SEEDS, executor=pool, progress=False).check(), serial)
    assert same(run(work, SEEDS, executor=2, progress=False).check(), serial)


def test_no_tasks():
    assert run(work, {}, executor=processes(1), progress=False) == Outcome({}, {})


def test_processes_have_one_thread_of_xla(monkeypatch):
    monkeypatch.delenv("NPROC", raising=False)
    tasks = {"a": 0}
    assert run(nproc, tasks, executor=1, progress=False).results == {"a": "1"}
    assert "NPROC" not in os.environ
    with pytest.raises(InputError, match="workers must be a whole number"):
        processes(0)


# ---- failures ---------------------------------------------------------------------


@pytest.mark.parametrize("parallel", [False, True])
def test_a_failure_is_retried_or_reported_and_other_results_are_returned(tmp_path, parallel):
    tasks = {
        "good": (tmp_path / "good", 0, None),
        "once": (tmp_path / "once", 1, OSError("the network")),
        "always": (tmp_path / "always", 99, ValueError("no number")),
        "ours": (tmp_path / "ours", 99, SolveError("It diverges.")),
    }
    with ThreadPoolExecutor(2) as threads:
        executor = threads if parallel else None
        outcome = run(fail_until, tasks, executor=executor, retries=2, progress=False)
    assert outcome.results == {"good": 0, "once": 1}
    assert outcome.failures == {"always": "ValueError: no number", "ours": "It diverges."}
    tried = {name: len((tmp_path / name).read_text()) for name in tasks}
    # Errors of the package would occur again.
    assert tried == {"good": 1, "once": 2, "always": 3, "ours": 1}
    with pytest.raises(TaskError, match=r"2 of 4 tasks failed \(always: ValueError: no number; "):
        outcome.check()


def test_a_worker_that_dies_is_replaced_and_only_the_guilty_fail(tmp_path):
    tasks = {
        "innocent": (None, False),
        "once": (tmp_path / "once", False),
        "always": (tmp_path / "always", True),
        "late": (None, False),
    }
    outcome = run(kill_once, tasks, executor=processes(2), progress=False)
    assert list(outcome.results) == ["innocent", "once", "late"]
    assert outcome.failures == {"always": "its worker process died"}


def test_a_pool_that_cannot_be_replaced_reports_the_rest(tmp_path):
    tasks = {"always": (tmp_path / "always", True)} | {f"t{k}": (None, False) for k in range(3)}
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        outcome = run(kill_once, tasks, executor=pool, progress=False)
        assert outcome.results == {}
        assert list(outcome.failures) == list(tasks)
        assert "pass executor=2, which replaces it" in outcome.failures["t2"]
        again = run(kill_once, {"t": (None, False)}, executor=pool, progress=False)
        assert list(again.failures) == ["t"]


@pytest.mark.parametrize(("interrupt", "error"), [(False, InputError), (True, KeyboardInterrupt)])
def test_when_a_run_ends_early_its_workers_do(tmp_path, interrupt, error):
    tasks = {f"last {last}": (tmp_path / "pid", last, interrupt) for last in (False, True)}
    with pytest.raises(error) as caught:  # which keeps the traceback, and all that is in it
        run(sleep_unless_last, tasks, executor=processes(2), folder=tmp_path / "f", progress=False)
    worker = int((tmp_path / "pid").read_text())
    until = time.monotonic() + 30
    with pytest.raises(ProcessLookupError):
        while time.monotonic() < until:
            os.kill(worker, 0)
            time.sleep(0.02)
    assert caught.tb is not None


# ---- folder ---------------------------------------------------------------------


def stop_at(seed):
    if seed == 4:
        raise KeyboardInterrupt
    return work(seed)


def test_a_run_that_ended_continues_with_the_same_results(tmp_path, serial):
    folder = tmp_path / "results" / "of mine"
    with pytest.raises(KeyboardInterrupt):
        run(stop_at, SEEDS, folder=folder, progress=False)
    assert sorted(p.stem for p in folder.iterdir()) == [f"seed {k}" for k in range(4)]
    rest = {name: k for name, k in SEEDS.items() if k < 4}
    assert same(
        run(refuse, rest, folder=folder, progress=False).check(),
        {name: serial[name] for name in rest},
    )
    assert same(run(work, SEEDS, folder=folder, progress=False).check(), serial)
    assert same(run(refuse, SEEDS, folder=folder, progress=False).check(), serial)
    remove_results(folder)
    assert not folder.exists()


def test_results_of_other_tasks_are_refused_and_damaged_ones_made_again(tmp_path, serial, caplog):
    facts = {"config": {"hidden": (8, 8)}}
    run(work, SEEDS, folder=tmp_path, facts=facts, progress=False)
    run(refuse, SEEDS, folder=tmp_path, facts=facts, progress=False).check()
    with pytest.raises(InputError, match="is the result of other tasks"):
        run(refuse, SEEDS, folder=tmp_path, facts={"config": {}}, progress=False)
    path = tmp_path / "seed 2.npz"
    path.write_bytes(path.read_bytes()[:100])
    assert same(run(work, SEEDS, folder=tmp_path, facts=facts, progress=False).check(), serial)
    assert "The task is repeated" in caplog.text
    assert read_archive(path, "pcnde-task", 1, "result")
    for content in ({}, {"facts": facts, "values": {}, "order": ["x"]}):
        write_archive(path, "pcnde-task", 1, content, {})
        caplog.clear()
        found = run(work, SEEDS, folder=tmp_path, facts=facts, progress=False).check()
        assert same(found, serial)
        assert "not a complete result" in caplog.text
    (tmp_path / "mine.npz").write_text("not a result")
    remove_results(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.npz"]


def test_folders_and_names_that_cannot_be_used(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="Cannot create the folder"):
        run(refuse, SEEDS, folder=tmp_path / "file" / "f", progress=False)
    for name in ("", "../up", ".hidden", "a/b", "a\0", "a" * 300):
        with pytest.raises(InputError, match="cannot name a task"):
            run(refuse, {name: 1}, progress=False)
    with pytest.raises(InputError, match="only mappings of names can be stored"):
        run(abs, {"a": -1}, folder=tmp_path, progress=False)


def any_names(_):
    """Names that the archive itself uses, and numpy's numbers."""
    return {"header": np.arange(3.0), "file": np.ones(2), "count": np.int64(3), "share": 0.5}


def test_results_of_any_names_are_stored(tmp_path):
    for _ in range(2):  # the second time from the folder
        (result,) = run(any_names, {"a": 1}, folder=tmp_path, progress=False).results.values()
        assert list(result) == ["header", "file", "count", "share"]
        np.testing.assert_array_equal(result["header"], np.arange(3.0))
        np.testing.assert_array_equal(result["file"], np.ones(2))
        assert (result["count"], result["share"]) == (3, 0.5)


@pytest.mark.parametrize("result", [{"a": object()}, {"a": np.array([None])}, {1: 2.0}])
def test_a_result_that_no_file_can_hold_is_said(result, tmp_path):
    with pytest.raises(InputError, match="result of first cannot be stored"):
        run(lambda _: result, {"first": 1}, folder=tmp_path, progress=False)


# ---- dask --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def client():
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def test_dask_gives_the_same(client, serial):
    for executor in (client, client.get_executor()):
        outcome = run(work, SEEDS, executor=executor, progress=False)
        assert same(outcome.check(), serial)


def test_dask_workers_hold_their_parts(client):
    with started_workers(client) as workers:
        held = Parts([partial(pow, 2), partial(pow, 3), partial(pow, 4)], workers)
        assert held(2) == [4, 9, 16]
        assert held(3) == [8, 27, 64]
        assert sorted(client.run(held_parts).values()) == [1, 2]
    assert sorted(client.run(held_parts).values()) == [0, 0]


def test_dask_with_a_worker_killed_midway_gives_the_same(client, serial, tmp_path):
    from threading import Thread

    began, kept = tmp_path / "began", tmp_path / "kept"
    began.mkdir()
    killed = []

    def kill():
        until = time.monotonic() + 60
        while not list(kept.glob("*.npz")) or len(list(began.iterdir())) < 3:
            if time.monotonic() > until:
                return
            time.sleep(0.02)
        newest = max(began.iterdir(), key=lambda path: path.stat().st_mtime_ns)
        killed.append(int(newest.name.partition("-")[0]))
        os.kill(killed[0], signal.SIGKILL)

    thread = Thread(target=kill, daemon=True)
    thread.start()
    tasks = {name: (seed, began) for name, seed in SEEDS.items()}
    outcome = run(slowly, tasks, executor=client.get_executor(), folder=kept, progress=False)
    thread.join()
    assert same(outcome.check(), serial)
    workers = {int(path.name.partition("-")[0]) for path in Path(began).iterdir()}
    assert killed[0] in workers
    assert len(workers) >= 2
