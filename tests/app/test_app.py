"""``pcnde app``: its inputs and curves, its access checks, and the page in a browser."""

from __future__ import annotations

import dataclasses
import importlib.util
import io
import json
import re
import socket
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers import AREA, CONFIG, CORRECTED, GRID, INFLOW, TIME, VESSELS, Z, waveforms

from pcnde_bridge import (
    PCNDE,
    InputError,
    PCNDEError,
)
from pcnde_bridge.app import server
from pcnde_bridge.app.explorer import Explorer
from pcnde_bridge.app.inputs import Choices, read_waveform
from pcnde_bridge.app.page import empty_figure
from pcnde_bridge.engines import select_engine
from pcnde_bridge.engines.parameters import initial_parameters
from pcnde_bridge.hemodynamics.waveform import Waveform
from pcnde_bridge.plots.style import QUANTITIES
from pcnde_bridge.uncertainty.novelty import Novelty
from pcnde_bridge.uncertainty.sampling import Uncertainty

pytestmark = pytest.mark.filterwarnings(
    "ignore::pcnde_bridge.uncertainty.novelty.OutsideTrainingWarning"
)

ROOT = Path(__file__).parents[2]
FACTORS = {name: factor for name, (*_, factor) in QUANTITIES.items()}


@pytest.fixture(scope="module")
def model():
    """Model of the preset ``physics``, with given parameters instead of a fit."""
    rng = np.random.default_rng(7)
    corrections = 0.3 * np.where(np.arange(21) < 4, 0, rng.normal(size=(2, 21)))
    corrections += CORRECTED.correction
    members = np.array([CORRECTED.replace(correction=one).refitted for one in corrections])
    uncertainty = Uncertainty(
        members,
        np.array([0.5]),
        np.zeros(3),
        np.empty(0),
        np.array([[0.01], [1e-4], [500.0]]) * np.ones(41),
        np.ones(3),
        np.zeros(1),
    )
    facts = {"cases": len(INFLOW)}
    novelty = Novelty.fit(INFLOW, AREA, GRID)
    engine = select_engine("jax")
    return PCNDE(CONFIG, CORRECTED, GRID, engine, facts, (), uncertainty, novelty)


@pytest.fixture(scope="module")
def explorer(model):
    return Explorer(model, samples=8)


@pytest.fixture
def bound(small_cases, toy_config, toy_engine):
    """Model that is bound to its grid and has no record of its training data."""
    grid = small_cases.grid
    return PCNDE(toy_config, initial_parameters(toy_config, 20, 21, 0), grid, toy_engine)


def predicted(model, inputs, **options):
    area = inputs.vessel.area_undeformed(Z)
    return model.predict(inputs.waveform.samples(32), area, z=Z, period=1.0, **options)


def table(time, *columns, header="time,flow"):
    rows = (",".join(map(repr, map(float, row))) for row in zip(time, *columns, strict=True))
    return "\n".join([header, *rows]).encode()


# ---- inputs ------------------------------------------------------


def test_controls_follow_the_training_data(model):
    choices = Choices(model)
    assert choices.from_training
    assert choices.any_grid
    assert choices.base.samples(32) == pytest.approx(waveforms()[3], abs=1e-9)
    assert (choices.scale.low, choices.scale.high) == pytest.approx((0.25, 1.0))
    assert (choices.blockage.low, choices.blockage.high) == pytest.approx((0.3, 0.7), abs=5e-3)
    assert choices.position.start == 2.0
    assert choices.healthy.diameter == pytest.approx(2 * np.sqrt(0.125 / np.pi), rel=5e-3)
    # Half as deep as the throat at the same distance as the training vessel.
    inputs = choices.inputs(0.7, 1.0)
    radius = np.sqrt(VESSELS[3]) - np.sqrt(0.125)
    throat = inputs.vessel.radius_undeformed(Z) - inputs.vessel.diameter / 2
    share = [
        np.interp(1.0 + choices.length.start / 4 + 1.0, Z, r / r.min()) for r in (radius, throat)
    ]
    assert share == pytest.approx([0.5, 0.5], abs=0.03)
    for span in (choices.scale, choices.blockage):
        assert span.minimum < span.low < span.start < span.high < span.maximum
    for span in (choices.position, choices.length):
        assert span.minimum < span.low == span.start == span.high < span.maximum


