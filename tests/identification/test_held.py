"""Damping of a disc that a diagram holds at zero: said where a recording contradicts it, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from rotorsim.diagram.diagram import Free
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.held import Estimated, contradictions_of, is_contradicted, with_contradictions
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
    assert found.statement.endswith(
        "The recording contradicts the value at which rotor.disc_damping[1] is held: "
        "the intervals hold only if that does not matter to a parameter."
    )


@pytest.mark.slow
def test_damping_that_is_held_where_there_is_none_is_named_too():
    held = changed("fe_rigid", lambda document: document["blocks"]["rotor"]["parameters"].update(disc_damping=[20.0]))
    [problem] = [one for one in of(0.0, held).warnings if one.subject == "rotor.disc_damping[1]"]
    assert problem.what.startswith("is held at 20 N s/m, but the recording says ")


def test_freed_as_it_says_the_parameters_come_back():
    freed = changed("fe_rigid", lambda document: document["identify"].update({"rotor.disc_damping[1]": {}}))
    found = of(4.0, freed)
    assert found.adequate
    assert found.values["rotor.disc_damping[1]"] == pytest.approx(
        4.0, abs=4 * found.parameters["rotor.disc_damping[1]"].std
    )
    for name, item in found.parameters.items():
        true = 4.0 if name.startswith("rotor") else TRUTH[name]
        assert abs(item.value - true) < 4 * item.std, name


@pytest.mark.parametrize("seed", [0, 2, *(pytest.param(k, marks=pytest.mark.slow) for k in range(3, 20))])
def test_nothing_is_said_where_nothing_is_wrong(seed):
    found = of(0.0, seed=seed)
    assert found.adequate
    assert not [one for one in found.warnings if one.subject.startswith("rotor")]
    assert max(errors(found).values()) < 0.05


class Fit:
    """An estimate of the damping of discs with a standard deviation of 1 N s/m, and of what moves with it."""

    def __init__(self, damping=5.0, failure="", fall=0.0):
        self.damping, self.failure, self.fall = damping, failure, fall
        self.given = [
            Free("crack_stiffness", "crack_stiffness", 0, 3e5, "N/m", 0.0, np.inf),
            Free("crack_phase", "crack_phase", 0, 0.0, "rad", -np.inf, np.inf),
            Free("k", "k", 0, 1.0, "1", 0.0, np.inf),
        ]

    def freed(self, more=()):
        if not more:
            theta, std, at_bound = np.array([2.5e5, 3.14, 0.0]), np.array([10.0, 0.01, 0.3]), np.arange(3) == 2
            return Estimated(self.given, theta, std, at_bound, 100.0 + self.fall)
        if self.failure:
            raise RotorsimError(Problem(self.failure, "fe_rigid"))
        theta = [2.5e5 - 25.0, -3.14, 1.0, *[self.damping] * len(more)]
        at_bound = np.array([False, False, False, *[not self.damping] * len(more)])
        std = np.array([12.0, 0.01, 1.0, *[1.0 if self.damping else 0.0] * len(more)])
        return Estimated([*self.given, *more], np.array(theta), std, at_bound, 100.0)


def test_the_level_is_one_in_ten_thousand():
    """Of a normal distribution, two-sided: 3.8906 standard deviations. Angles of 3.14 and -3.14 rad are alike."""
    assert contradictions_of(load("fe_rigid"), Fit(3.8905)) == []
    [problem] = contradictions_of(load("fe_rigid"), Fit(3.8907))
    assert problem.what == (
        "is held at 0 N s/m, but the recording says 3.89 N s/m with a standard deviation of 1 N s/m"
    )
    assert problem.hint == (
        'free it: "identify": {"rotor.disc_damping[1]": {}, ...}; that moves crack_stiffness by 2.5 standard deviations'
    )
    assert contradictions_of(load("jeffcott"), Fit()) == []


def test_at_its_bound_the_fall_of_the_misfit_says_it():
    """Of one degree of freedom: 15.137 is exceeded by noise in one of ten thousand."""
    held = changed("fe_rigid", lambda document: document["blocks"]["rotor"]["parameters"].update(disc_damping=[20.0]))
    assert contradictions_of(held, Fit(0.0, fall=15.13)) == []
    [problem] = contradictions_of(held, Fit(0.0, fall=15.14))
    assert problem.what == "is held at 20 N s/m, but the recording says 0 N s/m, its bound"


def test_what_runs_set_is_known():
    for name in ("rotor.disc_damping", "rotor.disc_damping[1]"):
        assert contradictions_of(load("fe_rigid"), Fit(), {name}) == []


def test_the_entries_that_are_not_free_are_looked_at():
    def two_discs(document):
        document["blocks"]["rotor"]["parameters"] |= {
            "disc_nodes": [3, 4],
            "disc_mass": [2.0, 1.0],
            "disc_polar_inertia": [0.0045, 0.001],
            "disc_diametral_inertia": [0.0024, 0.001],
        }
        document["identify"]["rotor.disc_damping[1]"] = {}

    [problem] = contradictions_of(changed("fe_rigid", two_discs), Fit())
    assert problem.subject == "rotor.disc_damping[2]"


def test_what_could_not_be_judged_is_said():
    [problem] = contradictions_of(load("fe_rigid"), Fit(failure="its simulation diverges"))
    assert str(problem) == (
        "warning: rotor.disc_damping[1]: whether the recording contradicts what is held was not judged "
        "(its simulation diverges)"
    )
    assert not is_contradicted([problem])
    assert with_contradictions("All is well.", [problem], adequate=True) == "All is well."


def test_of_two_values_the_statement_names_both_first_if_they_are_all_that_is_wrong():
    [problem] = contradictions_of(load("fe_rigid"), Fit())
    both = [problem, replace(problem, subject="rotor.disc_damping[2]")]
    told = (
        "The recording contradicts the values at which rotor.disc_damping[1] and rotor.disc_damping[2] are held: "
        "the intervals hold only if that does not matter to a parameter."
    )
    assert with_contradictions("All is known.", both, adequate=True) == f"{told} All is known."
    assert with_contradictions("Much is missing.", both, adequate=False) == f"Much is missing. {told}"
    assert with_contradictions("All is well.", [], adequate=True) == "All is well."
