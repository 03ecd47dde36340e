"""Something in one of the wires that take a signal: NumPy simulates it; found there, and nothing where nothing is."""

from __future__ import annotations

import math

import casadi as ca
import pytest

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagram.draw import draw_svg
from rotorsim.identification.waveform.driven.equations import driven_equations
from rotorsim.identification.waveform.linearised import branches_of
from rotorsim.model.load import load
from tests.diagnosis.evidence.waveform.level_control import CONTROL, controlled, made


@pytest.mark.slow
@pytest.mark.parametrize("limit", [3.0, math.inf])
def test_a_limit_in_one_branch_of_a_signal_is_found_there(limit):
    runs = [controlled(seed, fed_back=lambda y: min(max(y, -limit), limit)) for seed in (1, 2, 3)]
    found = diagnose(load(CONTROL), made(runs, 50), workers=1)
    if math.isinf(limit):
        assert found.verdict == "consistent"
        return
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert (effect.physics, effect.spot_of("saturation").words) == ("saturation", "the branch into error.input2")
    limits = [found.after.values[f"saturation.{key}"] for key in ("lower", "upper")]
    assert limits == pytest.approx([-limit, limit], rel=0.01)


def test_each_branch_is_a_place_but_one_into_a_gain_or_a_sum_where_the_law_only_adds():
    diagram = load(CONTROL)
    assert [str(wire.target) for wire in branches_of(diagram)["level.output"]] == ["error.input2"]
    found = [item for item in Catalogue.of(diagram).candidates(diagram, []) if item.spot.side == "branch"]
    assert {str(item.spot) for item in found} == {"error.input2", "integral.input"}
    assert "offset" not in {item.physics for item in found if str(item.spot) == "error.input2"}
    assert "offset" in {item.physics for item in found if str(item.spot) == "integral.input"}


@pytest.mark.parametrize(("port", "gains"), [("error.input2", [-1, 0]), ("level.output", [-1, 1.5])])
def test_a_signal_that_is_added_to_a_branch_acts_on_it_alone(port, gains):
    equations = driven_equations(load(CONTROL), ["error.output", "loss.output"], ["reference.output"], [], added=[port])
    added = equations.arguments[2][1]
    slopes = ca.Function("slopes", [equations.arguments[3]], [ca.jacobian(equations.g, added)])
    assert slopes(equations.model.parameter_vector()).full().ravel().tolist() == gains


def test_the_wire_of_a_branch_is_marked_alone():
    svg = draw_svg(load(CONTROL), marked={("error", "input2"): ("#aa0000", "A 0.90")})
    assert svg.count('stroke="#aa0000" stroke-width="3.5"') == 1
    assert "A 0.90" in svg
