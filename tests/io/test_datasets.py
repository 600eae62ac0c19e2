from __future__ import annotations

import functools
import hashlib
import http.server
import importlib
import socket
import threading
from pathlib import Path

import pytest

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.errors import DataNotFoundError, FileError
from pcnde_bridge.io import datasets
from pcnde_bridge.io.datasets import (
    download_published,
    find_published,
    load_cases,
)

FILES = {
    "data_3D/case_1_0/averagedTo1DFrom0_case_1_0.npy": b"first" * 1000,
    "data_3D/case_1_1/averagedTo1DFrom0_case_1_1.npy": b"second" * 1000,
    "trained_weights/ptrained_BFGS_Q.jld2": b"weights" * 1000,
}


class Server(http.server.ThreadingHTTPServer):
    """Serves FILES as the authors' repository does; ``faults`` maps a path to a mishap."""

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.asked: list[str] = []
        self.faults: dict[str, list[str]] = {}
        self.ended = threading.Event()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_port}/commit/"


class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        path = self.path.removeprefix("/commit/")
        self.server.asked.append(path)
        body = FILES.get(path.removeprefix("data/"))
        if body is None or (path.startswith("data/") != path.startswith("data/data_3D/")):
            self.send_error(404)
            return
        faults = self.server.faults.get(path, [])
        fault = faults.pop(0) if faults else ""
        if fault == "500":
            self.send_error(500)
            return
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if fault == "stall":
            self.server.ended.wait(60)
        elif fault == "cut":
            self.wfile.write(body[: len(body) // 2])
        else:
            self.wfile.write(body if fault != "altered" else body[::-1])

    def log_message(self, *_args):
        pass


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr("pooch.core.time.sleep", lambda _seconds: None)
    checksums = {name: hashlib.sha256(body).hexdigest() for name, body in FILES.items()}
    monkeypatch.setattr(datasets, "_checksums", lambda: checksums)
    with Server() as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield running
        running.ended.set()
        running.shutdown()
        thread.join()


@pytest.fixture
def elsewhere(monkeypatch, tmp_path):
    """No published data in sight: only what the test puts there."""
    monkeypatch.delenv("PCNDE_DATA", raising=False)
    monkeypatch.setenv("PCNDE_CACHE", str(tmp_path / "cache"))
    (tmp_path / "a" / "b").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "a" / "b")
    monkeypatch.setattr(datasets, "__file__", str(tmp_path / "x/y/z/io/datasets.py"))
    return tmp_path


def stored(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


# ---- downloading


def test_downloads_all_files_once(server, tmp_path, capsys):
    folder = download_published(tmp_path, base_url=server.url)
    assert stored(folder) == FILES
    assert server.asked == [
        "data/data_3D/case_1_0/averagedTo1DFrom0_case_1_0.npy",
        "data/data_3D/case_1_1/averagedTo1DFrom0_case_1_1.npy",
        "trained_weights/ptrained_BFGS_Q.jld2",
    ]
    assert "Downloading" in capsys.readouterr().err
    assert download_published(tmp_path, progress=False, base_url=server.url) == folder
    assert len(server.asked) == 3
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""


@pytest.mark.parametrize("fault", ["500", "cut", "altered"])
def test_tries_again(server, tmp_path, fault):
    path = "data/data_3D/case_1_1/averagedTo1DFrom0_case_1_1.npy"
    server.faults[path] = [fault, fault]
    folder = download_published(tmp_path, progress=False, base_url=server.url, retries=2)
    assert stored(folder) == FILES
    assert server.asked.count(path) == 3


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("500", "500 Server Error"),
        ("cut", "could not be downloaded"),
        ("altered", "it is not the published file: its checksum differs"),
    ],
)
def test_goes_on_after_an_interruption(server, elsewhere, fault, message):
    second = "data/data_3D/case_1_1/averagedTo1DFrom0_case_1_1.npy"
    server.faults[second] = [fault] * 2
    with pytest.raises(DataNotFoundError, match=message) as caught:
        download_published(progress=False, base_url=server.url, retries=1)
    text = str(caught.value)
    assert text.startswith("data_3D/case_1_1/averagedTo1DFrom0_case_1_1.npy could not be downlo")
    for part in (server.url + second, "call again to continue", "by hand", "PCNDE_DATA"):
        assert part in text
    folder = elsewhere / "cache" / "csala2024-6ec3ff9"
    first = next(iter(FILES))
    assert stored(folder) == {first: FILES[first]}
    assert find_published() is None
    server.asked.clear()
    assert download_published(progress=False, base_url=server.url) == folder
    assert len(server.asked) == 2
    assert stored(folder) == FILES
    assert find_published() == folder


def test_the_command_line_refuses_another_checksum(server, elsewhere, monkeypatch, run_pcnde):
    path = "data/data_3D/case_1_0/averagedTo1DFrom0_case_1_0.npy"
    server.faults[path] = ["altered"]
    download = functools.partial(download_published, base_url=server.url, retries=0)
    monkeypatch.setattr(datasets, "download_published", download)
    code, printed, err = run_pcnde("download", "--cache", elsewhere / "mine")
    assert (code, printed) == (2, "")
    assert "its checksum differs" in err
    assert "Traceback" not in err
    assert stored(elsewhere) == {}


