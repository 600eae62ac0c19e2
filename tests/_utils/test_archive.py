"""Archives: damaged, foreign and newer files are rejected with a message that names them."""

from __future__ import annotations

import io
import json
import os
import pickle
import zipfile

import numpy as np
import pytest

from pcnde_bridge._utils.archive import (
    interpreting,
    read_archive,
    sha256_arrays,
    write_archive,
)
from pcnde_bridge.errors import FileError

KIND, VERSION = "pcnde-thing", 3
FACTS = {"name": "ä", "numbers": [1, 2.5, None], "nested": {"yes": True}}
ARRAYS = {
    "floats": np.linspace(0.1, 0.7, 20),
    "table": np.arange(6.0).reshape(2, 3) * np.pi,
    "empty": np.empty(0),
    "long": np.arange(1000.0),
    "count": np.array(7),
    "text": np.array(["a", "bcd"]),
}


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "thing.pcnde"
    write_archive(path, KIND, VERSION, FACTS, ARRAYS)
    return path


def read(path):
    return read_archive(path, KIND, VERSION, "thing")


def is_whole(facts, arrays):
    """Return whether the contents read equal those written, bit for bit."""
    expected = {"format": KIND, "format_version": VERSION, **FACTS}
    return (
        facts == expected
        and set(arrays) == set(ARRAYS)
        and all(
            arrays[name].dtype == value.dtype and np.array_equal(arrays[name], value)
            for name, value in ARRAYS.items()
        )
    )


def write_npz(path, header, **arrays):
    with path.open("wb") as handle:
        np.savez(handle, header=np.array(header), **arrays)
    return path


def test_round_trip(path):
    assert is_whole(*read(path))
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_an_older_version_is_read(path):
    facts, _ = read_archive(path, KIND, VERSION + 1, "thing")
    assert facts["format_version"] == VERSION


def test_a_newer_version_is_refused_with_advice(path):
    with pytest.raises(FileError, match=r"newer pcnde_bridge .*format 3.*up to 2.*pip install"):
        read_archive(path, KIND, VERSION - 1, "thing")


@pytest.mark.parametrize("version", ["3", None, 3.5, [3]])
def test_a_version_that_is_no_number(tmp_path, version):
    header = json.dumps({"format": KIND, "format_version": version})
    with pytest.raises(FileError, match="newer"):
        read(write_npz(tmp_path / "f", header))


def test_another_kind_is_named(path):
    with pytest.raises(FileError, match="not a pcnde_bridge model but a 'pcnde-thing' file"):
        read_archive(path, "pcnde-model", VERSION, "model")


@pytest.mark.parametrize("header", ["[]", "3", '"text"', "{}", "not json", "", "[" * 50_000])
def test_a_header_that_is_not_ours(tmp_path, header):
    with pytest.raises(FileError, match="thing"):
        read(write_npz(tmp_path / "f", header))


def test_truncated_anywhere(path):
    whole = path.read_bytes()
    for length in sorted({*range(0, len(whole), 37), *range(len(whole) - 30, len(whole)), 1, 2, 4}):
        path.write_bytes(whole[:length])
        with pytest.raises(FileError, match="thing"):
            read(path)


def test_a_flipped_byte_is_found_or_harmless(path):
    """Bytes that no CRC covers must not change the contents."""
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    data = whole.index(b"(1000,)") + 200
    for position in [*range(0, data, 5), *range(data + 7500, len(whole), 5)]:
        for flip in (1, int(rng.integers(2, 256))):
            damaged = bytearray(whole)
            damaged[position] ^= flip
            path.write_bytes(damaged)
            try:
                facts, arrays = read(path)
            except FileError:
                refused += 1
            else:
                assert is_whole(facts, arrays), (position, flip)
    assert refused > 400


@pytest.mark.parametrize(
    ("old", "new"), [(b"(1000,)", b"(0000,)"), (b"(1000,)", b"(100,) "), (b"(2, 3)", b"(1, 3)")]
)
def test_a_damaged_shape_is_found(path, old, new):
    """The reader must read past a shorter array, or the checksum is never compared."""
    whole = path.read_bytes()
    at = whole.index(old)
    path.write_bytes(whole[:at] + new + whole[at + len(old) :])
    with pytest.raises(FileError, match="damaged"):
        read(path)


def test_an_array_that_is_gone_is_missed(path, tmp_path):
    other = tmp_path / "less"
    with zipfile.ZipFile(path) as whole, zipfile.ZipFile(other, "w") as less:
        for name in whole.namelist():
            if name != "table.npy":
                less.writestr(name, whole.read(name))
    with pytest.raises(FileError, match=r"damaged .*arrays are missing"):
        read(other)


