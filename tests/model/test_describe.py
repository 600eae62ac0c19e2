"""Descriptions of files: models, ensembles, checkpoints and data sets, and ``pcnde info``."""

from __future__ import annotations

import json

import pytest

from pcnde_bridge import PCNDE
from pcnde_bridge._utils.archive import write_archive
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