def test_controls_for_a_single_training_case_and_without_training_data(model, bound):
    novelty = Novelty.fit(np.ones((1, 32)), AREA[:1] * 0 + 0.125, GRID)
    steady = PCNDE(CONFIG, CORRECTED, GRID, model.engine, novelty=novelty)
    choices = Choices(steady)
    assert choices.initial.waveform.samples(32) == pytest.approx(np.ones(32))
    assert choices.initial.vessel.blockage == 0
    assert choices.blockage.maximum > choices.blockage.high == 0
    choices = Choices(bound)
    assert not choices.from_training
    assert not choices.any_grid
    # A model that is bound to its points keeps the position of the stenosis.
    assert choices.inputs(0.5, 1, position=1.0, length=0.9) == choices.inputs(0.5, 1)
    assert Explorer(bound).novelty(choices.initial) == {}


def test_stronger_waveforms_and_other_vessels_are_outside(explorer):
    choices = explorer.choices
    inside = explorer.novelty(choices.inputs(0.5, 1.0))
    assert inside["amplitude"] == pytest.approx(1.0, abs=1e-6)
    assert explorer.novelty(choices.inputs(0.5, choices.scale.maximum))["amplitude"] > 1.1
    narrower = explorer.novelty(choices.inputs(choices.blockage.maximum, 1.0))
    assert narrower["blockage"] > max(1.0, 3 * inside["blockage"])


def test_another_frequency_is_outside_as_in_predictions(model, explorer):
    uploaded = table(0.8 * TIME, waveforms()[1])
    waveform, _ = read_waveform(uploaded, "mine.csv", model)
    inputs = explorer.choices.inputs(0.5, 1.0, waveform=waveform)
    scores = explorer.novelty(inputs)
    assert scores["frequency"] == pytest.approx(2.5)
    assert max(scores.values()) == pytest.approx(explorer.prediction(inputs).novelty[0], rel=1e-12)
    assert explorer.novelty(explorer.choices.inputs(0.5, 1.0))["frequency"] < 1e-6


# ---- curves -----------------------------------------------------------


def test_curves_equal_the_predictions_and_include_cached_results(model, explorer):
    inputs, other = (explorer.choices.inputs(blockage, 0.8) for blockage in (0.55, 0.56))
    found = predicted(model, inputs)
    along, over = explorer.curves(inputs, "along", 5), explorer.curves(inputs, "over", 30)
    for name in ("flow", "area", "pressure"):
        values = getattr(found, name)[0] * FACTORS[name]
        for panel, x, y in ((along[name], Z, values[5]), (over[name], TIME, values[:, 30])):
            assert np.array_equal(panel["prediction"].x, x)
            assert panel["prediction"].y == pytest.approx(y, rel=1e-12)
            assert not panel.keys() & {"interval", "solver"}
    assert along["area"]["given"].y == pytest.approx(100 * inputs.vessel.area_undeformed(Z))
    assert over["flow"]["given"].y == pytest.approx(inputs.waveform.samples(32))

    limits = predicted(model, inputs, samples=8).interval(0.9)
    explorer.interval(inputs)
    cases = explorer.solution(inputs)
    along, over = explorer.curves(inputs, "along", 5), explorer.curves(inputs, "over", 30)
    for name in ("flow", "area", "pressure"):
        low, high = (limit[0] * FACTORS[name] for limit in limits[name])
        for panel, x, cut in ((along[name], Z, np.s_[5]), (over[name], TIME, np.s_[:, 30])):
            outline = panel["interval"]
            assert np.array_equal(outline.x, [*x, *x[::-1]])
            assert outline.y == pytest.approx([*low[cut], *high[cut][::-1]], rel=1e-12)
        solved = getattr(cases, name)[0] * FACTORS[name]
        # Time point 5 of 32 lies between 15 and 16 of the solver's 100, point 30 of 41 on its 75.
        expected = 0.375 * solved[15] + 0.625 * solved[16]
        assert along[name]["solver"].y == pytest.approx(expected, rel=1e-9)
        assert over[name]["solver"].y == pytest.approx(solved[:, 75], rel=1e-9)
    assert "solver" not in explorer.curves(other, "along", 5)["flow"]
    assert explorer.interval.cached(other) is None


