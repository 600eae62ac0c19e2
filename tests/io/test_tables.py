"""Labels of files in a CSV table."""

from __future__ import annotations

import pytest
from io_helpers import centerline, results_of

from pcnde_bridge import FileError, InputError
from pcnde_bridge.io import read_labels, read_simvascular


def test_labels_by_file(small_cases, tmp_path):
    paths = [centerline(tmp_path / f"{i}.vtp", results_of(small_cases, i)) for i in (0, 4, 5)]
    table = tmp_path / "labels.csv"
    table.write_text("file,waveform,geometry,note\n5.vtp,1,2,b\n0.vtp,0,1,a\n4.vtp,0,2,c\n")
    cases = read_simvascular(paths, labels=read_labels(table, paths))
    assert list(cases.labels["geometry"]) == [1, 2, 2]
    assert list(cases.labels["note"]) == ["a", "c", "b"]
    table.write_text("file,waveform,geometry\n5.vtp,1,2\n")
    with pytest.raises(InputError, match=r"has 0 rows for .*0\.vtp; it needs one"):
        read_labels(table, paths)
    table.write_text("name,waveform,geometry\n5.vtp,1,2\n")
    with pytest.raises(InputError, match="lacks the column 'file'"):
        read_labels(table, paths)
    with pytest.raises(FileError, match="There is no file"):
        read_labels(tmp_path / "nowhere.csv", paths)
