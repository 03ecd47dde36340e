"""Parts of ports: where test signals are added and loops opened, and inputs of which a part was cut."""

from __future__ import annotations

import json

import numpy as np
import pytest

from rotorsim import RotorsimError, frequency_response, load, margins, step_response
from rotorsim.linear.loop import Loop, injections
from tests.systems.shipped import DIAGRAMS

HZ = np.geomspace(5.0, 900.0, 7)


def two_ambs(sample_time: float | None = None) -> dict:
    made = json.loads((DIAGRAMS / "two_amb_rotor.json").read_text())
    for name in ("controller_a", "controller_b") if sample_time else ():
        made["blocks"][name]["type"] = "discrete_pid"
        made["blocks"][name]["parameters"]["sample_time"] = sample_time
    return made


def modal(gain: float = 1.0) -> dict:
    """Return a rotor whose modal controller has the second probe by way of a block."""
    made = two_ambs()
    made.pop("layout", None)
    for name in ("controller_a", "controller_b"):
        made["blocks"].pop(name)
    made["blocks"]["controller"] = {"type": "modal_pid"}
    made["blocks"]["probe"] = {"type": "gain", "parameters": {"gain": gain}}
    lost = ("controller_a", "controller_b", "bus", "reference")
    made["wires"] = [wire for wire in made["wires"] if not any(end.split(".")[0] in lost for end in wire)]
    made["blocks"] = {name: one for name, one in made["blocks"].items() if name not in lost}
    made["record"] = ["rotor.displacement"]
    made["wires"] += [
        ["rotor.displacement[3]", "controller.displacement[1]"],
        ["rotor.displacement[7]", "probe.input"],
        ["probe.output", "controller.displacement[2]"],
        ["controller.current[1]", "amb_a.current"],
        ["controller.current[2]", "amb_b.current"],
    ]
    return made


@pytest.mark.slow
def test_a_part_is_that_part_of_the_whole() -> None:
    for document in (two_ambs(), two_ambs(1e-4)):
        whole = frequency_response(load(document), "rotor.force", "rotor.displacement[3]", frequencies=HZ)
        row = frequency_response(load(document), "rotor.force[4]", "rotor.displacement[3]", frequencies=HZ)
        one = frequency_response(load(document), "rotor.force[4,2]", "rotor.displacement[3,1]", frequencies=HZ)
        assert row.inputs == ("rotor.force[4,1]", "rotor.force[4,2]")
        assert (one.inputs, one.outputs) == (("rotor.force[4,2]",), ("rotor.displacement[3,1]",))
        np.testing.assert_allclose(row.value, whole.value[:, :, 6:8], rtol=1e-9, atol=1e-19)
        np.testing.assert_allclose(one.value[:, 0, 0], whole.value[:, 0, 7], rtol=1e-9, atol=1e-19)


@pytest.mark.slow
def test_a_loop_that_is_open_at_one_entry_has_the_loop_gain_of_that_axis() -> None:
    """The others closed, as G_o = 1 / S - 1 has them."""
    drawn = load(two_ambs(), set={"speed": "9000 rpm"})
    for entry in (1, 2):
        port = f"controller_a.current[{entry}]"
        opened = frequency_response(drawn, port, port, frequencies=HZ, open_loop=True)
        truth = margins(drawn, port, frequencies=HZ, limits=False)
        np.testing.assert_allclose(opened.value[:, 0, 0], -truth.open_loop()[:, 0], rtol=1e-7)
    both = frequency_response(drawn, "controller_a.current", "controller_a.current", frequencies=HZ, open_loop=True)
    matrix = margins(drawn, "controller_a.current", frequencies=HZ, limits=False).open_loop_matrix()
    np.testing.assert_allclose(both.value, -matrix, rtol=1e-7, atol=1e-8)
    assert abs(both.value[3, 1, 1] - opened.value[3, 0, 0]) > 1e-3  # the axes are coupled


@pytest.mark.slow
def test_the_loop_of_a_sampled_controller_opens_and_goes_to_that_of_the_continuous_one() -> None:
    port, errors = "controller_a.current[1]", []
    truth = frequency_response(load(two_ambs()), port, port, frequencies=HZ, open_loop=True).value
    for T in (2e-5, 1e-5):
        errors.append(frequency_response(load(two_ambs(T)), port, port, frequencies=HZ, open_loop=True).value - truth)
    np.testing.assert_allclose(np.abs(errors[1]) / np.abs(errors[0]), 0.5, rtol=0.05)


@pytest.mark.slow
def test_margins_of_one_axis_are_those_among_all() -> None:
    drawn = load(two_ambs())
    every = margins(drawn).axes
    for axis in every:
        (alone,) = margins(drawn, axis.name).axes
        assert (alone.name, alone.zone) == (axis.name, axis.zone)
        assert alone.peak == pytest.approx(axis.peak, rel=1e-6)
        assert alone.phase == pytest.approx(axis.phase, rel=1e-6)


def test_an_input_of_which_a_part_was_cut_has_the_axes_that_are_left() -> None:
    """As with a probe whose gain is zero."""
    cut, silent = load(modal(), without=["probe"]), load(modal(0.0))
    found, truth = (Loop(one, injections(one, ["controller.displacement"])) for one in (cut, silent))
    assert [axis.name for axis in found.axes] == ["controller.displacement[1,1]", "controller.displacement[1,2]"]
    np.testing.assert_allclose(found.sensitivity(HZ), truth.sensitivity(HZ)[:, :2, :2], rtol=1e-9)
    notes = [f"'controller.displacement[2,{k}]' is not wired: no loop passes there" for k in (1, 2)]
    assert [note for note in margins(cut).notes if "wired" in note] == notes


@pytest.mark.parametrize(
    ("port", "said"),
    [
        ("controller.displacement[2]", "nothing is wired to this input: no loop passes"),
        ("controller.displacement[3]", "no such entry; 'controller.displacement' has shape 2 x 2, counted from 1"),
        ("controller.displacement[0]", "no such entry"),
        ("controller.displacement[1", "no such entry"),
        ("controller.displacment[1]", "no such port"),
    ],
)
def test_parts_that_are_not_there_are_refused(port: str, said: str) -> None:
    drawn = load(modal(), without=["probe"])
    with pytest.raises(RotorsimError) as caught:
        margins(drawn, port)
    assert said in str(caught.value)
    if said != "nothing is wired to this input: no loop passes":
        for function in (frequency_response, step_response):
            with pytest.raises(RotorsimError) as caught:
                function(drawn, port, "rotor.displacement")
            assert said in str(caught.value)


def test_a_loop_cannot_be_opened_at_an_input() -> None:
    with pytest.raises(RotorsimError, match="no such output port"):
        frequency_response(load("jeffcott"), "amb.current[1]", "rotor.displacement", open_loop=True)
