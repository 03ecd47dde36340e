"""Runs held out that are bad, recordings and free parameters put together at random: refused, or right."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rotorsim.errors import RotorsimError
from rotorsim.recordings.recording import Recording
from tests.identification import TRUTH, free, recorded
from tests.identification.test_bad_recordings import (
    RUNS,
    Change,
    Edit,
    cut,
    found,
    nothing_wrong_is_sure,
    on_disk,
    scaled,
)


def test_all_signals_constant():
    runs = [replace(run, columns={c: 0 * v + 1e-9 * k for c, v in run.columns.items()}) for k, run in enumerate(RUNS)]
    try:
        item = found(recorded(runs))
    except RotorsimError:
        return
    assert any(problem.what.startswith("constant signal") for problem in item.warnings)
    nothing_wrong_is_sure(item)


# --- held out ---------------------------------------------------------------------------------------------------------


def held_out(**changes: Any) -> Recording:
    recording = recorded(RUNS[:1])
    return replace(recording, runs=(replace(recording.runs[0], **changes),))


TIME = RUNS[0].time - RUNS[0].time[0]
BAD_HOLD_OUT = [
    {"time": TIME[:0], "values": {c: v[:0] for c, v in RUNS[0].columns.items()}},
    {"time": TIME[:1], "values": {c: v[:1] for c, v in RUNS[0].columns.items()}},
    {"time": 0 * TIME},
    {"time": TIME[::-1]},
    {"values": {c: v * np.nan for c, v in RUNS[0].columns.items()}},
    {"tacho": None},
    {"settings": {"controller.Kp": 3}},
]


@pytest.mark.parametrize("changes", BAD_HOLD_OUT, ids=["empty", "one", "no time", "back", "nan", "no tacho", "setting"])
def test_runs_held_out_are_checked_as_well(changes):
    """FAULT (empty, one, no time): a recording given with hold_out is not checked; IndexError, RuntimeWarning."""
    with pytest.raises(RotorsimError):
        found(recorded(RUNS), hold_out=held_out(**changes))


def test_warnings_about_held_out_runs_are_heard():
    """FAULT: as above; a dead channel in them is not mentioned."""
    held = held_out(values={**RUNS[0].columns, "y": 0 * RUNS[0].columns["y"]})
    item = found(recorded(RUNS), hold_out=held)
    assert any(problem.what.startswith("constant signal") for problem in item.warnings)


# --- whatever comes ---------------------------------------------------------------------------------------------------

EDITS: list[Edit] = [
    lambda document: document["channels"].pop("x"),
    lambda document: document["channels"].pop("iy"),
    lambda document: document["channels"].pop("ix"),
    lambda document: document["channels"]["y"].update(coupling="ac"),
    lambda document: document["channels"]["ix"].update(coupling="ac"),
    lambda document: document["channels"]["iy"].update(unit="mA"),
    lambda document: document["channels"]["x"].update(unit="V"),
    lambda document: document["channels"]["y"].update(node=2),
    lambda document: document["channels"]["y"].update(signal="rotor.velocity"),
    lambda document: document["channels"]["y"].update(signal="clock.theta"),
    lambda document: document["channels"]["ix"].update(signal="amb.force"),
    lambda document: document["runs"].pop(),
    lambda document: document["runs"][0].update(use="hold_out"),
    lambda document: document["runs"][1].update(use="hold_out", sample_rate="500 Hz"),
    lambda document: document["runs"][0].update(tacho=document["runs"][0]["tacho"][:2]),
    lambda document: document["runs"][0].update(tacho=document["runs"][0]["tacho"][2:3]),
    lambda document: document["runs"][2].pop("tacho"),
    lambda document: document["runs"][2].pop("speed"),
    lambda document: document["runs"][3].update(speed="-1 rpm"),
    lambda document: document["runs"][3]["set"].clear(),
    lambda document: document["runs"][3]["set"].update({"amb.force_current_factor": 3}),
    lambda document: document["runs"][3]["set"].update({"speed": 0}),
]
CHANGES: list[Change] = [
    cut(30),
    cut(150),
    scaled(("x",), 0.0),
    scaled(("x", "y", "ix", "iy"), 0.0),
    scaled(("ix",), -1.0),
    lambda table: {**table, "x": table["ix"]},
    lambda table: {**table, "x": np.sign(table["x"])},
    lambda table: {c: v[::7] for c, v in table.items()},
    lambda table: {c: v[::-1] for c, v in table.items()},
    lambda table: {c: np.round(v, 5) for c, v in table.items()},
]


@pytest.mark.slow
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    edits=st.lists(st.sampled_from(range(len(EDITS))), max_size=3, unique=True),
    change=st.none() | st.sampled_from(range(len(CHANGES))),
    orders=st.sampled_from([(0, 1, 2, 3, -1), (1,), (0, 5, -5, 7)]),
)
def test_whatever_comes_is_refused_or_identified(tmp_path_factory, edits, change, orders):
    """By the regression, which does not search and takes no time: an identification or a RotorsimError."""

    def edit(document):
        for k in edits:
            try:
                EDITS[k](document)
            except (IndexError, KeyError):
                continue

    folder = tmp_path_factory.mktemp("any")
    try:
        item = found(on_disk(folder, edit, None if change is None else CHANGES[change]), "regression", orders=orders)
    except RotorsimError:
        return
    for parameter in item.parameters.values():
        assert np.isfinite(parameter.value)


@settings(max_examples=5, deadline=None)
@given(
    names=st.lists(
        st.sampled_from(
            [
                "viscous_damping",
                "eccentricity",
                "unbalance_phase",
                "crack_stiffness",
                "rotor.mass",
                "rotor.stiffness",
                "unbalance.mass",
                "crack.sag",
            ]
        ),
        min_size=1,
        max_size=4,
        unique=True,
    )
)
@pytest.mark.slow
def test_any_free_parameters(names):
    """The others are fixed at wrong values: whatever is said to be sure and adequate is right.

    FAULT: a free angle alone is an IndexError in the search for starts.
    """
    item = found(recorded(RUNS[:2]), diagram=free("jeffcott", **{name.replace(".", "__"): {} for name in names}))
    assert set(item.parameters) == set(names)
    known = {
        "rotor.mass": 2.0,
        "rotor.stiffness": 7.6e5,
        "controller.KD": 3.0,
        "unbalance.mass": 2.0,
        "crack.sag": 26e-6,
    }
    for name, parameter in item.parameters.items():
        truth = known[name] if name in known else TRUTH[name]
        sure = item.adequate and parameter.verdict.identifiable
        assert not sure or abs(parameter.value - truth) < 0.1 * abs(truth)
