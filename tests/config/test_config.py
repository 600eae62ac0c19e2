"""Settings: validation, serialization, presets, and the paper's numbers."""

from __future__ import annotations

import dataclasses
import json
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcnde_bridge import (
    PAPER,
    PRESETS,
    PUBLISHED_CODE,
    InputError,
    PCNDEConfig,
)
from pcnde_bridge.config import (
    FAST,
    PHYSICS,
    config_from,
    resolve_config,
    resolve_pcnde_config,
)
from pcnde_bridge.engines.parameters import sizes

GROUPS = [
    f.name for f in dataclasses.fields(PAPER) if dataclasses.is_dataclass(getattr(PAPER, f.name))
]
NUMBERS = [
    (group, f.name, type(getattr(getattr(PAPER, group), f.name)))
    for group in GROUPS
    for f in dataclasses.fields(getattr(PAPER, group))
    if type(getattr(getattr(PAPER, group), f.name)) in (int, float)
]
CHOICES = [
    ("flow", "activation"),
    ("flow", "loss"),
    ("fourier_area", "anchor"),
    ("fourier_area", "frequency"),
    ("fourier_area", "sides"),
    ("temporal_pressure", "activation"),
    ("temporal_pressure", "pressure_drop_input"),
    ("spatial_pressure", "form"),
]
MAY_BE_ZERO = {
    "stenosis_position",
    "turbulent_coefficient",
    "gradient_tolerance",
    "amplitude_exponent",
    "weight_decay",
    "pressure_weight_decay",
}
MAY_BE_NEGATIVE = {"stenosis_position"}


def where(group, setting):
    return rf"{type(getattr(PAPER, group)).__name__}\.{setting}"


@pytest.mark.parametrize(("group", "setting", "kind"), NUMBERS)
def test_every_number_is_checked(group, setting, kind):
    bad = ["5", None, True, [1], float("nan"), float("inf"), -float("inf")]
    if kind is int:
        bad += [1.5, 2.0]
    if setting not in MAY_BE_ZERO:
        bad.append(kind(0))
    if setting not in MAY_BE_NEGATIVE:
        bad.append(kind(-1))
    for value in bad:
        with pytest.raises(InputError, match=where(group, setting)):
            PAPER.replace(**{group: {setting: value}})


@pytest.mark.parametrize(("group", "setting"), CHOICES)
@pytest.mark.parametrize("value", ["nonsense", 3, None, ["tanh"], ""])
def test_every_choice_is_checked(group, setting, value):
    with pytest.raises(InputError, match=where(group, setting) + " must be one of"):
        PAPER.replace(**{group: {setting: value}})


@pytest.mark.parametrize("group", ["flow", "temporal_pressure"])
@pytest.mark.parametrize("value", ["88", 8, None, (8, 0), (8, -1), (8, 2.5), (8, True), ("8",)])
def test_hidden_widths_are_checked(group, value):
    with pytest.raises(InputError, match=where(group, "hidden")):
        PAPER.replace(**{group: {"hidden": value}})


@pytest.mark.parametrize("value", [0, -0.1, "auto", float("nan"), True])
def test_first_step_is_checked(value):
    with pytest.raises(InputError, match=where("flow", "first_step")):
        PAPER.replace(flow={"first_step": value})


@pytest.mark.parametrize("value", ["yes", 1, None])
def test_restart_is_checked(value):
    with pytest.raises(InputError, match=where("fourier_area", "restart")):
        PAPER.replace(fourier_area={"restart": value})


@pytest.mark.parametrize("setting", ["batch_size", "coupling_passes"])
@pytest.mark.parametrize("value", [0, -1, 1.5, "12", True, None])
def test_top_level_numbers_are_checked(setting, value):
    with pytest.raises(InputError, match=rf"PCNDEConfig\.{setting}"):
        PAPER.replace(**{setting: value})


@pytest.mark.parametrize("value", [5, None, "tanh", [1]])
@pytest.mark.parametrize("group", GROUPS)
def test_a_group_must_be_a_group(group, value):
    with pytest.raises(InputError, match=rf"PCNDEConfig\.{group}"):
        PAPER.replace(**{group: value})


def test_a_group_of_another_stage_is_refused():
    with pytest.raises(InputError, match=r"PCNDEConfig\.flow must be FlowStage"):
        PAPER.replace(flow=PAPER.fourier_area)


@pytest.mark.parametrize("name", ["epoch", "self", "", "_replace"])
def test_unknown_names_are_rejected_with_a_list_of_the_known_ones(name):
    with pytest.raises(InputError, match=f"no setting '{name}'.*batch_size"):
        PAPER.replace(**{name: 1})
    with pytest.raises(InputError, match=f"FlowStage has no setting '{name}'.*epochs"):
        PAPER.replace(flow={name: 1})
    with pytest.raises(InputError, match=f"no setting '{name}'"):
        PCNDEConfig.from_json(json.dumps({name: 1}))


