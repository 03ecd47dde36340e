"""Which effects are chosen, and what is said of those that are not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rotorsim.blocks.signals.disturbance import Disturbance

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.insertion import Insertion, Spot
from rotorsim.diagnosis.catalogue.values import structure_of
from rotorsim.diagnosis.conclude.verdict import effect_of, rejected_of, unfinished, verdict_of
from rotorsim.diagnosis.evidence.evidence import Promise, Terms
from rotorsim.diagnosis.evidence.fit import Fit, is_adequate
from rotorsim.diagnosis.evidence.missing_signal import PlaceClass
from rotorsim.diagnosis.search.candidates import Candidate, Round, simplest_first
from rotorsim.diagnosis.search.promises import (
    at_likely_places,
    at_other_places,
    at_rival_places,
    likely_of,
    still_likely,
)
from rotorsim.diagnosis.search.selection import _completed, _level, _reconsidered, _selected, _simplified, least_gain
from rotorsim.diagnosis.search.trials import Trials
from rotorsim.diagram.diagram import Free
from rotorsim.jobs.jobs import Jobs
from tests.diagnosis.test_verdicts import ROWS, left, named, selection


def candidate(
    physics: str, misfit: float, extra: int, nuisances: int = 20, alike: tuple[str, ...] = ()
) -> SimpleNamespace:
    free = tuple(Free(f"{physics}{k}", "", 0, 1.0, "", 0.0, np.inf) for k in range(extra))
    fit = Fit({}, free, misfit=misfit, rows=ROWS - nuisances, equations=ROWS, goodness=0.5)
    insertion = SimpleNamespace(
        physics=physics,
        law=(physics, 0),
        spot=Spot("rotor", "force"),
        key=physics,
        free=(),
        fault=SimpleNamespace(confused_with=alike, simpler={}, enters="force"),
    )
    return SimpleNamespace(fit=fit, insertion=insertion, physical=True, unphysical="", parameters=(), final=True)


def chosen(*tried: SimpleNamespace) -> list[str]:
    base = Fit({}, misfit=1000.0, rows=ROWS - 20, equations=ROWS, goodness=0.5)
    order = tuple(sorted(tried, key=lambda item: item.fit.criterion))
    trials = SimpleNamespace(
        round=lambda before: Round(before, order),
        evidence=SimpleNamespace(refines_meshes=lambda document: False),
        counts={},
        nominal={},
        slack=0.0,
        completed=lambda found, physics, law: found,
    )
    return [item.insertion.physics for item in _selected(trials, base).chosen]


@pytest.mark.parametrize(
    ("times", "goodness", "adequate"),
    [(1.049, 0.0, True), (1.051, 0.0, False), (1.2, 1.1e-4, True), (1.2, 0.9e-4, False)],
)
def test_what_is_left_is_noise_or_not_worth_a_name(times, goodness, adequate):
    assert is_adequate(replace(left(times), goodness=goodness)) is adequate


def test_a_parameter_at_its_bound_makes_a_law_unphysical_but_not_one_of_the_diagram():
    found = law({"bow.amplitude": (0.0, 0.1), "damping": (1.0, 0.1)})
    insertion = SimpleNamespace(free=("bow.amplitude",), fault=SimpleNamespace(sizes=(), simpler={}))
    item = Candidate(insertion, replace(found, at_bound=np.array([True, False])))
    assert not item.physical
    assert replace(item, fit=replace(found, at_bound=np.array([False, True]))).physical
    assert Round(found, (item,)).best is None


@pytest.mark.parametrize(("more", "members"), [(9.9, {"rub", "clearance"}), (10.1, {"rub"})])
def test_odds_of_less_than_150_to_1_do_not_part_two_explanations(more, members):
    """exp(10 / 2) = 148."""
    before = Fit({}, misfit=5000.0, rows=ROWS, equations=ROWS)
    found, rival = candidate("rub", 980.0, 1), candidate("clearance", 980.0 + more, 1)
    assert set(effect_of(found, Round(before, (found, rival)), 0.0).members) == members


def test_of_more_than_four_explanations_none_is_named():
    for count, verdict in ((4, "missing_physics"), (5, "not_identifiable")):
        effect = SimpleNamespace(members=dict.fromkeys("abcde"[:count], 1 / count))
        assert verdict_of(named(50.0, 1.0), (effect,)) == verdict


def test_several_effects_of_which_one_may_be_anything_are_a_law_in_no_catalogue():
    """FAULT: the force of eddy currents was three effects, one of which eleven laws explained as well."""
    effects = [SimpleNamespace(members=dict.fromkeys("abcde"[:count], 1 / count)) for count in (1, 4, 5)]
    assert verdict_of(named(50.0, 1.0), effects[:2]) == "missing_physics"
    assert verdict_of(named(50.0, 1.0), effects) == "outside_catalogue"


def test_a_false_alarm_has_the_probability_of_one_percent_whatever_is_tried():
    """Of two candidates each 0.5 %: chi-squared of one unknown 7.879, of two 10.597."""
    one, two = candidate("rub", 990.0, 1), candidate("clearance", 990.0, 2)
    level = _level(Round(Fit({}), (one, two)))
    assert level == pytest.approx(0.005)
    assert _level(Round(Fit({}), (one, two), hypotheses=50)) == pytest.approx(0.0002)  # looked at, but not tried
    base = Fit({}, misfit=1000.0, rows=ROWS - 20, equations=ROWS)
    assert least_gain(one, base, level) == pytest.approx(7.879, abs=1e-3)
    assert least_gain(two, base, level) == pytest.approx(10.597, abs=1e-3)


def test_meshes_may_be_wrong_by_a_tenth_of_the_equations():
    base = Fit({}, misfit=1000.0, rows=ROWS - 20, equations=ROWS, goodness=0.5)
    for gain, found in ((104.0, []), (105.0, ["rub"])):  # 98 and chi-squared of one unknown, 1 %: 6.6
        item = candidate("rub", 1000.0 - gain, 1)
        trials = SimpleNamespace(
            round=lambda before, item=item: Round(before, (item,)),
            evidence=SimpleNamespace(refines_meshes=lambda document: True),
            counts={},
            nominal={},
            slack=0.0,
            completed=lambda found, physics, law: found,
        )
        assert [item.insertion.physics for item in _selected(trials, base).chosen] == found
        assert trials.slack == pytest.approx(98.0)


@pytest.mark.parametrize(
    ("second", "goodness", "chosen"),
    [
        (9.1e3, 0.0, ["rub", "clearance"]),
        (11.9e3, 0.0, ["rub"]),
        (11.9e3, 0.5, ["rub"]),  # hold-out stretches may do, though the misfit is not that of noise
    ],
)
def test_another_effect_must_explain_nine_tenths_of_what_is_left(second, goodness, chosen):
    base = Fit({}, misfit=1e6, rows=ROWS, equations=ROWS)
    first = candidate("rub", 1e5, 1)
    later = candidate("clearance", ROWS + second, 2)
    rounds = {1e6: Round(base, (first,)), 1e5: Round(first.fit, (later,))}
    for item in (first, later):
        item.fit = replace(item.fit, rows=ROWS, goodness=0.0 if item is first else goodness)
    trials = SimpleNamespace(
        round=lambda before: rounds.get(before.misfit, Round(before, ())),
        evidence=SimpleNamespace(refines_meshes=lambda document: False),
        counts={},
        nominal={},
        slack=0.0,
        completed=lambda found, physics, law: found,
        refitted=lambda *_: (),
    )
    assert [item.insertion.physics for item in _selected(trials, base).chosen] == chosen


def test_a_pair_of_which_one_hides_the_other_is_begun_anew_with_its_second():
    """A cross-talk imitates two effects at once; beside it one of them shows, beside which the other does.

    FAULT: saturation and a stop in a crane, of which a signal-dependent gain explained a third, were outside the
    catalogue.
    """
    base = Fit({}, misfit=1e6, rows=ROWS, equations=ROWS)
    imitation, stop, alone, other = (
        candidate(name, misfit, 1)
        for name, misfit in (("cross_talk", 5e5), ("stop", 3e5), ("stop", 9e5), ("saturation", ROWS))
    )
    for item in (imitation, stop, alone, other):
        item.fit = replace(item.fit, rows=ROWS, goodness=0.5 if item is other else 0.0)
    rounds = {1e6: (imitation,), 5e5: (stop,), 9e5: (other,)}
    trials = SimpleNamespace(
        round=lambda before: Round(before, rounds.get(before.misfit, ())),
        evidence=SimpleNamespace(refines_meshes=lambda document: False),
        counts={},
        nominal={},
        slack=0.0,
        completed=lambda found, physics, law: found,
        refitted=lambda base, effects, near: (alone,) if [*effects] == [stop] else (),
    )
    assert [item.insertion.physics for item in _selected(trials, base).chosen] == ["stop", "saturation"]


def test_several_effects_that_leave_noise_by_another_measure_of_it_are_not_searched_for_again():
    """FAULT: a gain that depends on a signal was found, and lost to four look-alikes once the noise was known."""
    base = Fit({}, misfit=1e6, rows=ROWS, equations=ROWS)
    imitation, mode, gain = (
        candidate(name, misfit, 1) for name, misfit in (("friction", 5e5), ("mode", 9e5), ("gain", ROWS))
    )
    for item in (imitation, mode, gain):
        item.fit = replace(item.fit, rows=ROWS, goodness=0.5 if item is gain else 0.0)
    seen = []

    def searched(before: Fit) -> Round:
        seen.append(before.misfit)
        return Round(before, {1e6: (imitation,), 9e5: (gain,)}.get(before.misfit, ()))

    trials = SimpleNamespace(
        round=searched,
        evidence=SimpleNamespace(refines_meshes=lambda document: False),
        counts={},
        nominal={},
        slack=0.0,
        completed=lambda found, physics, law: found,
        refitted=lambda base, effects, near: {2: (mode, gain), 1: (mode,)}[len(effects)] if mode in effects else (),
    )
    earlier = SimpleNamespace(chosen=(mode, gain), fit=gain.fit)
    found = _selected(trials, base, earlier)
    assert [item.insertion.physics for item in found.chosen] == ["mode", "gain"]
    assert [item.before.misfit for item in found.rounds] == [1e6, 9e5]
    assert seen == [1e6, 9e5]  # not beside the imitation


def test_places_that_allow_ten_times_the_least_are_not_looked_at():
    bounds = {"near": 1000.0, "far": 9990.0, "beyond": 10010.0}
    places = SimpleNamespace(
        by_law=False,
        promises=lambda items: [Promise(bounds[item.spot]) if item.spot in bounds else None for item in items],
    )
    found = [SimpleNamespace(law=("rub", 0), spot=spot) for spot in ("beyond", "far", "near", "unknown")]
    trials = Trials(SimpleNamespace(bounds=lambda before: places, costly=False), Catalogue(), Jobs(1))
    kept, *_ = trials._screened(left(50.0), found, [], places, None)
    assert sorted(kept) == [1, 2, 3]


def test_what_was_best_with_another_measure_of_the_noise_is_fitted_again_from_where_it_was():
    """FAULT: a saturation that explained all was not among those that promised most once the noise was known."""
    best, failed = candidate("saturation", 30.0, 1), candidate("lag", 50.0, 1)
    best.fit, best.parameters = replace(best.fit, theta=np.array([11.0])), ("saturation0",)
    failed.fit = Fit({}, failure="diverges")
    assert Round(left(50.0), (best, failed)).worth_again(8) == {"saturation": {"saturation0": 11.0}}


def test_a_round_from_the_same_diagram_begins_with_what_was_best_there():
    """With another measure of the noise, whatever was put in before; of values alone a diagram is no other."""
    of = {"blocks": {"lag": {"type": "lag", "parameters": {"time": 1.0}}}, "wires": [["a.b", "lag.input"]]}
    moved = {**of, "blocks": {"lag": {"type": "lag", "parameters": {"time": 2.0}}}}
    assert structure_of(of) == structure_of(moved) != structure_of({**of, "wires": [["a.c", "lag.input"]]})
    coulomb, other = ({"blocks": {"dry": {"type": "dry", "parameters": {"law": law}}}} for law in ("axes", "resultant"))
    assert structure_of(coulomb) != structure_of(other)
    first = Round(replace(left(50.0), document=of), (candidate("saturation", 30.0, 1),))
    trials = Trials(SimpleNamespace(), Catalogue(), Jobs(1))
    assert trials._kept(first) is trials.rounds[structure_of(moved)]
    again = Trials(SimpleNamespace(), Catalogue(), Jobs(1), trials.rounds)
    assert again.rounds == trials.rounds


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


def test_known_look_alikes_are_fitted_to_the_end_and_may_take_the_place():
    """A delay beside a spring reads like an amplifier; that a fit did not get far is no reason to drop it."""
    before = Fit({}, misfit=5e5, rows=ROWS, equations=ROWS)
    found = candidate("amplifier_bandwidth", 1040.0, 1, alike=("control_delay",))
    delay, bow = candidate("control_delay", 9000.0, 1), candidate("residual_bow", 9000.0, 1)
    ended = candidate("control_delay", 1000.0, 1)
    asked = []

    def completed(given: Round, physics: set[str], chosen: SimpleNamespace, *, every: bool = False) -> Round:
        asked.append((set(physics), chosen.physics, every))
        return Round(before, (ended, found, bow))

    trials = SimpleNamespace(completed=completed, slack=0.0)
    chosen, rounds = _completed(trials, (found,), [Round(before, (found, delay, bow))])
    assert asked == [({"control_delay"}, "amplifier_bandwidth", False), (set(), "control_delay", True)]
    assert [item.insertion.physics for item in chosen] == ["control_delay"]
    assert rounds[0].tried[0] is ended


def test_a_look_alike_is_carried_on_from_where_it_is_at_its_best_place():
    def tried(spot: str, misfit: float) -> SimpleNamespace:
        fit = Fit({"blocks": {}}, misfit=misfit, rows=ROWS, equations=ROWS, nonlinear=True)
        fault = SimpleNamespace(sizes=())
        insertion = SimpleNamespace(physics="rub", law=("rub", 0), spot=Spot(spot, ""), free=(), fault=fault)
        return SimpleNamespace(insertion=insertion, fit=fit, final=False, physical=True)

    far, near = tried("far", 9e5), tried("near", 9e4)
    better = replace(near.fit, misfit=1000.0)
    jobs = []

    class Carried(Trials):
        def _fit(self, given, effort):
            jobs.append((len(given), effort.most))
            return [better]

    found = Carried(None, Catalogue(), Jobs(1)).completed(Round(Fit({}), (far, near)), {"rub"})
    assert jobs == [(1, None)]
    assert [(item.insertion.spot.block, item.fit.misfit, item.final) for item in found.tried] == [
        ("near", 1000.0, True),
        ("far", 9e5, False),
    ]


def test_what_can_be_no_rival_of_the_most_promising_is_not_followed():
    """A hundred times the misfit of one that explains the data; without one, a tenth of what the best explains.

    Where nothing is known of them all are followed.
    """
    asked, before = [], Fit({}, misfit=1e6, rows=ROWS, equations=ROWS)

    class Counted(Trials):
        def _fit(self, given, effort):
            asked.append((list(given), effort.beyond))
            return [Fit({}, misfit=job, rows=ROWS, equations=ROWS, goodness=float(job <= 1.1 * ROWS)) for job in given]

    jobs = [9e5, 1e3, 8e5, 2e4, 7e5, 6e5]
    fits = Counted(None, Catalogue(), Jobs(1))._begun(before, jobs, [5e4, 2e3, np.inf, 1e3, 3e4, 4e4])
    assert asked == [([2e4, 1e3, 7e5, 6e5], np.inf), ([9e5, 8e5], 1e5)]
    assert [fit.misfit for fit in fits] == jobs
    asked.clear()
    Counted(None, Catalogue(), Jobs(1))._begun(before, jobs, [5e4, np.inf, np.inf, 1e3, 3e4, 4e4])
    assert asked == [([2e4, 7e5, 6e5, 9e5], np.inf), ([1e3, 8e5], pytest.approx(1e6 - 0.1 * (1e6 - 2e4)))]
    asked.clear()
    Counted(None, Catalogue(), Jobs(1))._begun(before, jobs, [])
    assert asked == [([], np.inf), (jobs, np.inf)]


def test_what_was_not_fitted_to_the_end_is_not_rejected():
    before = Fit({}, misfit=5e5, rows=ROWS, equations=ROWS)
    found, bow, rub = candidate("clearance", 1000.0, 1), candidate("residual_bow", 4e3, 1), candidate("rub", 3e4, 2)
    rub.final = False
    first = Round(before, (found, bow, rub))
    everything = selection(before, (found,), (first,), found.fit, first)
    effects = (SimpleNamespace(members={"clearance": 1.0}, candidate=found),)
    assert [name for name, _ in rejected_of(everything, effects, Terms())] == ["residual_bow"]
    assert unfinished(everything, effects, Terms()) == (
        ("rub", "was not fitted to the end; so far its residual variance is 30.7 times the noise"),
    )


def free(name: str, unit: str = "N", low: float = 0.0) -> Free:
    return Free(name, "", 0, 1.0, unit, low, np.inf)


def law(sizes: dict[str, tuple[float, float]]) -> Fit:
    """Return a fit with parameters {name: (value, standard deviation)}; angles are in rad."""
    items = tuple(free(name, "rad", -np.inf) if "phase" in name else free(name) for name in sizes)
    theta, stds = np.array(list(sizes.values())).T
    document = {"blocks": {"law": {"parameters": {}}}, "identify": {name: {} for name in sizes}}
    return Fit(document, items, theta, np.diag(stds**2), np.zeros(len(items), bool), 1000.0, ROWS, ROWS, goodness=0.5)


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
    assert _simplified(SimpleNamespace(), (item,)) == (item,)


def test_a_rejection_is_void_once_another_effect_is_in():
    """A bow alone explained nothing beside the rub, which was not known yet; with the rub, it is the simpler law."""
    base = Fit({}, misfit=5e5, rows=ROWS, equations=ROWS)
    coupling, rub = candidate("parallel_misalignment", 3e5, 8), candidate("rub", 990.0, 11)
    bow_alone, bow = candidate("residual_bow", 4.99e5, 2), candidate("residual_bow", 995.0, 5)
    without = candidate("rub", 2e5, 3)
    again = []

    def tried(before: Fit) -> Round:
        again.append(before.misfit)
        return Round(before, (bow, replaced(coupling, 990.0, 11)))

    trials = SimpleNamespace(round=tried, refitted=lambda *_: (without,), slack=0.0)
    rounds = [Round(base, (coupling, bow_alone)), Round(coupling.fit, (rub,))]
    chosen, _ = _reconsidered(trials, base, (coupling, rub), rounds)
    assert again[0] == 2e5
    assert {item.insertion.physics for item in chosen} == {"residual_bow", "rub"}


def replaced(item: SimpleNamespace, misfit: float, extra: int) -> SimpleNamespace:
    return candidate(item.insertion.physics, misfit, extra)


def test_a_class_is_judged_as_the_effect_stood_in_its_round():
    """An effect may carry a fit without another that was exchanged since: its rivals stood beside that one too."""
    before = Fit({}, misfit=5000.0, rows=ROWS, equations=ROWS)
    in_round, rival = candidate("rub", 980.0, 1), candidate("clearance", 1500.0, 1)
    stale = candidate("rub", 90000.0, 1)
    effect = effect_of(stale, Round(before, (in_round, rival)), 0.0)
    assert effect.members == {"rub": 1.0}
    assert effect.candidate.fit is in_round.fit


def placed(law: str, spot: str) -> SimpleNamespace:
    return SimpleNamespace(law=(law, 0), spot=spot, key=f"{law}@{spot}")


def test_another_measure_of_the_noise_looks_again_at_what_promised_within_ten_times_the_least():
    found = [placed("lag", spot) for spot in ("best", "within", "beyond", "unknown")]
    promises = [Promise(2e4), Promise(1.9e5), Promise(2.1e5), None]
    assert likely_of(found, promises, left(1e6)) == {"lag@best", "lag@within", "lag@unknown"}


def test_with_another_noise_fits_say_more_than_promises():
    """What leaves ten times the best is not looked at, unless its fit was stopped early: it may have begun far away.

    FAULT: a delay that promised little and was fitted best was forgotten with another noise.
    """
    tried = [candidate(name, misfit, 1) for name, misfit in {"delay": 50.0, "lag": 499.0, "offset": 501.0}.items()]
    stopped = candidate("play", 501.0, 1)
    stopped.final = False
    promised = frozenset({"lag", "offset", "play", "drift"})
    assert still_likely(promised, [*tried, stopped]) == {"delay", "lag", "play", "drift"}


def test_the_two_best_laws_are_fitted_at_four_other_places_before_one_is_chosen():
    """FAULT: a dead zone promised 557 behind a torque and 583 at the stiffness that made it; fitted at the torque
    alone it left 1340 instead of 268, and two effects more were looked for in vain."""
    found = [placed("play", "here"), *(placed("dead_zone", spot) for spot in ("torque", "same", "a", "b", "c", "d"))]
    found += [placed(law, spot) for law in ("lag", "offset") for spot in ("here", "there")]
    promises = [Promise(value) for value in (400.0, 557.0, 557.5, 583.0, 600.0, 610.0, 9e5, 700.0, 710.0, 720.0, 730.0)]
    fits = {0: left(900.0), 1: left(1.3), 7: left(3.0), 9: left(9.0)}
    kept = at_other_places(found, promises, left(1e4), fits)
    assert [found[k].key for k in kept] == ["dead_zone@a", "dead_zone@b", "dead_zone@c", "dead_zone@d", "lag@there"]
    assert at_other_places(found, promises, left(1e4), {0: Fit({}, failure="diverges")}) == []


def test_far_from_the_runs_every_law_is_fitted_at_the_places_where_a_free_signal_explains_them():
    """FAULT: a delay of 48 s in a pump promised nothing beside outlets that were fitted without it; a free signal
    there explained everything, and at no other place."""
    found = [placed(law, spot) for law in ("play", "delay") for spot in ("pump", "balance", "level")]
    promises = [Promise(value) for value in (9e5, 8e5, 2e3, 9e5, 9e5 + 1, 1e3)]
    pump = PlaceClass((found[0].spot, found[1].spot), 0.99)
    level = PlaceClass((found[2].spot,), 0.99 * np.exp(-5.1))
    assert [found[k].key for k in at_likely_places(found, promises, (pump, level), {2: left(1e3)})] == [
        "play@balance",
        "delay@pump",
    ]
    near = replace(level, probability=0.99 * np.exp(-4.9))
    assert [found[k].key for k in at_likely_places(found, promises, (pump, near), {2: left(1e3)})] == ["delay@level"]
    assert at_likely_places(found, promises, (pump, level), {2: left(1.0)}) == []  # explained
    assert at_likely_places(found, promises, (), {2: left(1e3)}) == []  # promises are sure


def test_what_holds_a_law_as_a_special_case_is_no_rival_unless_it_explains_more():
    """Odds of e^4 = 55 to 1 against one more parameter would list a mode beside every lag."""
    before = Fit({}, misfit=5000.0, rows=ROWS, equations=ROWS)
    found, wider = candidate("lag", 980.0, 1), candidate("missing_mode", 980.0, 2)
    assert set(effect_of(found, Round(before, (found, wider)), 0.0).members) == {"lag", "missing_mode"}
    wider.insertion.fault.simpler = {"frequency": (np.inf, "lag")}
    assert set(effect_of(found, Round(before, (found, wider)), 0.0).members) == {"lag"}
    signal, same = candidate("coupling", 980.0, 2), candidate("coupling", 980.0, 1)
    signal.insertion.fault.enters = same.insertion.fault.enters = "signal"  # a force once more, with more parameters
    assert set(effect_of(found, Round(before, (found, signal)), 0.0).members) == {"lag"}
    assert set(effect_of(found, Round(before, (found, same)), 0.0).members) == {"lag", "coupling"}
    better = candidate("missing_mode", 970.0, 2)
    better.insertion.fault.simpler = wider.insertion.fault.simpler
    assert set(effect_of(better, Round(before, (better, found)), 0.0).members) == {"lag", "missing_mode"}


def test_of_fits_that_nothing_tells_apart_the_one_whose_reading_is_right_comes_first():
    both, taken = candidate("delay", 100.0, 1), candidate("delay", 100.009, 1)
    both.insertion.spot = Spot("amplifier", "output", side="both")
    assert simplest_first([both, taken], 0.0) == [taken, both]
    worse = candidate("delay", 100.02, 1)
    assert simplest_first([both, worse], 0.0) == [both, worse]


def test_a_law_that_is_chosen_is_fitted_at_more_places_that_promise_half_as_much():
    """So that places that data cannot tell apart are named together, though each law was fitted at its best place."""
    found = [placed("lag", spot) for spot in "abcdef"] + [placed("delay", "a")]
    promises = [*(Promise(value) for value in (2.0e4, 2.1e4, 3.9e4, 3.0e4, 2.2e4, 4.1e4)), Promise(9e4)]
    assert at_rival_places(found, promises, left(1e6), kept=[0, 6]) == [1, 4, 3, 2]


def test_a_law_is_fitted_where_rivals_promise_as_much(monkeypatch):
    own = {"spot": Spot("servo", "output"), "free": (), "fault": SimpleNamespace(sizes=()), "depends_on": ""}
    insertion = SimpleNamespace(physics="lag", law=("lag", 0), key="lag", **own)
    other = SimpleNamespace(physics="delay", law=("delay", 0), key="delay", **own)
    best = SimpleNamespace(insertion=insertion, fit=left(100.0), final=True, physical=True)
    trials = Trials(SimpleNamespace(), Catalogue(), Jobs(1))
    monkeypatch.setattr(trials, "_fit", lambda jobs, effort: [left(101.0)] * len(jobs))
    before = Round(left(1e6), (best,), elsewhere=((insertion, ({}, [])), (other, ({}, []))))
    after = trials.completed(before, set(), insertion)
    assert [item.fit.misfit for item in after.tried] == [left(100.0).misfit, left(101.0).misfit]
    assert [item for item, _ in after.elsewhere] == [other]


def test_look_alikes_of_a_choice_are_fitted_in_its_very_place():
    """Cross-talk promised more elsewhere; where a ripple of small wave number was chosen, it explains as much."""

    def untried(physics: str, spot: str, other: str) -> SimpleNamespace:
        own = {"law": (physics, 0, True), "free": (), "fault": SimpleNamespace(sizes=())}
        return SimpleNamespace(
            physics=physics, spot=Spot(spot, ""), depends_on=other, key=f"{physics}({other})@{spot}", **own
        )

    ripple = SimpleNamespace(insertion=untried("ripple", "a", "level"), fit=left(100.0), final=True, physical=True)
    here = untried("cross_talk", "a", "level")
    others = [untried("cross_talk", "b", "level"), untried("cross_talk", "a", "pump"), untried("stop", "a", "level")]
    trials = Trials(SimpleNamespace(), Catalogue(), Jobs(1))
    trials._fit = lambda jobs, effort: [left(99.0)] * len(jobs)
    before = Round(left(1e6), (ripple,), untried=tuple((item, ({"blocks": {}}, [])) for item in (*others, here)))
    after = trials.completed(before, {"cross_talk"}, ripple.insertion)
    assert [item.insertion for item in after.tried] == [here, ripple.insertion]
    assert [item for item, _ in after.untried] == others
    [every] = [trials.completed(before, set(), ripple.insertion, every=True)]
    assert {item.insertion.key for item in every.tried} == {ripple.insertion.key, here.key, others[2].key}


def test_at_the_place_of_the_best_every_law_is_tried_before_another_effect_is_looked_for():
    """A mode imitated a delay at the place where that promised most: the delay was fitted elsewhere only."""
    base = left(1e4)
    base = replace(base, goodness=0.0, misfit=1e4 * ROWS, rows=ROWS, equations=ROWS)
    mode, delay = candidate("mode", 3.0 * ROWS, 2), candidate("delay", 1.0 * ROWS, 1)
    mode.fit = replace(mode.fit, goodness=0.0)
    asked = []

    def completed(found, physics, law=None, *, every=False):
        asked.append((law.physics, every))
        tried = (delay, mode) if every else found.tried
        return replace(found, tried=tried)

    trials = SimpleNamespace(
        round=lambda before: Round(before, (mode,), untried=((delay.insertion, ({}, [])),)),
        evidence=SimpleNamespace(refines_meshes=lambda document: False),
        counts={},
        slack=0.0,
        completed=completed,
    )
    assert [item.insertion.physics for item in _selected(trials, base).chosen] == ["delay"]
    assert asked == [("mode", True), ("delay", False)]


@pytest.mark.parametrize(("goodness", "tried"), [(0.5, ["lag"]), (0.0, ["lag", "hum"])])
def test_beside_noise_a_line_is_hum_of_the_instruments(goodness, tried):
    """FAULT: of a healthy drive 50 Hz of 0.6 of the noise in one reading was called a periodic disturbance."""
    lag = SimpleNamespace(physics="lag", from_lines=(), read_off=False, begins_at_line=False)
    hum = SimpleNamespace(physics="hum", from_lines=(), read_off=False, begins_at_line=True)
    evidence = SimpleNamespace(largest=dict, load=lambda document: document, recorded=())
    trials = Trials(evidence, SimpleNamespace(candidates=lambda diagram, recorded: [lag, hum]), Jobs(1))
    assert [item.physics for item in trials._candidates(replace(left(1.2), goodness=goodness), {})] == tried


def test_what_begins_at_a_line_is_known_by_its_declaration():
    of = {
        key: Insertion(Disturbance, fault, Spot("a", "output"), "a").begins_at_line
        for key, fault in ((fault.physics, fault) for fault in Disturbance.faults)
    }
    assert of == {
        "offset": False,
        "drift": False,
        "step_disturbance": False,
        "unmeasured_disturbance": False,
        "periodic_disturbance": True,
    }
