"""Bounds on what any law at a place can explain: below every fit there, tight at the true one, exact for readings."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.catalogue.insertion import Insertion, fixed_of, starts_of
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.harmonic.bounds import LowerBounds, open_bounds
from rotorsim.diagnosis.evidence.harmonic.evidence import HarmonicEvidence
from rotorsim.identification.harmonic.estimate import Search
from rotorsim.identification.harmonic.experiment import open_experiment
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.signals.covariance import complex_values
from rotorsim.signals.harmonics import harmonics_of
from tests.identification import OTHER_GAINS, made, recorded, shipped
from tests.reference.recordings import THESIS_GAINS

RPM = 2 * np.pi / 60
SPEEDS = [rpm * RPM for rpm in (900, 1800, 2600)]
ORDERS = 8
LEVEL = 1e-4  # significance; the noise is that of one seed
FAR = 10.0  # times the least bound: places there are not looked at
TRUE = {
    "residual_bow/0@rotor.force[4]": {"amplitude": 3e-8, "phase": 1.0},
    "sensor_gain/0@rotor.displacement[2]": {"gain_error": 2e-3},
    "cubic_stiffness/0@rotor.force[3]": {"stiffness": 2e13},
}
LAWS = ("residual_bow/0", "unbalance_elsewhere/0", "anisotropic_support/0", "second_crack/0")


@cache
def healthy() -> tuple[HarmonicEvidence, Fit]:
    """Return six runs of the beam as it should be, and the diagram fitted to them."""
    runs = [run for gains in (THESIS_GAINS, OTHER_GAINS) for run in made("fe_rigid", SPEEDS, gains=gains, level=1e-3)]
    data = recorded(runs)
    source = HarmonicEvidence(data, tuple(harmonics_of(data, orders=ORDERS)))
    return source, source.fit(shipped("fe_rigid").document, [])


def with_keyway(document: Mapping[str, Any], asymmetry: float) -> dict[str, Any]:
    """Return a document of fe_rigid with a stiffness at node 3 that turns with the shaft: order k answers to 2 - k."""
    block = {"type": "asymmetric_shaft", "parameters": {"asymmetry": asymmetry, "phase": 0.4}}
    ends = [
        ["rotor.displacement[3]", "keyway.displacement"],
        ["clock.theta", "keyway.theta"],
        ["keyway.force", "rotor.force[3]"],
    ]
    return {**document, "blocks": {**document["blocks"], "keyway": block}, "wires": [*document["wires"], *ends]}


def items(source: HarmonicEvidence, base: Fit) -> dict[str, Insertion]:
    diagram = source.load(values_in(base.document, base.values))
    return {item.key: item for item in insertions(diagram, source.recorded)}


@cache
def concealing(key: str, factor: float = 1.0, keyway: float = 0.0) -> tuple[HarmonicEvidence, Fit, LowerBounds | None]:
    """Return harmonics that a diagram with something more in it predicts, with noise, and the diagram without it.

    factor: of its size. keyway: half of the difference of two bending stiffnesses [N/m], which both have at node 3.
    """
    source, base = healthy()
    if keyway:
        base = replace(base, document=with_keyway(base.document, keyway))
    size, *others = TRUE[key].items()
    values = {size[0]: factor * size[1], **dict(others)}
    document = items(source, base)[key].document(values_in(base.document, base.values), values)
    experiment = source.open(source.load(document))
    likelihood = Likelihood(experiment)
    Y = experiment.motion.predict(experiment.theta0).Y
    random, harmonics = np.random.default_rng(5), []
    for r, item in enumerate(source.harmonics):
        white = likelihood.whiteners[r]
        noise = np.zeros((2 * ORDERS + 1) * likelihood.c)
        noise[white.keep] = np.linalg.solve(white.matrix, random.standard_normal(len(white.keep)))
        values = item.fit.values.copy()
        values[:, experiment.columns[r]] = Y[r] + complex_values(noise, likelihood.c)
        harmonics.append(replace(item, fit=replace(item.fit, values=values)))
    source = replace(source, harmonics=tuple(harmonics))
    fit = source.fit(values_in(base.document, base.values), [])
    return source, fit, open_bounds(fit, source)


def fitted(source: HarmonicEvidence, base: Fit, item: Insertion) -> Fit:
    sizes = dict.fromkeys(item.feeds, 1e-5)
    starts = [dict(zip(item.free, start.values(), strict=True)) for start in starts_of(item, sizes)]
    first = {**fixed_of(item, sizes), **starts_of(item, sizes)[0]}
    document = item.document(values_in(base.document, base.values), first)
    return source.fit(document, [starts])


def bound_at(fit: Fit, source: HarmonicEvidence, base: Fit, item: Insertion) -> float:
    """Return the bound of the diagram at its parameters in a fit with something more."""
    theta = np.array([fit.values[free.name] for free in base.free])
    return open_bounds(replace(base, theta=theta), source).bound(item)


@pytest.mark.slow
@pytest.mark.parametrize("law", [*LAWS[:1], *(pytest.param(law, marks=pytest.mark.slow) for law in LAWS[1:])])
@pytest.mark.parametrize("node", [2, *(pytest.param(node, marks=pytest.mark.slow) for node in (3, 4, 5))])
def test_no_law_explains_more_than_a_free_force_at_its_place(law, node):
    """Exactly so at the parameters of its own fit; those of the diagram alone are a step of linear theory away."""
    source, base, places = concealing("residual_bow/0@rotor.force[4]")
    item = items(source, base)[f"{law}@rotor.force[{node}]"]
    fit = fitted(source, base, item)
    bound, there = places.bound(item), bound_at(fit, source, base, item)
    assert fit.misfit > (1 - 1e-9) * there
    assert fit.misfit > bound - abs(there - bound)
    assert there == pytest.approx(bound, rel=0.05)  # where places are told apart by a factor of ten


def assert_noise(bound: float, base: Fit, taken: int) -> None:
    """Check that a bound is what noise leaves in the equations left beside unknowns of the place and the diagram."""
    low, high = chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], base.rows - taken - len(base.free))
    assert low < bound < high


@pytest.mark.slow
def test_the_place_of_a_force_leaves_noise_and_others_far_more():
    """Two forces, 2 ORDERS + 1 real numbers each, are free in each of six runs; so are two moments for a crack."""
    source, base, places = concealing("residual_bow/0@rotor.force[4]")
    found = items(source, base)
    bounds = {node: places.bound(found[f"residual_bow/0@rotor.force[{node}]"]) for node in (2, 3, 4, 5)}
    assert_noise(bounds[4], base, 6 * 2 * (2 * ORDERS + 1))
    assert min(bounds[node] for node in (2, 3, 5)) > FAR * bounds[4]
    assert_noise(places.bound(found["second_crack/0@rotor.force[4]"]), base, 6 * 4 * (2 * ORDERS + 1))


@pytest.mark.slow
def test_a_strong_force_leaves_noise_beside_means_of_slow_states():
    """Where the diagram is right but for the force; its mean and those of slow states are free together."""
    source, base, _ = concealing("residual_bow/0@rotor.force[4]", 100.0)
    item = items(source, base)["residual_bow/0@rotor.force[4]"]
    bound = bound_at(fitted(source, base, item), source, base, item)
    assert_noise(bound, base, 6 * 2 * (2 * ORDERS + 1))


def dropped(source: HarmonicEvidence, base: Fit, names: list[str]) -> tuple[Search, np.ndarray]:
    """Return the fit of the diagram without some channels, and where it begins."""
    experiment = open_experiment(
        source.load(values_in(base.document, base.values)), source.recording, harmonics=source.harmonics, drop=names
    )
    search = Search(Likelihood(experiment))
    return search, search.coordinates.inside(experiment.theta0)


@pytest.mark.parametrize("node", [2, 4, 5])
def test_a_reading_that_may_be_anything_is_as_good_as_none(node):
    """The slopes of the two are taken at means of slow states that differ a little."""
    source, base, places = concealing("sensor_gain/0@rotor.displacement[2]")
    found = items(source, base)
    bound = places.bound(found[f"sensor_gain/0@rotor.displacement[{node}]"])
    assert bound == places.bound(found[f"runout/0@rotor.displacement[{node}]"])
    search, start = dropped(source, base, [f"rotor.displacement[{node},{axis}]" for axis in (1, 2)])
    assert search.promise(start) == pytest.approx(bound, rel=1e-5)
    assert search.evaluation(search.minimise(start)).misfit.sum() == pytest.approx(bound, rel=1e-4)
    if node == 2:
        assert_noise(bound, base, 6 * 2 * (2 * ORDERS + 1))
    else:
        assert bound > FAR * base.rows


def test_a_sensor_in_the_loop_has_no_bound():
    """What the controller takes in moves the rotor: it is not only the reading that is wrong."""
    source, base, places = concealing("sensor_gain/0@rotor.displacement[2]")
    item = items(source, base)["sensor_gain/0@rotor.displacement[3]"]
    assert item.cut
    assert places.bound(item) is None
