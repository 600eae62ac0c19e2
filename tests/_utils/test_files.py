"""Files: written completely or not at all, and read with errors that name the file."""

from __future__ import annotations

import errno
import os
import stat

import pandas as pd
import pytest

from pcnde_bridge._utils.files import (
    Budget,
    atomic_write,
    check_file,
    is_first_time,
    locked,
    plain_text,
    reading,
    without_apostrophe,
    write_json,
)
from pcnde_bridge.errors import DataNotFoundError, FileError


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_writes_a_new_file_and_replaces_an_old_one(tmp_path):
    path = tmp_path / "a.txt"
    for text in ("first", "second"):
        with atomic_write(path) as temporary:
            assert temporary.parent == tmp_path
            assert temporary.suffix == ".txt"
            temporary.write_text(text)
        assert path.read_text() == text
        assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("kind", [ZeroDivisionError, KeyboardInterrupt, DataNotFoundError])
def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path, kind):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(kind), atomic_write(path) as temporary:
        temporary.write_text("half")
        raise kind
    assert path.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.skipif(os.name == "nt", reason="needs POSIX permissions")
def test_the_file_gets_the_usual_permissions(tmp_path):
    plain, written = tmp_path / "plain", tmp_path / "written"
    plain.write_text("")
    with atomic_write(written):
        pass
    assert stat.S_IMODE(written.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


@pytest.mark.skipif(os.name == "nt", reason="needs POSIX permissions")
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o444, 0o664])
def test_an_overwritten_file_keeps_its_permissions(tmp_path, mode):
    path = tmp_path / "a.txt"
    path.write_text("old")
    path.chmod(mode)
    with atomic_write(path) as temporary:
        assert stat.S_IMODE(temporary.stat().st_mode) == 0o600
        temporary.write_text("new")
    assert (path.read_text(), stat.S_IMODE(path.stat().st_mode)) == ("new", mode)


@pytest.mark.skipif(os.name == "nt", reason="needs POSIX permissions")
def test_a_new_file_follows_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        with atomic_write(tmp_path / "a"):
            pass
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


def test_a_lock_may_be_nested_and_leaves_nothing(tmp_path):
    for path in (tmp_path / "a.txt", tmp_path):
        with locked(path), locked(path):
            with locked(path):
                assert any(name.endswith(".lock") for name in names(tmp_path))
            assert any(name.endswith(".lock") for name in names(tmp_path))
        assert names(tmp_path) == []


def test_temporary_files_of_killed_runs_are_removed(tmp_path):
    for name in (".a.txt.0123abcd.txt", ".a.txt.0123abcx.txt", ".b.txt.0123abcd.txt"):
        (tmp_path / name).touch()
    with atomic_write(tmp_path / "a.txt"):
        pass
    assert names(tmp_path) == [".a.txt.0123abcx.txt", ".b.txt.0123abcd.txt", "a.txt"]


def test_text_is_no_formula_in_a_spreadsheet():
    texts = ["=1+1", "+1", "-1", "@a", "'=1", "''-", "'", "a=1", "", "\t=1"]
    table = pd.DataFrame({"=name": texts, "number": range(-5, 5), "z": [1, *texts[1:]]})
    plain = plain_text(table)
    written = ["'=1+1", "'+1", "'-1", "'@a", "''=1", "'''-", "'", "a=1", "", "'\t=1"]
    assert plain["'=name"].tolist() == written
    assert plain["number"].tolist() == list(range(-5, 5))
    assert plain["z"].tolist() == [1, *written[1:]]
    assert [without_apostrophe(text) for text in written] == texts
    table = pd.DataFrame({"a": ["b"], "c": [-1.0]})
    assert plain_text(table) is table


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_without_a_writer_does_not_block(tmp_path, monkeypatch):
    monkeypatch.setattr("pcnde_bridge._utils.files._PATIENCE", 0.05)
    path = tmp_path / "pipe"
    os.mkfifo(path)
    message = "is a pipe to which no program writes"
    with pytest.raises(FileError, match=message), reading(path, "a thing"):
        path.read_text()
    with pytest.raises(FileError, match="it is a device or a pipe"), atomic_write(path):
        pass
    assert path.is_fifo()


def test_a_file_that_is_locked_by_another_program(tmp_path):
    path = tmp_path / "a.h5"
    path.touch()
    with pytest.raises(FileError, match="is in use by another program"), reading(path, "a file"):
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")