def test_a_damaged_file_in_the_cache_is_replaced(server, tmp_path):
    folder = download_published(tmp_path, progress=False, base_url=server.url)
    name = next(iter(FILES))
    (folder / name).write_bytes(FILES[name][:-1])
    download_published(tmp_path, progress=False, base_url=server.url)
    assert stored(folder) == FILES
    assert len(server.asked) == 4


def test_a_download_that_stalls_is_given_up(server, tmp_path, monkeypatch):
    monkeypatch.setattr(datasets, "_STALLED", 0.2)
    path = list(FILES)[2]
    server.faults[path] = ["stall"] * 2
    with pytest.raises(DataNotFoundError, match=r"could not be downloaded.*timed out"):
        download_published(tmp_path, progress=False, base_url=server.url, retries=1)
    assert server.asked.count(path) == 2


def test_missing_certificates(server, tmp_path, monkeypatch):
    monkeypatch.setenv("REQUESTS_CA_BUNDLE", str(tmp_path / "absent.pem"))
    with pytest.raises(DataNotFoundError, match=r"absent\.pem.*REQUESTS_CA_BUNDLE or CURL"):
        download_published(tmp_path, progress=False, base_url="https://127.0.0.1:1/", retries=0)


def test_offline(server, elsewhere, monkeypatch):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{unused.getsockname()[1]}"
        with pytest.raises(DataNotFoundError, match=f"could not be downloaded from {url}/data/"):
            download_published(progress=False, base_url=url, retries=1)
        monkeypatch.setattr(
            datasets,
            "download_published",
            lambda: download_published(progress=False, base_url=url, retries=0),
        )
        with pytest.raises(DataNotFoundError, match="set PCNDE_DATA to its folder"):
            load_cases("published")


def test_unusable_cache(server, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(FileError, match=r"cannot write to the cache.*PCNDE_CACHE"):
        download_published(tmp_path / "file", progress=False, base_url=server.url)


def test_registry_names_every_file():
    checksums = datasets._checksums()
    cases = [f"case_{g}_{w}" for g in range(1, 11) for w in range(10)]
    data = {f"data_3D/{case}/averagedTo1DFrom0_{case}.npy" for case in cases}
    assert data <= set(checksums)
    assert len(checksums) == 105
    assert all(name.endswith(".jld2") for name in set(checksums) - data)
    assert all(len(checksum) == 64 for checksum in checksums.values())


@pytest.mark.data
def test_registry_matches_the_published_files(published_folder: Path):
    for name, checksum in datasets._checksums().items():
        path = published_folder / name
        if path.exists():
            assert hashlib.sha256(path.read_bytes()).hexdigest() == checksum, name


# ---- finding


def test_finds_what_pcnde_data_names(elsewhere, monkeypatch):
    (elsewhere / "mine" / "data_3D").mkdir(parents=True)
    monkeypatch.setenv("PCNDE_DATA", str(elsewhere / "mine"))
    assert find_published() == elsewhere / "mine"
    monkeypatch.setenv("PCNDE_DATA", str(elsewhere / "absent"))
    with pytest.raises(DataNotFoundError, match=r"PCNDE_DATA is '.*absent', which does not exist;"):
        find_published()
    monkeypatch.setenv("PCNDE_DATA", str(elsewhere / "mine" / "data_3D"))
    with pytest.raises(DataNotFoundError, match="contains no folder data_3D; give the folder"):
        find_published()


@pytest.mark.parametrize("place", ["a/shared/csala2024", "x/shared/csala2024"])
def test_finds_the_shared_folder(elsewhere, place):
    assert find_published() is None
    (elsewhere / place / "data_3D").mkdir(parents=True)
    assert find_published() == elsewhere / place


# ---- loading


def test_load_cases_from_anywhere(small_cases, tmp_path, monkeypatch):
    assert load_cases(small_cases) is small_cases
    for suffix in (".npz", ".h5"):
        small_cases.save(tmp_path / f"data{suffix}")
        assert load_cases(tmp_path / f"data{suffix}") == small_cases
        assert load_cases(str(tmp_path / f"data{suffix}")) == small_cases
    solver = importlib.import_module("pcnde_bridge.hemodynamics.synthetic")
    monkeypatch.setattr(solver, "synthetic", lambda: small_cases)
    assert load_cases("synthetic") is small_cases


def test_load_cases_refuses(tmp_path):
    with pytest.raises(
        DataNotFoundError, match=r"'publishd' is neither .* data set's name: 'published'"
    ):
        load_cases("publishd")
    with pytest.raises(DataNotFoundError, match="holds no folders named case_G_W"):
        load_cases(tmp_path)
    (tmp_path / "data.csv").write_text("1,2")
    with pytest.raises(
        FileError, match=r"must end in one of .*; run pcnde convert .*data.csv .*--from csv first"
    ):
        load_cases(tmp_path / "data.csv")


@pytest.mark.data
def test_load_the_published_data_by_name(published_cases: Cases):
    assert load_cases("published") == published_cases