def test_replace_changes_only_the_named_settings():
    changed = PAPER.replace(flow={"epochs": 7, "hidden": [3, 4]}, batch_size=2)
    assert (changed.flow.epochs, changed.flow.hidden, changed.batch_size) == (7, (3, 4), 2)
    assert changed.flow.replace(epochs=100, hidden=(8, 8, 8, 8)) == PAPER.flow
    assert changed.replace(flow=PAPER.flow, batch_size=12) == PAPER
    assert PCNDEConfig() == PAPER


def test_integers_are_converted_to_floats():
    density = PAPER.replace(physics={"density": 1}).physics.density
    assert type(density) is float
    assert density == 1.0
    with pytest.raises(InputError, match=r"Physics\.density must be finite"):
        PAPER.replace(physics={"density": 10**400})
    with pytest.raises(InputError, match=r"batch_size must be finite"):
        PAPER.replace(batch_size=10**400)


def test_numpy_numbers_are_converted_to_python_numbers():
    made = PAPER.replace(
        batch_size=np.int64(5),
        flow={"rtol": np.float32(0.5), "hidden": [np.int32(3)], "first_step": np.float64(0.1)},
    )
    assert made == PAPER.replace(batch_size=5, flow={"rtol": 0.5, "hidden": [3], "first_step": 0.1})
    assert PCNDEConfig.from_json(made.to_json()) == made
    for value in (np.int64(0), np.float64(5.0), np.bool_(True)):
        with pytest.raises(InputError, match=r"PCNDEConfig\.batch_size"):
            PAPER.replace(batch_size=value)
    with pytest.raises(InputError, match=r"FlowStage\.rtol must be finite"):
        PAPER.replace(flow={"rtol": np.float64("nan")})


def test_settings_cannot_be_changed_in_place():
    with pytest.raises(dataclasses.FrozenInstanceError):
        PAPER.batch_size = 3
    with pytest.raises(dataclasses.FrozenInstanceError):
        PAPER.flow.epochs = 3
    with pytest.raises(TypeError):
        PRESETS["paper"] = PUBLISHED_CODE
    assert PCNDEConfig() == PAPER


def test_hashable_by_value():
    same = PAPER.replace(flow={"hidden": [8, 8, 8, 8]})
    assert hash(same) == hash(PAPER)
    assert {PAPER: 1}[same] == 1
    assert len({PAPER, PUBLISHED_CODE, PAPER.replace(batch_size=3)}) == 3


positive = st.floats(1e-12, 1e12)
configs = st.builds(
    lambda flow, physics, fourier, temporal, batch: PAPER.replace(
        flow=flow, physics=physics, fourier_area=fourier, temporal_pressure=temporal, **batch
    ),
    st.fixed_dictionaries(
        {},
        optional={
            "hidden": st.lists(st.integers(1, 64), min_size=1, max_size=4),
            "epochs": st.integers(1, 10**6),
            "rtol": positive,
            "first_step": st.none() | positive,
            "activation": st.sampled_from(["tanh", "gelu", "relu", "sigmoid", "swish"]),
            "loss": st.sampled_from(["mean", "sum"]),
        },
    ),
    st.fixed_dictionaries(
        {}, optional={"density": positive, "stenosis_position": st.floats(-1e3, 1e3)}
    ),
    st.fixed_dictionaries(
        {},
        optional={
            "restart": st.booleans(),
            "anchor": st.sampled_from(["last_time_point", "last_cycle", "undeformed"]),
        },
    ),
    st.fixed_dictionaries({}, optional={"iterations": st.integers(1, 999)}),
    st.fixed_dictionaries({}, optional={"batch_size": st.integers(1, 999)}),
)


@given(configs)
def test_json_round_trip(config):
    back = PCNDEConfig.from_json(config.to_json())
    assert back == config
    assert hash(back) == hash(config)
    assert PCNDEConfig.from_dict(config.to_dict()) == config
    assert json.loads(config.to_json()) == json.loads(back.to_json())


def test_settings_missing_in_json_keep_their_defaults():
    assert PCNDEConfig.from_json("{}") == PAPER
    assert PCNDEConfig.from_json('{"flow": {"epochs": 3}}') == PAPER.replace(flow={"epochs": 3})


@pytest.mark.parametrize("text", ["", "{", "nonsense", "[" * 100_000])
def test_text_that_is_not_json(text):
    with pytest.raises(InputError, match="not JSON"):
        PCNDEConfig.from_json(text)


@pytest.mark.parametrize("text", ["[]", "3", "null", '"paper"'])
def test_json_that_is_no_mapping(text):
    with pytest.raises(InputError, match="mapping of groups"):
        PCNDEConfig.from_json(text)


def test_json_beyond_floats_is_refused():
    for number in ("NaN", "Infinity", "1e999", "1" + "0" * 400):
        with pytest.raises(InputError, match=r"FlowStage\.rtol"):
            PCNDEConfig.from_json('{"flow": {"rtol": ' + number + "}}")


