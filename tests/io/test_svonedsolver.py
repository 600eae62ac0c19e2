"""Input and result files of svOneDSolver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from io_helpers import at_times, replaced, sv1d

from pcnde_bridge import DataNotFoundError, FileError, InputError
from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.io import read_sv1d


@pytest.fixture
def straight(vessel):
    """A vessel whose undeformed radius is linear, as it is in the solver's segments."""
    radius = np.linspace(np.sqrt(0.125), np.sqrt(0.08), 21)
    return replaced(vessel, area_undeformed=radius**2)


def test_reads_a_chain_of_segments(straight, tmp_path):
    path = sv1d(tmp_path, at_times(straight, np.arange(41) / 20))
    found = read_sv1d(path, period=1.0)
    np.testing.assert_allclose(found.z, straight.z)
    np.testing.assert_allclose(found.area_undeformed[0], straight.area_undeformed)
    for name in VARIABLES:
        np.testing.assert_allclose(getattr(found, name)[0], getattr(straight, name), rtol=1e-9)
    part = read_sv1d(path, segments=["Group1_Seg0", "Group2_Seg0"], period=1.0)
    np.testing.assert_allclose(part.flow, found.flow[:, :, 8:])


def test_reads_what_the_solver_wrote():
    """Text that svOneDSolver made of ``tests/data/sv1d/tube.in``."""
    path = Path(__file__).parents[1] / "data" / "sv1d" / "tube.in"
    with pytest.raises(InputError, match=r"starts from rest: pass the period.*--period"):
        read_sv1d(path)
    found = read_sv1d(path, period=1.0)
    assert (found.n_times, found.n_points, found.period) == (20, 11, 1.0)
    np.testing.assert_allclose(found.z, np.linspace(0, 4, 11))
    phase = 2 * np.pi * found.time
    inflow = 1.3 + 0.4 * np.sin(phase) + 0.1 * np.cos(2 * phase)
    np.testing.assert_allclose(found.inflow[0], inflow, rtol=5e-3)
    np.testing.assert_allclose(found.pressure[0, :, -1], 1e5 * found.flow[0, :, -1], rtol=0.02)
    np.testing.assert_allclose(found.area_undeformed[0, [0, 6, 10]], [0.125, 0.125, 0.11])


def test_a_network_needs_a_choice(straight, tmp_path):
    path = sv1d(tmp_path, straight, nodes=[(0, 1), (1, 2), (1, 3)])
    with pytest.raises(InputError, match=r"Group2_Seg0 does not begin where Group1_Seg0 ends"):
        read_sv1d(path, period=1.0)
    assert read_sv1d(path, segments=["Group0_Seg0", "Group1_Seg0"], period=1.0).n_points == 15
    with pytest.raises(InputError, match=r"has no segments \['Group7'\]"):
        read_sv1d(path, segments=["Group7"], period=1.0)


def test_results_that_do_not_fit_the_input_file(straight, tmp_path):
    path = sv1d(tmp_path, straight)
    table = tmp_path / "results_Group1_Seg0_area.dat"
    whole = table.read_text()
    table.write_text("\n".join(whole.splitlines()[:-1]))
    with pytest.raises(FileError, match=r"area\.dat is not .* 7 nodes .*it has 6 and 20"):
        read_sv1d(path, period=1.0)
    table.write_text("\n".join(line.rsplit(" ", 1)[0] for line in whole.splitlines()))
    with pytest.raises(FileError, match=r"20 time steps .* input file says, .*it has 7 and 19"):
        read_sv1d(path, period=1.0)
    table.unlink()
    with pytest.raises(DataNotFoundError, match="output TEXT"):
        read_sv1d(path, period=1.0)


@pytest.mark.parametrize(
    "encode",
    [
        lambda text: text.encode("utf-8-sig"),
        lambda text: text.replace("# A model", "# Gefäß").encode("latin-1"),
    ],
)
def test_input_files_of_the_solver_in_any_encoding(vessel, tmp_path, encode):
    path = sv1d(tmp_path, vessel)
    expected = read_sv1d(path, period=1.0)
    path.write_bytes(encode(path.read_text().removeprefix("\n")))
    assert read_sv1d(path, period=1.0) == expected
    path.write_bytes(encode("\n".join(path.read_text("latin-1").splitlines()[1:])))
    assert read_sv1d(path, period=1.0) == expected


def test_keywords_of_any_case_and_commas(vessel, tmp_path):
    path = sv1d(tmp_path, vessel)
    expected = read_sv1d(path, period=1.0)
    text = path.read_text()
    for word in ("MODEL", "SEGMENT", "SOLVEROPTIONS"):
        text = text.replace(f"{word} ", f"{word.title()}, ")
    path.write_text(text.replace(" NOBOUND ", ",NOBOUND,"))
    assert read_sv1d(path, period=1.0) == expected


def test_results_of_another_run_and_too_few_saves(vessel, tmp_path):
    path = sv1d(tmp_path, vessel)
    text = path.read_text()
    path.write_text(text.replace("SOLVEROPTIONS 0.01 5 95", "SOLVEROPTIONS 0.01 5 190"))
    with pytest.raises(FileError, match=r"39 time steps .*it has 9 and 20, as if of another run"):
        read_sv1d(path, period=1.0)
    path.write_text(text.replace("SOLVEROPTIONS 0.01 5 95", "SOLVEROPTIONS 0.01 100 100"))
    with pytest.raises(InputError, match=r"saves 2 time points, .* second number of SOLVEROPTIONS"):
        read_sv1d(path, period=1.0)


def test_one_segment_may_be_named_by_itself(vessel, tmp_path):
    path = sv1d(tmp_path, vessel)
    one = read_sv1d(path, segments="Group1_Seg0", period=1.0)
    assert one == read_sv1d(path, segments=["Group1_Seg0"], period=1.0)
