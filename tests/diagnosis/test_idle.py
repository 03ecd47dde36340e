"""What the data do not ask of a law: idle parameters, bounds, and wider laws where a case of them does as well."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.conclude.verdict import effect_of
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.search.candidates import Candidate, Round
from rotorsim.diagnosis.search.idle import nested, simplified
from rotorsim.diagnosis.search.selection import _simplified
from rotorsim.diagram.diagram import Free
from tests.diagnosis.test_selection import candidate
from tests.diagnosis.test_verdicts import ROWS, left


def free(name: str, unit: str = "N", low: float = 0.0) -> Free:
    return Free(name, "", 0, 1.0, unit, low, np.inf)


def law(sizes: dict[str, tuple[float, float]]) -> Fit:
    """Return a fit with parameters {name: (value, standard deviation)}; angles are in rad."""
    items = tuple(free(name, "rad", -np.inf) if "phase" in name else free(name) for name in sizes)
    theta, stds = np.array(list(sizes.values())).T
    document = {"blocks": {"law": {"parameters": {}}}, "identify": {name: {} for name in sizes}}
    return Fit(document, items, theta, np.diag(stds**2), np.zeros(len(items), bool), 1000.0, ROWS, ROWS, goodness=0.5)


def test_a_parameter_at_its_bound_makes_a_law_unphysical_but_not_one_of_the_diagram():
    found = law({"bow.amplitude": (0.0, 0.1), "damping": (1.0, 0.1)})
    insertion = SimpleNamespace(free=("bow.amplitude",), fault=SimpleNamespace(sizes=(), simpler={}))
    item = Candidate(insertion, replace(found, at_bound=np.array([True, False])))
    assert not item.physical
    assert replace(item, fit=replace(found, at_bound=np.array([False, True]))).physical
    assert Round(found, (item,)).best is None


def test_parameters_that_the_data_do_not_tell_from_zero_are_dropped_with_their_angles():
    sizes = {
        "law.amplitude1": (3.0, 0.1),
        "law.phase1": (0.3, 0.1),
        "law.amplitude2": (0.1, 0.2),
        "law.phase2": (1.0, 2.0),
        "law.backward2": (0.39, 0.2),
        "law.backward_phase2": (1.0, 0.5),
        "law.amplitude0": (0.41, 0.2),
    }
    asked = []

    def refitted(document, starts):
        left = {name: sizes[name] for name in document["identify"]}
        asked.append(set(sizes) - set(left))
        return replace(law(left), misfit=1000.0 + (3.0 if len(left) < 5 else 2.0))

    item = SimpleNamespace(insertion=SimpleNamespace(free=tuple(sizes)), fit=law(sizes))
    [found] = _simplified(SimpleNamespace(evidence=SimpleNamespace(fit=refitted)), (item,))
    assert set(found.fit.values) == {"law.amplitude1", "law.phase1", "law.amplitude0"}
    assert asked[0] == {"law.amplitude2", "law.phase2"}  # the least told first
    assert found.insertion is item.insertion


def test_a_law_keeps_its_only_parameter():
    item = SimpleNamespace(insertion=SimpleNamespace(free=("law.amplitude1",)), fit=law({"law.amplitude1": (0.1, 0.2)}))
    assert _simplified(SimpleNamespace(evidence=None), (item,)) == (item,)


@pytest.mark.parametrize(("without", "physical"), [(1002.8, True), (1002.6, False), (None, True)])
def test_a_size_that_the_data_leave_open_is_not_zero_where_nothing_explains_as_much_without(without, physical):
    """FAULT: cross-talk of a speed into a pressure was rejected: with six parameters free it was 1.8e7 +- 1.6e10.

    Without it the misfit rises, by more than 1.645^2 = 2.71.
    """
    sizes = {"law.linear": (1.8, 1600.0)}
    fault = SimpleNamespace(sizes=("linear",), simpler={}, enters="signal")
    item = SimpleNamespace(free=("law.linear",), spot=Spot("a", "b"), key="talk", fault=fault)
    refitted = Fit({}, failure="it diverges") if without is None else Fit({}, misfit=without)
    tried = Candidate(item, law(sizes))
    assert not tried.physical
    found = simplified(SimpleNamespace(fit=lambda document, starts: refitted), Round(left(50.0), (tried,)), 0.0)
    assert found.tried[0].physical is physical
    adequate = Round(left(1.0), (tried,))
    assert simplified(SimpleNamespace(), adequate, 0.0) is adequate  # beside noise it would be chance


def test_a_law_does_not_lose_by_a_parameter_that_it_does_not_need():
    """FAULT: a square beside an idle cube lost against a gain that depends on another signal, by log(2000) = 7.6."""
    sizes = {"law.quadratic": (3.0, 0.1), "law.cubic": (0.1, 0.2)}
    evidence = SimpleNamespace(
        fit=lambda document, starts: replace(
            law({k: v for k, v in sizes.items() if k in document["identify"]}), misfit=1000.2
        )
    )
    square = Candidate(
        SimpleNamespace(
            free=tuple(sizes),
            physics="square",
            spot=Spot("a", "b"),
            depends_on="",
            key="square",
            fault=SimpleNamespace(sizes=(), simpler={}, special_cases=("parabola",), enters="signal"),
        ),
        law(sizes),
    )
    gain = candidate("gain", 1000.0, 1, nuisances=0)
    found = simplified(evidence, Round(left(50.0), (gain, square)), 0.0)
    [less] = [item for item in found.tried if item.insertion is square.insertion]
    assert [*less.fit.values] == ["law.quadratic"]
    assert less.fit.criterion - gain.fit.criterion == pytest.approx(0.2)
    unexplained = Round(left(50.0), (replace(square, fit=replace(square.fit, misfit=5e3, goodness=0.0)),))
    assert simplified(evidence, unexplained, 0.0) is unexplained  # what is idle now another effect may wake
    parabola = candidate("parabola", 1000.2, 1, nuisances=0)  # FAULT: a drift without a rate was named beside an offset
    parabola.insertion.spot = square.insertion.spot
    kept = simplified(evidence, Round(left(50.0), (parabola, square)), 0.0)
    assert [item.fit for item in kept.tried] == [parabola.fit, square.fit]
    bow = replace(square, insertion=SimpleNamespace(**vars(square.insertion)))  # FAULT: a misalignment without its
    bow.insertion.fault = SimpleNamespace(**{**vars(square.insertion.fault), "enters": "force"})  # second order: a bow
    assert simplified(evidence, Round(left(50.0), (gain, bow)), 0.0).tried[1].fit is bow.fit
    parabola.insertion.spot = Spot("a", "c")
    assert simplified(evidence, Round(left(50.0), (parabola, square)), 0.0).tried[1].fit is not square.fit


@pytest.mark.parametrize(
    ("share", "criterion", "meant"),
    [((1.0006, 0.0008), -9.0, "play"), ((1.01, 0.0008), 1.0, "play"), ((1.01, 0.0008), -9.0, "hysteresis")],
)
def test_a_law_gives_way_to_a_case_of_it_once_both_are_as_exact_as_the_data_ask(share, criterion, meant):
    """FAULT: a lag of 0.8 samples made a share of 1.0046 +- 0.002 of what was a play, and both were named."""

    def memory(physics: str, cases: tuple[str, ...], simpler: dict, fit: Fit, block: str = "controller") -> Candidate:
        spot = Spot(block, "output")
        fault = SimpleNamespace(special_cases=cases, simpler=simpler, sizes=(), enters="signal")
        names = tuple(name for name in fit.values if name.startswith(physics))
        own = {"depends_on": "", "law": physics, "smoothed": ("t",), "grows": False, "fault": fault}
        return Candidate(SimpleNamespace(physics=physics, spot=spot, key=f"{physics}@{spot}", free=names, **own), fit)

    case = memory("play", (), {}, law({"play.width": (4.27, 0.01)}))
    wide = law({"hysteresis.share": (1.0046, 0.002), "hysteresis.width": (4.28, 0.01)})
    wider = memory("hysteresis", ("play",), {"share": (1.0, "play")}, replace(wide, misfit=980.0))
    shorter = law({"hysteresis.share": share, "hysteresis.width": (4.31, 0.001)})
    shorter = replace(shorter, misfit=1000.0 - np.log(ROWS) + criterion)

    def sharpened(fit: Fit, laws: list) -> tuple[None, Fit]:
        return None, shorter if laws[0].physics == "hysteresis" else fit

    there = replace(wider, insertion=memory("hysteresis", ("play",), {}, wider.fit, "valve").insertion)
    case_there = replace(case, insertion=memory("play", (), {}, case.fit, "valve").insertion)
    found = Round(left(50.0), (wider, case, there, case_there))
    after, chosen = nested(SimpleNamespace(sharpened=sharpened), found, wider, 0.0)
    assert chosen.insertion.physics == meant
    assert chosen.fit in (wider.fit, case.fit)  # as approximate as what is fitted beside it
    assert [after.of(item).fit.misfit for item in (wider, there)] == [1000.0 if meant == "play" else 980.0] * 2
    if meant == "play":  # FAULT: only one place of the play was sharpened, so that the right one was not listed
        effect = effect_of(chosen, after, 0.0)
        assert effect.members == {"play": 1.0}
        assert {spot.block for spot in effect.spots} == {"controller", "valve"}
    with_noise_left = replace(case, fit=replace(case.fit, misfit=5e3, goodness=0.0))
    untouched = Round(left(50.0), (wider, with_noise_left))
    assert nested(SimpleNamespace(), untouched, wider, 0.0) == (untouched, wider)