def test_presets():
    names = {"paper": PAPER, "published-code": PUBLISHED_CODE, "fast": FAST}
    assert {name: PRESETS[name] for name in names} == names
    assert resolve_config("fast") is FAST
    assert resolve_config("paper") is PAPER
    assert resolve_config("published-code") is PUBLISHED_CODE
    assert resolve_config(PUBLISHED_CODE) is PUBLISHED_CODE
    assert resolve_pcnde_config("fast") is FAST
    with pytest.raises(InputError, match="needs the paper's equations"):
        resolve_pcnde_config("physics")
    for unknown in ("papers", "", None, {"flow": {}}):
        with pytest.raises(InputError, match=r"presets are .*paper"):
            resolve_config(unknown)


def test_the_published_code_differs_from_the_text_where_the_notes_say():
    paper, code = PAPER.to_dict(), PUBLISHED_CODE.to_dict()
    differences = {
        (group, name): code[group][name]
        for group in GROUPS
        for name in paper[group]
        if code[group][name] != paper[group][name]
    }
    assert differences == {
        ("flow", "loss"): "sum",
        ("fourier_area", "frequency"): "next",
        ("fourier_area", "sides"): "one",
        ("fourier_area", "restart"): True,
        ("temporal_pressure", "activation"): "gelu",
    }
    assert code["batch_size"] == paper["batch_size"]


def test_the_papers_text():
    """Sections 2.3 to 2.5, in the paper's units where these are not CGS."""
    flow, physics = PAPER.flow, PAPER.physics
    assert flow.hidden == (8, 8, 8, 8)
    assert flow.activation == PAPER.temporal_pressure.activation == "tanh"
    assert (flow.epochs, flow.iterations, flow.couple_every) == (100, 5, 25)
    assert flow.epochs * flow.iterations == 500  # "for a total of 500 iterations"
    assert (flow.rtol, flow.atol, flow.first_step) == (1e-3, 1e-6, None)
    assert flow.loss == "mean"
    assert PAPER.batch_size == 12
    assert PAPER.intermediate_area.cycles == 3
    assert PAPER.intermediate_area.iterations == PAPER.fourier_area.iterations == 5
    assert PAPER.fourier_area.terms == 10
    assert PAPER.fourier_area.frequency == "harmonic"
    assert PAPER.fourier_area.sides == "two"
    assert PAPER.fourier_area.restart is False
    assert PAPER.temporal_pressure.hidden == (2, 2)
    assert PAPER.temporal_pressure.iterations == 250
    assert PAPER.spatial_pressure.iterations == 75
    assert PAPER.coupling_passes == 3
    assert physics.density == pytest.approx(1060 * 1e3 / 1e6)  # kg/m³
    assert physics.viscosity == pytest.approx(0.004 * 1e3 / 1e2)  # kg/(m s)
    assert physics.young_modulus == pytest.approx(1.5e6 * 10)  # Pa
    assert physics.wall_thickness == pytest.approx(0.5 / 10)  # mm
    assert physics.reference_pressure == pytest.approx(100 * 1333.22)  # mmHg
    assert (physics.stenosis_position, physics.turbulent_coefficient) == (2.0, 1.52)
    assert physics.stenosis_length == 0.5
    assert PAPER.optimizer.initial_step_norm == 0.01
    assert (PAPER.optimizer.shrink_most, PAPER.optimizer.shrink_least) == (0.1, 0.5)
    assert PAPER.optimizer.sufficient_decrease == 1e-4


def test_the_papers_number_of_parameters():
    found = sizes(PAPER, 100, 101)
    network = sum((i + 1) * o for i, o in pairwise((200, 8, 8, 8, 8, 100)))
    assert network == 2724
    assert found == {
        "flow": 2724,
        "intermediate_area": 202,
        "fourier_area": 202,
        "temporal_pressure": 1119,
        "spatial_pressure": 202,
    }
    assert sum(found.values()) == 4449


@pytest.mark.parametrize("stage", ["flow", "temporal_flow", "temporal_pressure"])
def test_networks_have_a_hidden_layer(stage):
    with pytest.raises(InputError, match=r"\.hidden must not be empty"):
        PAPER.replace(**{stage: {"hidden": ()}})
    assert PHYSICS.replace(correction={"hidden": ()}).correction.hidden == ()


def test_a_single_fold_would_leave_all_cases_out():
    with pytest.raises(InputError, match="folds must be 0 or at least 2"):
        PHYSICS.replace(correction={"folds": 1})
    assert PHYSICS.replace(correction={"folds": 0}).correction.folds == 0


def test_settings_are_read_by_their_older_names():
    old = json.loads(
        FAST.to_json()
        .replace("full_batch", "all_at_once")
        .replace("minibatch", "batches")
        .replace("optimizer", "optimiser")
        .replace("last_time_point", "last_instant")
        .replace("normalized", "normalised")
        .replace("amplitude_exponent", "wave_weight")
        .replace("collocation_iterations", "known_flow_iterations")
    )
    assert "full_batch" not in old
    assert config_from(old) == PCNDEConfig.from_dict(old) == FAST


def test_former_settings_of_older_files_are_left_out():
    old = FAST.to_dict()
    old["full_batch"] |= {"starts": 3, "validation": 0.3, "patience": 30, "check_every": 10}
    assert config_from(old) == FAST