def test_a_panel_of_wall_shear_stress(model, bound, monkeypatch):
    def solve(self, inputs):
        found = unsheared(self, inputs)
        return dataclasses.replace(found, wall_shear_stress=found.poiseuille_wall_shear_stress())

    unsheared = PCNDE._solve
    assert Explorer(bound).variables[:3] == ["flow", "area", "pressure"]
    monkeypatch.setattr(PCNDE, "_solve", solve)
    explorer = Explorer(model, samples=8)
    assert explorer.variables == ["flow", "area", "pressure", "wall_shear_stress"]
    inputs = explorer.choices.initial
    explorer.interval(inputs), explorer.solution(inputs)
    panel = explorer.curves(inputs, "over", 30)["wall_shear_stress"]
    expected = explorer.prediction(inputs).poiseuille_wall_shear_stress()[0, :, 30]
    assert np.array_equal(panel["prediction"].y, expected)
    assert len(empty_figure(explorer, "t").data) == 4 * 4
    assert "wall_shear_stress" in explorer.csv(inputs).partition("\n")[0]


def test_solver_has_the_models_wall_and_outlet(explorer, bound):
    tube, outlet = explorer.solver_setup(explorer.choices.initial)
    radius = explorer.choices.healthy.diameter / 2
    assert tube.wall.stiffness(0.1) == pytest.approx(1.0e6 / radius)
    assert tube.wall.reference_pressure == 2.0e3
    assert (outlet.resistance, outlet.distal_pressure) == (1.0e5, 5.0e3)
    other = Explorer(bound)
    _, outlet = other.solver_setup(other.choices.initial)
    found = other.prediction(other.choices.initial)
    q, p = found.flow[0, :, -1], found.pressure[0, :, -1]
    assert outlet.resistance == pytest.approx((p @ q) / (q @ q))


def test_errors_are_cached_and_raised_again(explorer):
    # The flow is so strong that the solver finds no solution, or rejects it.
    inputs = explorer.choices.inputs(0.95, 1.0, waveform=Waveform(500.0))
    with pytest.raises(PCNDEError) as first:
        explorer.solution(inputs)
    assert explorer.solution.cached(inputs) is first.value
    with pytest.raises(PCNDEError):
        explorer.solution(inputs)


def test_download_equals_the_frame_of_the_prediction(model, explorer):
    inputs = explorer.choices.inputs(0.5, 0.9, position=2.4, length=0.6)
    found = pd.read_csv(io.StringIO(explorer.csv(inputs)))
    expected = predicted(model, inputs, samples=8).to_frame()
    assert list(found) == list(expected)
    assert np.allclose(found, expected, rtol=1e-12, atol=1e-15)


# ---- uploads -----------------------------------------------------------------


def test_uploads_are_read_as_on_the_command_line(model, bound):
    waveform, note = read_waveform(table(TIME, waveforms()[1]), "mine.csv", model)
    assert waveform.samples(32) == pytest.approx(waveforms()[1], rel=1e-12)
    assert "mine.csv: 32 time points over 1 s" in note
    time = 0.8 * np.arange(100) / 100
    two = table(time, waveforms(time / 0.8)[2], time, header="time,first,second")
    waveform, note = read_waveform(two, "mine.csv", model)
    assert waveform.period == pytest.approx(0.8)
    assert waveform.n_terms == 15
    assert waveform.samples(32) == pytest.approx(waveforms()[2], rel=1e-9)
    assert "resampled to the model's 32 time points; the first of 2 waveforms" in note
    with pytest.raises(InputError, match=r"mine.csv has a period of 0.8 s, but this model works"):
        read_waveform(table(time, time), "mine.csv", bound)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "bad.csv is not a table"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "bad.csv is not a table"),
        (b"x,flow\n0,1\n1,2\n", r"bad.csv must have the columns time, then one"),
        (b"time,flow\n0,1\n0.1,fast\n0.2,1\n", "bad.csv, line 3, column flow: not a number"),
        (b"time,flow\n0,1\n0.1,\n0.2,1\n", "bad.csv, line 3, column flow: not a number"),
        (b"time,flow\n0,1\n0.1,inf\n0.2,1\n", r"bad.csv: flow\[1\] is inf"),
        (b"time,flow\n0,1\n0.1,2\n0.3,3\n", "bad.csv, line 3: the time points are not equally"),
        (b"time,flow\n0,1\n0.1,2\n", "bad.csv: A waveform needs at least 3 samples"),
        (b"time" + b",a" * 40_000 + b"\n0" + b",1" * 40_000, "has 40001 columns: keep 200 at"),
    ],
)
def test_invalid_uploads_are_reported(model, content, message):
    with pytest.raises(InputError, match=message) as error:
        read_waveform(content, "bad.csv", model)
    assert "upload.csv" not in str(error.value)


