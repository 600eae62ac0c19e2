"""The folder layout of the published data, and the data itself."""

from __future__ import annotations

import numpy as np
import pytest

from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.published import read_authors_folder
from pcnde_bridge.errors import DataNotFoundError, FileError
from pcnde_bridge.model.metrics import pooled_errors


def case_data(seed=0):
    """A made-up case of the published shape."""
    rng = np.random.default_rng(seed)
    undeformed = np.broadcast_to(rng.uniform(0.08, 0.12, size=101), (100, 101))
    force = 1e5 * undeformed * rng.uniform(0.9, 1.1, size=(100, 101))
    flow = np.broadcast_to(rng.uniform(1, 2, size=(100, 1)), (100, 101))
    return np.stack([flow, force, undeformed, 1.05 * undeformed, 0 * flow, 0 * flow])


def write_case(folder, name, data):
    (folder / name).mkdir(parents=True)
    np.save(folder / name / f"averagedTo1DFrom0_{name}.npy", data)


def test_reads_a_folder_in_numerical_order(tmp_path):
    order = [(1, 0), (2, 9), (2, 10), (10, 1)]
    for seed, (g, w) in enumerate(order):
        write_case(tmp_path / "data_3D", f"case_{g}_{w}", case_data(seed))
    (tmp_path / "data_3D" / "case_1_0" / "mesh-complete").mkdir()
    (tmp_path / "data_3D" / "case_x_0").mkdir()
    (tmp_path / "data_3D" / "notes.txt").write_text("left alone")
    cases = read_authors_folder(tmp_path)
    assert cases == read_authors_folder(str(tmp_path / "data_3D"))
    assert list(zip(cases.labels.geometry, cases.labels.waveform, strict=True)) == order
    assert list(cases.labels.blockage) == [0.4, 0.45, 0.45, 0.85]
    assert cases.flow.shape == (4, 100, 101)
    assert cases.period == 1.0
    assert (cases.time[0], cases.time[29], cases.time[-1]) == (0.0, 0.29, 0.99)
    assert (cases.z[0], cases.z[29], cases.z[-1]) == (0.0, 1.16, 4.0)
    third = case_data(2)
    assert np.array_equal(cases.flow[2], third[0])
    assert np.array_equal(cases.pressure[2], third[1] / third[2])
    assert np.array_equal(cases.area_undeformed[2], third[2, 0])
    assert np.array_equal(cases.area[2], third[3])
    assert cases.wall_shear_stress is None


def test_reads_the_wall_shear_stress(tmp_path):
    data = case_data()
    data[4] = np.nan  # the displacement is not used
    data[5] = 4 * 0.04 * data[0] / np.sqrt(data[2] ** 3 / np.pi)
    write_case(tmp_path, "case_1_0", data)
    cases = read_authors_folder(tmp_path)
    assert np.array_equal(cases.wall_shear_stress[0], data[5])
    data[5, 3, 5] = np.inf
    write_case(tmp_path, "case_1_1", data)
    with pytest.raises(FileError, match=r"value \(5, 3, 5\) is inf"):
        read_authors_folder(tmp_path)


def test_no_folder_and_no_cases(tmp_path):
    with pytest.raises(DataNotFoundError, match="there is no folder"):
        read_authors_folder(tmp_path / "absent")
    (tmp_path / "case_01_2").mkdir()
    with pytest.raises(DataNotFoundError, match="holds no folders named case_G_W"):
        read_authors_folder(tmp_path)


def with_value(variable, value):
    data = case_data()
    data[variable, 3, 5] = value
    return data


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (case_data()[:, :50], r"holds float64 \(6, 50, 101\) instead of float64 \(6, 100, 101\)"),
        (case_data().astype(np.float32), r"holds float32 \(6, 100, 101\)"),
        (np.full((6, 100, 101), None), "truncated or damaged"),
        (with_value(0, np.nan), r"value \(0, 3, 5\) is nan"),
        (with_value(3, -1.0), "has areas that are not positive"),
        (with_value(2, 0.2), r"the undeformed area \(variable 2\) changes with time"),
    ],
)
def test_names_a_file_with_wrong_contents(tmp_path, data, message):
    write_case(tmp_path, "case_1_0", case_data())
    write_case(tmp_path, "case_1_1", data)
    with pytest.raises(FileError, match=message) as caught:
        read_authors_folder(tmp_path)
    text = str(caught.value)
    assert text.startswith("1 of 2 cases in")
    assert "averagedTo1DFrom0_case_1_1.npy" in text
    assert "case_1_0" not in text


def test_names_missing_truncated_and_foreign_files_together(tmp_path):
    for w in range(4):
        write_case(tmp_path, f"case_1_{w}", case_data())
    files = [tmp_path / f"case_1_{w}" / f"averagedTo1DFrom0_case_1_{w}.npy" for w in range(4)]
    files[0].unlink()
    files[1].write_bytes(files[1].read_bytes()[:-1000])
    files[2].write_bytes(b"a text")
    with files[3].open("wb") as handle:
        np.savez(handle, a=np.ones(2))
    with pytest.raises(FileError) as caught:
        read_authors_folder(tmp_path)
    lines = str(caught.value).splitlines()
    assert lines[0].startswith("4 of 4 cases")
    assert "There is no file" in lines[1]
    assert "truncated or damaged" in lines[2]
    assert "truncated or damaged" in lines[3]
    assert "it holds an archive" in lines[4]


def test_names_at_most_ten_files(tmp_path):
    for w in range(13):
        (tmp_path / f"case_1_{w}").mkdir()
    with pytest.raises(FileError) as caught:
        read_authors_folder(tmp_path)
    assert str(caught.value).count("There is no file") == 10
    assert str(caught.value).endswith("… (13 in all)")


@pytest.mark.data
@pytest.mark.filterwarnings("error")
def test_the_published_data(published_cases: Cases):
    cases = published_cases
    assert cases.flow.shape == (100, 100, 101)
    pairs = list(zip(cases.labels.geometry, cases.labels.waveform, strict=True))
    assert pairs == [(g, w) for g in range(1, 11) for w in range(10)]
    assert cases.labels.blockage.min() == 0.4
    assert cases.labels.blockage.max() == 0.85
    # The outlet is a resistance with zero distal pressure.
    pressure, flow = cases.pressure[:, :, -1], cases.flow[:, :, -1]
    assert np.linalg.norm(pressure - 109_236.9 * flow) < 2e-3 * np.linalg.norm(pressure)
    from_area = 1 - cases.area_undeformed.min(axis=1) / cases.area_undeformed[:, 0]
    assert np.abs(from_area - cases.labels.blockage).max() < 0.02
    for part, error in zip(cases.split("paper"), (0.61, 0.65), strict=True):
        poiseuille = {"wall_shear_stress": part.poiseuille_wall_shear_stress()}
        found = pooled_errors(poiseuille, part)["wall_shear_stress"]
        assert found == pytest.approx(error, abs=0.005)


@pytest.mark.data
def test_the_papers_split(published_cases: Cases):
    train, test = published_cases.split("paper")
    assert (len(train), len(test)) == (81, 19)
    pairs = list(zip(test.labels.geometry, test.labels.waveform, strict=True))
    assert pairs == [*((g, 9) for g in range(1, 10)), *((10, w) for w in range(10))]
