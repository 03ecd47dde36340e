"""Damping of a disc that a diagram holds at zero: said where a recording contradicts it, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from rotorsim.diagram.diagram import Free
from rotorsim.identification.held import Estimated, contradictions_of, with_contradictions
from rotorsim.identification.identification import identify
from rotorsim.model.load import load
from tests.identification import TRUTH, changed, errors, made, recorded

SPEEDS = (70.0, 140.0, 210.0)
LEVEL = 1e-3


def of(disc_damping, diagram=None, seed=0):
    runs = made("fe_rigid", SPEEDS, replace(TRUTH, disc_damping=disc_damping), level=LEVEL, seed=seed)
    return identify(diagram or load("fe_rigid"), recorded(runs), profile=False)


def test_damping_that_the_diagram_holds_at_zero_is_named_with_what_it_moves():
    found = of(4.0)
    [problem] = [one for one in found.warnings if one.subject == "rotor.disc_damping[1]"]
    assert problem.what.startswith("is held at 0 N s/m, but the recording says ")
    assert problem.hint.startswith('free it: "identify": {"rotor.disc_damping[1]": {}, ...}; that moves ')
    assert not found.adequate
    assert found.statement.startswith(
        "The recording contradicts the value at which rotor.disc_damping[1] is held: "
        "the intervals hold only if that does not matter to a parameter. "
    )


def test_freed_as_it_says_the_parameters_come_back():
    freed = changed("fe_rigid", lambda document: document["identify"].update({"rotor.disc_damping[1]": {}}))
    found = of(4.0, freed)
    assert found.adequate
    assert found.values["rotor.disc_damping[1]"] == pytest.approx(
        4.0, abs=4 * found.parameters["rotor.disc_damping[1]"].std
    )
    del found.values["rotor.disc_damping[1]"]
    for name, item in found.parameters.items():
        true = 4.0 if name.startswith("rotor") else TRUTH[name]
        assert abs(item.value - true) < 4 * item.std, name


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_said_where_nothing_is_wrong(seed):
    found = of(0.0, seed=seed)
    assert found.adequate
    assert not [one for one in found.warnings if one.subject.startswith("rotor")]
    assert max(errors(found).values()) < 0.05


class Fit:
    """An estimate of the damping of the disc with a standard deviation of 1 N s/m."""

    def __init__(self, damping):
        self.damping = damping
        self.given = Free("crack_stiffness", "crack_stiffness", 0, 3e5, "N/m", 0.0, np.inf)

    def freed(self, more=()):
        if not more:
            return Estimated([self.given], np.array([2.5e5]), np.array([10.0]))
        return Estimated([self.given, *more], np.array([2.5e5 - 25.0, self.damping]), np.array([12.0, 1.0]))


def test_the_level_is_one_in_ten_thousand():
    """Of a normal distribution, two-sided: 3.8906 standard deviations."""
    assert contradictions_of(load("fe_rigid"), Fit(3.8905)) == []
    [problem] = contradictions_of(load("fe_rigid"), Fit(3.8907))
    assert problem.what == (
        "is held at 0 N s/m, but the recording says 3.8907 N s/m with a standard deviation of 1 N s/m"
    )
    assert problem.hint == (
        'free it: "identify": {"rotor.disc_damping[1]": {}, ...}; that moves crack_stiffness by 2.5 standard deviations'
    )
    assert contradictions_of(load("jeffcott"), Fit(100.0)) == []


def test_of_two_values_the_statement_names_both():
    [problem] = contradictions_of(load("fe_rigid"), Fit(5.0))
    other = replace(problem, subject="rotor.disc_damping[2]")
    assert with_contradictions("All is well.", [problem, other]).startswith(
        "The recording contradicts the values at which rotor.disc_damping[1] and rotor.disc_damping[2] are held: "
    )
    assert with_contradictions("All is well.", []) == "All is well."
