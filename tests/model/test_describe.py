"""Descriptions of files: models, ensembles, checkpoints and data sets, and ``pcnde info``."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from pcnde_bridge import PCNDE
from pcnde_bridge._utils.archive import read_archive, write_archive
from pcnde_bridge.errors import FileError
from pcnde_bridge.model import load_model
from pcnde_bridge.model.describe import describe, lines


def test_facts_needed_to_reproduce_a_fit(small_cases, config, engine, ensemble, tmp_path):
    ensemble.save(tmp_path / "ensemble")
    ensemble.members[1].save(tmp_path / "model")
    PCNDE.fit(small_cases, config, engine, checkpoint=tmp_path / "run", progress=False)
    found = {name: describe(tmp_path / name) for name in ("model", "ensemble", "run")}
    assert {name: value["kind"] for name, value in found.items()} == {
        "model": "model",
        "ensemble": "ensemble",
        "run": "checkpoint",
    }
    assert [found[name]["provenance"]["seed"] for name in found] == [1, 0, 0]
    assert found["ensemble"]["members"] == 3
    assert found["run"]["finished"] == found["run"]["steps"] == 2 * 3 + 2 + 2
    for value in found.values():
        facts = value["provenance"]
        assert value["preset"] == "paper"
        assert value["changes"]["batch_size"] == 5
        assert type(config).from_dict(json.loads(json.dumps(value["config"]))) == config
        assert facts["cases_fingerprint"] == small_cases.fingerprint()
        labels = small_cases.labels[["geometry", "waveform"]].to_numpy().tolist()
        assert facts["cases_labels"] == labels
        assert facts["engine"] == "toy"
        assert facts["versions"]["toy"] == "1"
        assert facts["command"]
        text = dict(lines(value))
        assert text["seed"] == str(facts["seed"])
        assert text["preset"].startswith("paper, but flow.epochs = 2")


def test_info_on_the_command_line(ensemble, tmp_path, run_pcnde):
    path = tmp_path / "ensemble"
    ensemble.save(path)
    code, printed, _ = run_pcnde("info", path)
    assert code == 0
    assert "calibrated spread" in printed
    assert "geometry 3: waveforms 0, 1, 2, 3" in printed
    code, printed, _ = run_pcnde("info", path, "--json")
    assert code == 0
    assert json.loads(printed) == json.loads(json.dumps(describe(path)))
    path.write_bytes(path.read_bytes()[:2000])
    code, _, err = run_pcnde("info", path)
    assert code == 2
    assert "damaged" in err
    write_archive(path, "something", 1, {}, {})
    code, _, err = run_pcnde("info", path)
    assert code == 2
    assert "not a pcnde_bridge model but a 'something' file" in err


@pytest.mark.parametrize("kind", ["model", "ensemble"])
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("text", "provenance must be an object, got 'text'"),
        ({"seed": "0"}, "seed must be a whole number"),
        ({"cases": None}, "cases must be a whole number"),
        ({"cases_fingerprint": 10**30}, "cases_fingerprint must be text"),
        ({"cases_labels": [[1, 2, 3]]}, "cases_labels must be a list of pairs"),
        ({"versions": ["jax"]}, "versions must be an object of text"),
        ({"versions": {"jax": "\x1b[2J"}}, "versions must be an object of text"),
        ({"seconds": "long"}, "seconds must be a number"),
        ({"command": "\x1b]0;owned\x07pcnde fit"}, "command must be text without control"),
    ],
)
def test_foreign_provenance_is_refused(
    small_model, ensemble, engine, tmp_path, run_pcnde, kind, wrong, message
):
    path = tmp_path / "file"
    model = {"model": small_model, "ensemble": ensemble}[kind]
    model.save(path)
    facts, arrays = read_archive(path, *model.file_format)
    facts["provenance"] = facts["provenance"] | wrong if isinstance(wrong, dict) else wrong
    write_archive(path, *model.file_format[:2], facts, arrays)
    with pytest.raises(FileError, match=message):
        load_model(path, engine)
    code, printed, err = run_pcnde("info", path)
    assert code == 2
    assert message in " ".join(err.split())
    assert "\x1b" not in printed + err


@pytest.mark.parametrize("provenance", [{}, {"cases": 4}])
def test_facts_of_the_provenance_may_be_missing(small_model, tmp_path, provenance):
    replace(small_model, provenance=provenance).save(tmp_path / "model")
    found = describe(tmp_path / "model")
    assert found["provenance"] == provenance
    assert dict(lines(found)).get("cases", "4, fingerprint unknown…") == "4, fingerprint unknown…"


@pytest.mark.parametrize("name", ["cases.npz", "cases.h5"])
def test_info_of_a_data_set(small_cases, tmp_path, run_pcnde, name):
    small_cases.save(tmp_path / name)
    code, printed, _ = run_pcnde("info", tmp_path / name)
    assert code == 0
    assert "data set" in printed
    assert small_cases.fingerprint()[:16] in printed
    assert dict(lines(describe(tmp_path / name)))["waveform"] == "0, 1, 2, 3"
    (tmp_path / name).write_bytes(b"PK")
    code, _, err = run_pcnde("info", tmp_path / name)
    assert code == 2
    assert "truncated" in err
