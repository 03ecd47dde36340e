"""Which verdict follows from what effects explain."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from rotorsim.diagnose.conclusions import _effect, nearest, verdict_of
from rotorsim.diagnose.fitting import Fit
from rotorsim.diagnose.naming import AS_MUCH, NEARLY, Named, Round, _named, _worth_again
from rotorsim.diagnose.scoring import DETAILS, SURPRISE, HeldScore, predicts
from rotorsim.diagnose.trials import is_adequate, is_noise
from rotorsim.diagram.diagram import Free

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


def test_faint_lines_are_not_noise_though_little_in_all():
    base = replace(left(1.0), line_misfit=110.0, line_rows=30)
    assert is_adequate(base)
    assert not is_noise(base)
    assert verdict_of(Named(base, (), (), base, 1e-4), ()) == "outside_catalogue"
    chosen = (SimpleNamespace(fit=left(0.97)),)
    assert verdict_of(Named(base, chosen, (), left(0.97), 1e-4), (EFFECT,)) == "missing_physics"
    lines_left = replace(left(0.99), line_misfit=100.0, line_rows=30)
    assert verdict_of(Named(base, chosen, (), lines_left, 1e-4), (EFFECT,)) == "outside_catalogue"
    strong = replace(left(50.0), line_misfit=4e4, line_rows=30)
    assert verdict_of(Named(strong, chosen, (), lines_left, 1e-4), (EFFECT,)) == "missing_physics"  # details of a law


@pytest.mark.parametrize(
    ("before", "after", "details", "proved"),
    [
        (5e3, 1.0, DETAILS, True),  # noise is left
        (1.05, 1.06, DETAILS, True),  # nothing to see before, nothing after
        (3.0, float(chi2.isf(SURPRISE, ROWS)) / ROWS - 1e-6, DETAILS, True),
        (3.0, float(chi2.isf(SURPRISE, ROWS)) / ROWS + 1e-6, DETAILS, False),
        (1e6, 1 + 0.99e2, DETAILS, True),  # details of the law
        (1e6, 1 + 1.01e2, DETAILS, False),
        (1e4, 1.99e1, 1 - NEARLY, False),
        (1e4, 0.99e1, 1 - NEARLY, True),  # what was left in the fitted runs may be left there
        (None, 2.0, DETAILS, True),  # the diagram as given has no settled motion there
        (5.0, None, DETAILS, True),
    ],
)
def test_effects_are_proved_by_runs_that_took_no_part(before, after, details, proved):
    def scored(times: float | None) -> HeldScore:
        return HeldScore({}, {}, None if times is None else times * ROWS, ROWS)

    assert predicts(scored(before), scored(after), details) is proved


def test_effects_that_do_not_predict_are_outside_the_catalogue():
    """A law may explain all runs that it is fitted to, and still be the wrong one."""
    found = named(50.0, 1.0)
    assert verdict_of(found, (EFFECT,)) == "missing_physics"
    assert verdict_of(found, (EFFECT,), disproved=True) == "outside_catalogue"
    assert nearest(found, None) is found.fit
    assert nearest(found, None, disproved=True) is found.base


def candidate(physics: str, misfit: float, extra: int, nuisances: int = 20) -> SimpleNamespace:
    free = tuple(Free(f"{physics}{k}", "", 0, 1.0, "", 0.0, np.inf) for k in range(extra))
    fit = Fit({}, free, misfit=misfit, rows=ROWS - nuisances, equations=ROWS, goodness=0.5)
    insertion = SimpleNamespace(physics=physics, spot="rotor.force", key=physics)
    return SimpleNamespace(fit=fit, insertion=insertion, physical=True, parameters=())


def chosen(*tried: SimpleNamespace) -> list[str]:
    base = Fit({}, misfit=1000.0, rows=ROWS - 20, equations=ROWS, goodness=0.5)
    order = tuple(sorted(tried, key=lambda item: item.fit.criterion))
    trials = SimpleNamespace(
        round=lambda before: Round(before, order), has_mesh=lambda base: False, counts={}, nominal={}, slack=0.0
    )
    return [item.insertion.physics for item in _named(trials, base, 3).chosen]


def test_where_noise_explains_all_only_what_it_cannot_make_is_named():
    """A law that leaves fewer means open has the better criterion, but explains nothing that noise does not."""
    fewer = candidate("hysteretic_damping", 1010.0, 0, nuisances=1)
    seen, unseen = candidate("internal_damping", 980.0, 1), candidate("seal_cross_coupling", 995.0, 1)
    assert chosen(fewer, seen, unseen) == ["internal_damping"]
    assert chosen(fewer, unseen) == []


def test_means_that_a_law_adds_cost_as_much_as_its_parameters():
    """What a fault brings along must not absorb for nothing what another explains with a parameter."""
    numbers = {"misfit": 900.0, "equations": ROWS, "goodness": 0.5}
    given = Fit({}, rows=ROWS - 20, **numbers)
    same = Fit({}, rows=ROWS - 20, standing=20, **numbers)
    fewer = Fit({}, rows=ROWS - 10, standing=20, **numbers)
    more = Fit({}, rows=ROWS - 40, standing=20, **numbers)
    assert given.criterion == same.criterion == 920.0
    assert fewer.criterion == 910.0
    assert more.criterion == pytest.approx(920.0 + 20 * np.log(ROWS))


def test_only_what_explained_something_is_tried_again_in_the_place_of_an_effect():
    before = Fit({}, misfit=5000.0, rows=ROWS, equations=ROWS)
    found, near, far = candidate("rub", 1000.0, 1), candidate("clearance", 4590.0, 1), candidate("runout", 4610.0, 1)
    assert _worth_again(Round(before, (found, near, far)), found) == {"rub", "clearance"}


def test_a_class_is_judged_as_the_effect_stood_in_its_round():
    """An effect may carry a fit without another that was exchanged since: its rivals stood beside that one too."""
    before = Fit({}, misfit=5000.0, rows=ROWS, equations=ROWS)
    in_round, rival = candidate("rub", 980.0, 1), candidate("clearance", 1500.0, 1)
    stale = candidate("rub", 90000.0, 1)
    effect = _effect(stale, Round(before, (in_round, rival)), 0.0)
    assert effect.members == {"rub": 1.0}
    assert effect.candidate.fit is in_round.fit
