"""Options that several commands share."""

from __future__ import annotations

import pytest

from pcnde_bridge.cli.options import split_of
from pcnde_bridge.errors import DataNotFoundError, InputError


@pytest.mark.parametrize("data", ["published", "synthetic"])
def test_data_sets_by_name_keep_the_split_of_the_paper(small_cases, capsys, data):
    sets = split_of(small_cases, data, None)
    assert tuple(sets.values()) == small_cases.split("paper")
    assert "The split paper has 6 training cases and 6 test cases." in capsys.readouterr().err
    assert split_of(small_cases, data, "none") == {"train": small_cases}


@pytest.mark.parametrize("data", ["mine.h5", "./published"])
def test_own_data_are_not_divided_unless_asked_for(small_cases, capsys, data):
    assert split_of(small_cases, data, None) == {"train": small_cases}
    assert "All 12 cases are training cases: --split" in capsys.readouterr().err
    assert split_of(small_cases, data, None, "all") == {"all": small_cases}
    assert "All 12 cases are evaluated: --split" in capsys.readouterr().err
    assert tuple(split_of(small_cases, data, "paper").values()) == small_cases.split("paper")


def test_split_by_fraction_or_label(small_cases, capsys):
    for split, expected in (
        ("0.25", small_cases.split(0.25)),
        ("geometry=1,3", small_cases.split(geometry=[1, 3])),
        ("waveform=0", small_cases.split(waveform=0)),
        ("patient=patient 2", small_cases.split(patient="patient 2")),
    ):
        assert tuple(split_of(small_cases, "mine.h5", split).values()) == expected
    assert "The split 0.25 has 9 training cases and 3 test cases." in capsys.readouterr().err


@pytest.mark.parametrize(
    ("split", "error", "message"),
    [
        ("2", InputError, "between 0 and 1, got 2"),
        ("geometry=5", InputError, "no case has geometry = 5; the values are: 1, 2, 3"),
        ("geometry=a", InputError, "no case has geometry = a; the values are: 1, 2, 3"),
        ("geometri=1", InputError, "no label 'geometri'; the labels are 'geometry', 'wave"),
        ("papre", DataNotFoundError, "no split file 'papre'; give 'paper', a fraction"),
        ("", InputError, "--split is empty"),
    ],
)
def test_unusable_splits_are_refused(small_cases, split, error, message):
    with pytest.raises(error, match=message):
        split_of(small_cases, "mine.h5", split)


def test_a_file_may_have_an_equals_sign(small_cases, tmp_path):
    path = tmp_path / "a=b.json"
    path.write_text('{"train": [[1, 0]], "test": [[2, 0]]}')
    assert len(split_of(small_cases, "mine.h5", str(path))["test"]) == 1


@pytest.mark.parametrize("command", [("predict", "--indices"), ("evaluate", "--csv")])
def test_tables_have_the_ending_of_tables(run_pcnde, command):
    name, flag = command
    code, _, err = run_pcnde(name, "m.npz", "d.npz", flag, "indices.npz")
    assert code == 2
    assert "indices.npz will be a table: its name must end in .csv or .csv.gz" in err
