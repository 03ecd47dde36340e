"""Which verdict follows from what effects explain."""

from types import SimpleNamespace

import pytest

from rotorsim.diagnose.conclusions import verdict_of
from rotorsim.diagnose.fitting import Fit
from rotorsim.diagnose.naming import AS_MUCH, NEARLY, Named

ROWS = 1000


def left(times: float) -> Fit:
    """Return a fit that leaves so many times the variance of the noise."""
    return Fit({}, misfit=times * ROWS, rows=ROWS, equations=ROWS, goodness=0.0 if times > 1.2 else 0.5)


def named(before: float, after: float) -> Named:
    return Named(left(before), (SimpleNamespace(fit=left(after)),), (), left(after), 1e-4)


EFFECT = SimpleNamespace(members={"rub": 1.0})


@pytest.mark.parametrize(
    ("before", "after", "verdict"),
    [
        (50.0, 1.0, "missing_physics"),
        (2e4, 1.4, "missing_physics"),  # details of the law
        (2e4, AS_MUCH + 0.1, "outside_catalogue"),  # more than noise is left
        (1 + 0.4 / (1 - NEARLY) * 0.99, 1.4, "outside_catalogue"),  # too much of what was to be explained is left
        (1 + 0.4 / (1 - NEARLY) * 1.01, 1.4, "missing_physics"),
        (300.0, 60.0, "outside_catalogue"),
    ],
)
def test_details_of_a_law_do_not_make_it_another(before, after, verdict):
    assert verdict_of(named(before, after), (EFFECT,)) == verdict


def test_what_nothing_was_found_for_is_outside_or_nothing():
    assert verdict_of(Named(left(50.0), (), (), left(50.0), 1e-4), ()) == "outside_catalogue"
    assert verdict_of(Named(left(1.0), (), (), left(1.0), 1e-4), ()) == "consistent"
    assert verdict_of(Named(left(1.0), (), (), left(1.0), 1e-4), (), alike=True) == "not_identifiable"
