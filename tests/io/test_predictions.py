"""Prediction files by their ending, and packages that are not installed."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from io_helpers import replaced

from pcnde_bridge import Cases, FileError, InputError, PCNDEError
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.io import load_cases, read_csv, read_simvascular


def test_to_xarray(prediction):
    drawn = {name: np.stack([getattr(prediction, name)] * 2) for name in VARIABLES}
    dataset = replaced(prediction, samples=drawn).to_xarray()
    assert dataset["flow"].dims == ("case", "time", "z")
    assert dataset["pressure"].attrs["units"] == "dyn/cm^2"
    assert dataset["area_samples"].dims == ("sample", "case", "time", "z")
    assert dataset.attrs["period"] == 1.0
    one = dataset["flow"].sel(z=2.0).isel(case=1).to_numpy()
    assert np.array_equal(one, prediction.flow[1, :, 10])
    assert list(dataset["patient"].to_numpy()) == ["patient 1", "patient 2", "patient 3"]
    assert "pressure" not in replaced(prediction, pressure=None).to_xarray()


def test_save_by_ending(prediction, tmp_path):
    assert prediction.save(tmp_path / "p.h5") == [tmp_path / "p.h5"]
    assert Cases.load(tmp_path / "p.h5") == prediction.to_cases()
    flow_only = replaced(prediction, pressure=None)
    assert flow_only.save(tmp_path / "q.vtp") == sorted(tmp_path.glob("q_*.vtp"))
    assert len(list(tmp_path.glob("q_*.vtp"))) == 3
    with pytest.raises(InputError, match=r"no pressure stages.*\.csv or \.vtp"):
        flow_only.save(tmp_path / "q.npz")
    for name in ("p", "p.xlsx", "p.h5.gz", "absent/p.csv"):
        with pytest.raises(FileError, match="Cannot"):
            prediction.save(tmp_path / name)


@pytest.mark.parametrize(
    ("hidden", "extra", "use"),
    [
        ("vtkmodules", "vtk", lambda p, folder: p.save(folder / "p.vtp")),
        ("vtkmodules", "vtk", lambda p, folder: p.save(folder / "p.pvd")),
        ("xarray", "xarray", lambda p, folder: p.to_xarray()),
    ],
)
def test_a_missing_package_is_named_with_its_extra(
    prediction, tmp_path, monkeypatch, hidden, extra, use
):
    def refuse(name):
        assert name.partition(".")[0] == hidden
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr("pcnde_bridge._utils.optional.importlib.import_module", refuse)
    with pytest.raises(PCNDEError, match=rf'pip install "\.\[{extra}\]"') as caught:
        use(prediction, tmp_path)
    assert isinstance(caught.value, ImportError)


@pytest.mark.parametrize("ending", ["csv", "npz", "h5", "vtp"])
def test_wall_shear_stress_comes_back_from_every_format(
    prediction, sheared_cases, tmp_path, ending
):
    stress = sheared_cases.wall_shear_stress[[6]]
    one = {name: values[[1]] for name, values in prediction.variables().items()}
    undeformed, labels = prediction.area_undeformed[[1]], prediction.labels.iloc[[1]]
    prediction = replaced(
        prediction, **one, area_undeformed=undeformed, labels=labels, wall_shear_stress=stress
    )
    prediction.save(path := tmp_path / f"p.{ending}")
    read = {"csv": read_csv, "vtp": read_simvascular}.get(ending, load_cases)
    np.testing.assert_allclose(read(path).wall_shear_stress, stress, rtol=1e-14)


def test_labels_that_look_like_formulas_are_text_in_a_spreadsheet(prediction, tmp_path):
    names = ["=HYPERLINK(1)", "@a", "'-b"]
    labels = prediction.labels.assign(**{"patient": names, "note": ["x", "y", "=z"]})
    for name in ("p.csv", "p.csv.gz"):
        replaced(prediction, labels=labels).save(tmp_path / name)
        written = pd.read_csv(tmp_path / name, keep_default_na=False)
        assert list(written["patient"].unique()) == ["'=HYPERLINK(1)", "'@a", "''-b"]
        assert list(written["note"].unique()) == ["x", "y", "'=z"]
        found = read_csv(tmp_path / name, period=1.0).labels
        assert sorted(found["patient"]) == sorted(names)
        assert sorted(found["note"]) == ["=z", "x", "y"]