# ---- access --------------------------------------------------------


@pytest.fixture(scope="module")
def client(model):
    pytest.importorskip("dash", reason="the extra app is not installed")
    return server.make_app(model, "model").server.test_client()


@pytest.mark.parametrize(
    ("headers", "code"),
    [
        ({"Host": "127.0.0.1:8050"}, 200),
        ({"Host": "localhost:9"}, 200),
        ({"Host": "localhost", "Origin": "http://127.0.0.1:8050"}, 200),
        ({"Host": "rebound.example:8050"}, 403),
        ({"Host": "127.0.0.1.rebound.example"}, 403),
        ({"Host": "rebound.example@127.0.0.1"}, 403),
        ({"Host": "127.0.0.1", "Origin": "https://rebound.example"}, 403),
        ({"Host": "127.0.0.1", "Origin": "null"}, 403),
    ],
)
def test_only_host_names_of_this_machine_are_answered(client, headers, code):
    for path in ("/", "/_dash-layout", "/_dash-dependencies", "/assets/page.js"):
        assert client.get(path, headers=headers).status_code == code
    if code == 403:
        assert client.post("/_dash-update-component", headers=headers).status_code == 403


def test_a_page_behind_a_proxy_answers_its_address_and_names_its_files(model):
    pytest.importorskip("dash", reason="the extra app is not installed")
    url = "https://hub.example/user/me/proxy/8050/"
    client = server.make_app(model, "model", url).server.test_client()
    page = client.get("/", headers={"Host": "hub.example", "Origin": "https://hub.example"})
    assert page.status_code == 200
    assert "/user/me/proxy/8050/_dash-component-suites/" in page.text
    assert client.get("/_dash-layout", headers={"Host": "localhost"}).status_code == 200
    assert client.get("/", headers={"Host": "rebound.example"}).status_code == 403
    for wrong in ("hub.example/user", "/user/me", "ftp://hub.example/"):
        with pytest.raises(InputError, match="--url must be like https://"):
            server.make_app(model, "model", wrong)


def test_drop_and_ffr_are_shown_with_intervals_and_seeley_and_young(client, explorer):
    inputs = explorer.choices.inputs(0.5, 1.0, position=2.0, length=0.5)
    expected = explorer.prediction(inputs).indices().iloc[0]
    numbers = explorer.indices(inputs)
    assert numbers["ffr"] == pytest.approx(expected["ffr"])
    assert numbers["empirical"] > 0
    low, high = (limit[0] for limit in explorer.interval(inputs)["ffr"])
    assert low < numbers["ffr"] < high
    shown = json.dumps(ask(client).json, ensure_ascii=False)
    assert f"FFR {expected['ffr']:.3f}" in shown
    assert f"Drop of Seeley and Young: {numbers['empirical']:.2f} mmHg" in shown


def test_graphs_have_names(client):
    layout = json.dumps(client.get("/_dash-layout", headers={"Host": "localhost"}).json)
    for name in ("along-title", "over-title"):
        assert f'"aria-labelledby": "{name}"' in layout
    assert "the two differ most behind a severe stenosis" in layout


def ask(client, **changes):
    """Call the drawing callback of the page, and return its response."""
    known = client.get("/_dash-dependencies").json
    draw = next(callback for callback in known if "along.figure" in callback["output"])
    outputs = [name.rsplit(".", 1) for name in draw["output"].strip(".").split("...")]
    values = {"blockage": 50, "position": 2.0, "length": 0.5, "scale": 1.0, "waveform": None}
    values |= {"time-point": 5, "grid-point": 30, "shown": [], "done": None}
    values |= {name.replace("_", "-"): value for name, value in changes.items()}
    given = [{**where, "value": values[where["id"]]} for where in draw["inputs"]]
    body = {
        "output": draw["output"],
        "outputs": [{"id": name, "property": of} for name, of in outputs],
        "inputs": given,
        "state": [],
        "changedPropIds": ["scale.value"],
    }
    return client.post("/_dash-update-component", json=body, headers={"Host": "localhost"})