def test_foreign_files(tmp_path):
    path = tmp_path / "foreign"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "hello")
    with pytest.raises(FileError, match="not a pcnde_bridge thing"):
        read(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("header.npy", "hello")
    with pytest.raises(FileError, match="thing"):
        read(path)
    path.write_text("time,a\n0,1\n")
    with pytest.raises(FileError, match="not a pcnde_bridge thing"):
        read(path)
    np.save(path.with_suffix(".npy"), np.arange(3.0))
    with pytest.raises(FileError, match="not a pcnde_bridge thing"):
        read(path.with_suffix(".npy"))
    path.write_bytes(b"")
    with pytest.raises(FileError, match="not a pcnde_bridge thing"):
        read(path)


@pytest.mark.parametrize("start", [b"", b"PK\x03\x04", b"PK\x05\x06", b"\x93NUMPY\x01\x00"])
def test_random_bytes(tmp_path, start):
    path = tmp_path / "noise"
    for seed in range(20):
        path.write_bytes(start + np.random.default_rng(seed).bytes(50 * (seed + 1)))
        with pytest.raises(FileError, match="thing"):
            read(path)


def test_missing_and_folder(tmp_path):
    with pytest.raises(FileError, match=r"There is no file .*nowhere"):
        read(tmp_path / "nowhere")
    with pytest.raises(FileError, match="is a folder, not a pcnde_bridge thing"):
        read(tmp_path)


def test_no_permission(path, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(np, "load", refuse)
    with pytest.raises(FileError, match=r"No permission to read .*thing\.pcnde"):
        read(path)


class _Bomb:
    """Object that creates a file if it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (self.path, "w")


def test_pickled_objects_are_refused_unopened(tmp_path):
    bomb = _Bomb(str(tmp_path / "exploded"))
    header = json.dumps({"format": KIND, "format_version": VERSION})
    objects = np.array([bomb, 1], dtype=object)
    for name in ("array", "header"):
        path = tmp_path / f"objects in {name}"
        with path.open("wb") as handle:
            if name == "array":
                np.savez(handle, header=np.array(header), array=objects)
            else:
                np.savez(handle, header=objects)
        with pytest.raises(FileError, match="thing"):
            read(path)
    path.write_bytes(pickle.dumps(bomb))
    with pytest.raises(FileError, match="thing"):
        read(path)
    assert not (tmp_path / "exploded").exists()


def test_objects_are_never_written(tmp_path):
    with pytest.raises((TypeError, ValueError)):
        write_archive(tmp_path / "f", KIND, VERSION, {}, {"a": np.array([{}, 1], dtype=object)})
    assert list(tmp_path.iterdir()) == []


def test_a_huge_header_is_not_read(tmp_path):
    path = tmp_path / "huge"
    header = json.dumps({"format": KIND, "format_version": VERSION, "a": "x" * 5_000_000})
    with path.open("wb") as handle:
        np.savez_compressed(handle, header=np.array(header))
    assert path.stat().st_size < 1_000_000
    with pytest.raises(FileError, match="not a pcnde_bridge thing"):
        read(path)


def test_a_header_that_claims_to_be_huge(tmp_path):
    """The header of the array claims 2^50 numbers; the file has none."""
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        buffer, {"descr": "<f8", "fortran_order": False, "shape": (1 << 50,)}
    )
    path = write_npz(tmp_path / "claims", json.dumps({"format": KIND, "format_version": VERSION}))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("claims.npy", buffer.getvalue())
    with pytest.raises(FileError, match="thing"):
        read(path)


def test_writing_where_it_cannot_be(tmp_path):
    with pytest.raises(FileError, match="does not exist"):
        write_archive(tmp_path / "nowhere" / "f", KIND, VERSION, {}, {})
    with pytest.raises(FileError, match="folder"):
        write_archive(tmp_path, KIND, VERSION, {}, {})


def test_a_failed_write_leaves_the_old_file(path, monkeypatch):
    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(FileError, match="disk is full"):
        write_archive(path, KIND, VERSION, {}, {})
    monkeypatch.undo()
    assert is_whole(*read(path))
    assert os.listdir(path.parent) == [path.name]  # noqa: PTH208


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (KeyError("time"), "it lacks 'time'"),
        (ValueError("too long"), "too long"),
        (TypeError("no number"), "no number"),
        (IndexError("out of range"), "out of range"),
        (OverflowError("too large"), "too large"),
    ],
)
def test_contents_that_do_not_fit_are_an_error_of_the_file(error, reason):
    with (
        pytest.raises(FileError, match=f"^f.npz is not a complete thing: {reason}.$") as caught,
        interpreting("f.npz", "thing"),
    ):
        raise error
    assert caught.value.__cause__ is error


def test_an_error_of_a_file_is_not_wrapped_again():
    with pytest.raises(FileError, match=r"^a\.npz is damaged$"), interpreting("b.npz", "thing"):
        raise FileError("a.npz is damaged")


def test_sha256_arrays_sees_contents_not_layout():
    array = np.arange(6.0).reshape(2, 3)
    known = sha256_arrays({"a": array, "t": np.array(["x", "yy"])})
    assert known == sha256_arrays({"a": np.asfortranarray(array), "t": np.array(["x", "yy"])})
    assert known == sha256_arrays({"a": array.astype(">f8"), "t": np.array(["x", "yy"], ">U2")})
    for other in (
        {"b": array, "t": np.array(["x", "yy"])},
        {"a": array.reshape(3, 2), "t": np.array(["x", "yy"])},
        {"a": array.astype(np.float32), "t": np.array(["x", "yy"])},
        {"a": array, "t": np.array(["xy", "y"])},
        {"t": np.array(["x", "yy"]), "a": array},
    ):
        assert sha256_arrays(other) != known
    with pytest.raises(TypeError, match="holds Python objects"):
        sha256_arrays({"a": np.array([None])})