@pytest.mark.skipif(os.name == "nt", reason="symbolic links need rights there")
def test_follows_a_symbolic_link(tmp_path):
    (tmp_path / "real").mkdir()
    link = tmp_path / "link.txt"
    link.symlink_to(tmp_path / "real" / "a.txt")
    with atomic_write(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert (tmp_path / "real" / "a.txt").read_text() == "new"


def test_missing_folder(tmp_path):
    path = tmp_path / "absent" / "a.txt"
    with pytest.raises(FileError, match="does not exist; create it first"), atomic_write(path):
        raise AssertionError("the block must not run")


def test_target_is_a_folder(tmp_path):
    with pytest.raises(FileError, match="it is a folder; give a file name"), atomic_write(tmp_path):
        pass


def test_other_libraries_words_do_not_hide_the_reason(tmp_path):
    path = tmp_path / "a.h5"
    message = r"cannot write '.*a\.h5': File too large$"
    with pytest.raises(FileError, match=message), atomic_write(path):
        raise OSError(errno.EFBIG, "Can't write data (file descriptor = 3, buf = 0x55a4…)")
    assert names(tmp_path) == []


def test_read_only_folder(tmp_path, monkeypatch):
    def refuse(*_args, **_kwargs):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("pcnde_bridge._utils.files.os.open", refuse)
    path = tmp_path / "a.txt"
    with pytest.raises(FileError, match="no permission to write in"), atomic_write(path):
        pass


def test_full_disk(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(FileError, match="the disk is full; free some"), atomic_write(path):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert path.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_other_errors_keep_their_message(tmp_path):
    with pytest.raises(FileError, match="Input/output error"), atomic_write(tmp_path / "a.txt"):
        raise OSError(errno.EIO, "Input/output error")


def test_json_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"a": [1.5, "é"], "b": None})
    text = b'{\n "a": [\n  1.5,\n  "\\u00e9"\n ],\n "b": null\n}\n'
    assert path.read_bytes().replace(b"\r\n", b"\n") == text
    with pytest.raises(TypeError):
        write_json(path, {"a": object()})
    assert path.read_bytes().replace(b"\r\n", b"\n") == text
    write_json(path, {"a": [1, 2]}, indent=None)
    assert path.read_text() == '{"a": [1, 2]}\n'
    assert names(tmp_path) == ["a.json"]


def test_any_failure_to_read_names_the_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("text")
    for error in (ValueError("odd"), RuntimeError("odd"), MemoryError("odd"), KeyError("odd")):
        message = r"a\.txt is not a thing, or it is truncated or damaged \('?odd'?\)"
        with pytest.raises(FileError, match=message) as caught, reading(path, "a thing"):
            raise error
        assert caught.value.__cause__ is error
    with (
        pytest.raises(FileError, match=r"No permission to read .*a\.txt"),
        reading(path, "a thing"),
    ):
        raise PermissionError(errno.EACCES, "Permission denied")


@pytest.mark.parametrize("error", [FileError("ours"), KeyboardInterrupt("ours")])
def test_our_own_errors_and_ctrl_c_pass_unchanged(tmp_path, error):
    path = tmp_path / "a.txt"
    path.write_text("text")
    with pytest.raises(type(error), match=r"^ours$"), reading(path, "a thing"):
        raise error


def test_missing_files_and_folders_cannot_be_read(tmp_path):
    for check in (lambda path: check_file(path, "a thing"), lambda path: enter(path)):
        with pytest.raises(
            DataNotFoundError, match=r"There is no file .*absent \(a thing\); check the path"
        ):
            check(tmp_path / "absent")
        with pytest.raises(FileError, match="is a folder, not a thing"):
            check(tmp_path)


def enter(path):
    with reading(path, "a thing"):
        raise AssertionError("the block must not run")


def test_contents_far_larger_than_their_file_are_refused():
    Budget(1).claim(3 << 23)
    Budget(1 << 25).claim(4 << 25)
    with pytest.raises(ValueError, match="claims 25165825 bytes in a file of 1"):
        Budget(1).claim((3 << 23) + 1)
    budget = Budget(1)
    budget.claim(3 << 22)
    budget.claim(3 << 22)
    with pytest.raises(ValueError, match="claims 25165825 bytes"):
        budget.claim(1)


def test_a_notice_is_new_once_per_user(tmp_path, monkeypatch):
    monkeypatch.setenv("PCNDE_CACHE", str(tmp_path / "cache"))
    assert is_first_time("thing")
    assert not is_first_time("thing")
    assert is_first_time("other")
    (tmp_path / "file").touch()
    monkeypatch.setenv("PCNDE_CACHE", str(tmp_path / "file" / "cache"))
    assert is_first_time("thing")
    assert is_first_time("thing")