def test_another_frequency_is_reported_as_outside(client, explorer):
    waveform, length = explorer.choices.base, explorer.choices.length.start
    for period, css_class, text in (
        (1.0, "inside", "Largest novelty: amplitude 1.00"),
        (0.8, "outside", "The frequency is unlike any"),
    ):
        changed = dataclasses.asdict(dataclasses.replace(waveform, period=period))
        response = ask(client, length=length, waveform=changed).json["response"]
        assert response["novelty"]["className"] == css_class
        assert text in str(response["novelty"]["children"])


@pytest.mark.parametrize(
    "changes",
    [
        {"time_point": None},
        {"grid_point": None},
        {"time_point": 32},
        {"grid_point": 2.5},
        {"shown": None},
    ],
)
def test_unexpected_requests_get_an_empty_response(client, changes):
    assert ask(client).status_code == 200
    response = ask(client, **changes)
    assert (response.status_code, response.data) == (204, b"")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"blockage": 95}, "blockage is outside its control"),
        ({"blockage": "abc"}, "blockage must be a number"),
        ({"scale": 1e300}, "scale is outside its control"),
        ({"position": -1}, "position is outside its control"),
        ({"waveform": {"mean": "x"}}, "Waveform.mean must be a number"),
        ({"waveform": {"color": 1}}, "is not a complete waveform"),
        ({"waveform": {"mean": 1, "cosine": [0] * 50, "sine": [0] * 50}}, "more harmonics than"),
        ({"shown": 3}, "Unexpected error, see the terminal: TypeError"),
    ],
)
def test_a_bad_value_has_a_message(client, explorer, changes, message):
    response = ask(client, **{"length": explorer.choices.length.start, **changes})
    assert response.status_code == 200
    assert message in response.text


def test_page_loads_no_files_from_other_hosts(client):
    page = client.get("/").text
    loaded = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert len(loaded) > 5
    assert all(path.startswith("/") and not path.startswith("//") for path in loaded)


def test_server_listens_on_this_machine_and_reports_a_used_port(model):
    pytest.importorskip("dash", reason="the extra app is not installed")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"Port {port} .* cannot be used.*--port"):
            server.make_server(model, "model", port)
    made = server.make_server(model, "model", 0)
    try:
        assert made.socket.getsockname()[0] == "127.0.0.1"
    finally:
        made.server_close()


def test_a_missing_extra_is_reported(model, tmp_path, run_pcnde, monkeypatch):
    monkeypatch.setitem(sys.modules, "dash", None)
    model.save(tmp_path / "model.npz")
    code, _, errors = run_pcnde("app", tmp_path / "model.npz")
    assert code == 1
    assert 'pip install ".[app]"' in errors


# ---- in a browser ------------------------------------------------------------


@pytest.fixture(scope="module")
def bench():
    """Benchmark of the page, which has functions to control a browser."""
    pytest.importorskip("dash", reason="the extra app is not installed")
    pytest.importorskip("selenium")
    spec = importlib.util.spec_from_file_location("app_benchmark", ROOT / "benchmarks" / "app.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if module.programs() is None:
        pytest.skip("no Chromium and chromedriver on this machine")
    return module


@pytest.fixture(scope="module")
def page(bench, model):
    with bench.served(model, "synthetic") as address, bench.browser() as driver:
        driver.get(address)
        bench.wait_for(lambda: bench.settled(driver))
        yield driver


def drawn(bench, page, column, trace="prediction"):
    """Return the ordinates of a trace in every panel, by variable."""
    found = [t["y"] for t in bench.curves(page, column) if t["name"] == trace]
    return dict(zip(QUANTITIES, map(np.array, found), strict=False))


def chosen(page, control):
    thumb = page.find_element("css selector", f"#{control} [role=slider]")
    return float(thumb.get_attribute("aria-valuenow"))


def assert_drawn(bench, page, model, inputs):
    """Wait until the curves equal the prediction, along the vessel and over the cycle."""
    found = predicted(model, inputs)
    time_point, grid_point = (int(chosen(page, name)) for name in ("time-point", "grid-point"))

    def as_predicted():
        for name, array in found.variables().items():
            values = array[0] * FACTORS[name]
            for column, y in (("along", values[time_point]), ("over", values[:, grid_point])):
                if not np.allclose(drawn(bench, page, column)[name], y, rtol=0, atol=2e-6):
                    return False
        return True

    bench.wait_for(as_predicted, 30)


def test_moving_a_control_changes_the_curves(bench, page, model):
    choices = Choices(model)
    assert_drawn(bench, page, model, choices.initial)
    before = drawn(bench, page, "along")
    times = bench.move(page, 3)
    print(bench.describe_times("key to drawn", times["drawn"]))
    assert chosen(page, "blockage") == pytest.approx(100 * choices.blockage.start - 1.5)
    inputs = choices.inputs(chosen(page, "blockage") / 100, choices.scale.start)
    assert_drawn(bench, page, model, inputs)
    after = drawn(bench, page, "along")
    assert all(not np.allclose(before[name], after[name], rtol=1e-6, atol=0) for name in before)
    # Interval and solver follow later.
    bench.wait_for(lambda: bench.settled(page))
    limits = predicted(model, inputs, samples=64).interval(0.9)["pressure"]
    time_point = int(chosen(page, "time-point"))
    band = drawn(bench, page, "along", "90 % interval")["pressure"]
    expected = [limits[0][0, time_point], limits[1][0, time_point, ::-1]]
    assert band == pytest.approx(np.concatenate(expected) * FACTORS["pressure"], abs=2e-6)
    assert len(drawn(bench, page, "over", "1D solver")["flow"]) == 100


def test_a_number_outside_a_control_moves_box_slider_and_curves(bench, page, model):
    from selenium.webdriver.common.keys import Keys

    choices = Choices(model)
    box = page.find_element("css selector", "#blockage input")
    for typed, shown in ((95, choices.blockage.maximum), (1, choices.blockage.minimum), (50, 0.5)):
        box.send_keys(Keys.CONTROL, "a")
        box.send_keys(str(typed), Keys.TAB)
        assert_drawn(bench, page, model, choices.inputs(shown, choices.scale.start))
        assert float(box.get_attribute("value")) == pytest.approx(100 * shown)
        assert chosen(page, "blockage") == pytest.approx(100 * shown)


def test_novelty_and_its_warning_are_shown(bench, page, model):
    from selenium.webdriver.common.keys import Keys

    thumb = page.find_element("css selector", "#scale [role=slider]")
    novelty = page.find_element("id", "novelty")
    thumb.send_keys(Keys.END)
    bench.wait_for(lambda: novelty.get_attribute("class") == "outside")
    assert "Outside the training data" in novelty.text
    assert "amplitude" in novelty.text
    assert "The model extrapolates" in novelty.text


def test_uploads_are_drawn_or_rejected(bench, page, model, tmp_path):
    upload = page.find_element("css selector", "#upload input[type=file]")
    note = page.find_element("id", "uploaded")
    bad, good = tmp_path / "bad.csv", tmp_path / "good.csv"
    bad.write_bytes(b"time,flow\n0,1\n0.1,fast\n0.2,1\n")
    good.write_bytes(table(TIME, 1.1 * waveforms()[1]))
    blockage = chosen(page, "blockage") / 100
    upload.send_keys(str(bad))
    bench.wait_for(
        lambda: "The file was rejected. bad.csv, line 3, column flow: not a number" in note.text
    )
    upload.send_keys(str(good))
    bench.wait_for(lambda: "good.csv: 32 time points" in note.text)
    waveform, _ = read_waveform(good.read_bytes(), "good.csv", model)
    choices = Choices(model)
    assert_drawn(bench, page, model, choices.inputs(blockage, 1.0, waveform=waveform))
    page.find_element("id", "reset").click()
    assert_drawn(bench, page, model, choices.inputs(blockage, choices.scale.start))


def test_page_fits_its_window_and_loads_from_this_machine_only(bench, page):
    names = page.execute_script(
        "return performance.getEntriesByType('resource').map((entry) => entry.name)"
    )
    assert len(names) > 5
    assert all(name.startswith(("http://127.0.0.1:", "data:", "blob:")) for name in names)
    assert [entry for entry in page.get_log("browser") if entry["level"] == "SEVERE"] == []
    for width in (1400, 420):
        bench.resize(page, width, 900)
        time.sleep(0.3)
        wide = page.execute_script("return document.documentElement.scrollWidth")
        assert wide <= width
    bench.resize(page, *bench.WINDOW)
