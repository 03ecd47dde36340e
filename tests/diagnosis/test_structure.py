"""Detectability and isolability: published examples, generic ranks of random matrices, rotors whose answer is known."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.diagnosis.catalogue.finder import insertions
from rotorsim.diagnosis.catalogue.insertion import Insertion, starts_of
from rotorsim.diagnosis.isolability.equations import entries_of, structure_of
from rotorsim.diagnosis.isolability.isolation import Isolation, isolate, isolation_data
from rotorsim.diagnosis.isolability.motion import LinearMotion
from rotorsim.diagnosis.isolability.runs import Runs, runs_of
from rotorsim.diagnosis.isolability.signatures import signatures_of
from rotorsim.diagnosis.isolability.structure import Structure
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from rotorsim.settled.periodic import periodic

BOTH = ("rotor.displacement", "controller.current")


def _structure(equations: dict[str, str], faults: dict[str, str] | None = None) -> Structure:
    rows = {name: frozenset(unknowns.split()) for name, unknowns in equations.items()}
    return Structure(rows, {name: (frozenset({at}),) for name, at in (faults or {}).items()})


# -- published examples ------------------------------------------------------------------------------------------------


def test_sensor_sets_of_krysander_and_frisk() -> None:
    """Krysander & Frisk (2008), introductory example: which sensors of five states detect and isolate four faults."""
    rows = {"e1": "x1 x2 x5", "e2": "x2 x3 x4", "e3": "x3 x5", "e4": "x4 x5", "e5": "x5"}
    plain = _structure(rows, {"f1": "e3", "f2": "e3", "f3": "e4", "f4": "e5"})
    model = Structure(plain.equations, plain.faults, {}, {f"x{k}": (f"x{k}",) for k in range(1, 6)})
    assert not model.detectable
    detecting: list[tuple[str, ...]] = []
    isolating: list[tuple[str, ...]] = []
    for size in range(6):
        for chosen in combinations(model.extra, size):
            more = model.with_sensors(chosen)
            good = more.detectable == set(model.faults)
            apart = good and [len(more.not_isolable_from[f]) for f in ("f1", "f2", "f3", "f4")] == [1, 1, 0, 0]
            detecting += [chosen] if good and not any(set(s) < set(chosen) for s in detecting) else []
            isolating += [chosen] if apart and not any(set(s) < set(chosen) for s in isolating) else []
    assert detecting == [("x1",), ("x2",), ("x3", "x4")]
    assert isolating == [("x1", "x3"), ("x1", "x4"), ("x2", "x3"), ("x2", "x4"), ("x3", "x4")]
    smallest = model.smallest()
    assert tuple(sorted(smallest.sensors)) in isolating
    assert smallest.detected == set(model.faults)


THREE_TANKS = {
    "e1": "q1 p1 p2",
    "e2": "q2 p2 p3",
    "e3": "q3 p3",
    "e4": "d1 q0 q1",
    "e5": "d2 q1 q2",
    "e6": "d3 q2 q3",
    "e7": "p1",
    "e8": "q2",
    "e9": "q0",
    "e10": "d1 p1",
    "e11": "d2 p2",
    "e12": "d3 p3",
}


def test_three_tanks() -> None:
    """Frisk et al., IEEE Trans. SMC-A 42 (2012) 1216, with derivatives as unknowns: six minimal sets."""
    faults = {"fV1": "e1", "fV2": "e2", "fV3": "e3", "fT1": "e4", "fT2": "e5", "fT3": "e6"}
    model = _structure(THREE_TANKS, faults)
    assert model.redundancy == 2
    assert set(model.tests()) == _circuits(THREE_TANKS)
    assert len(model.tests()) == 6
    assert len(model.tests(most=4)) == 4
    assert model.detectable == set(faults)
    assert model.groups == [("fV2", "fV3", "fT3"), ("fV1",), ("fT1",), ("fT2",)]


def test_water_tank() -> None:
    """A tank with level w, pump q1 = u, outflow q2(w), sensors of both: four tests by hand."""
    rows = {"e1": "q1", "e2": "dw q1 q2", "e3": "q2 w", "e4": "w", "e5": "q2", "e6": "dw w"}
    tests = {frozenset(some.split()) for some in ("e3 e4 e5", "e1 e2 e4 e5 e6", "e1 e2 e3 e4 e6", "e1 e2 e3 e5 e6")}
    model = _structure(rows, {"pump": "e1", "clogged": "e3", "level sensor": "e4", "flow sensor": "e5"})
    assert set(model.tests()) == tests
    assert not any(model.not_isolable_from.values())  # of each pair some test holds one and not the other


# -- against generic ranks ---------------------------------------------------------------------------------------------


def _matrix(rows: dict[str, str]) -> np.ndarray:
    unknowns = sorted({u for some in rows.values() for u in some.split()})
    random = np.random.default_rng(7).uniform(0.5, 1.5, (len(rows), len(unknowns)))
    return random * np.array([[u in some.split() for u in unknowns] for some in rows.values()])


def _rank(matrix: np.ndarray) -> int:
    return int(np.linalg.matrix_rank(matrix)) if matrix.size else 0


def _circuits(rows: dict[str, str]) -> set[frozenset[str]]:
    """Return the minimal linearly dependent sets of rows of a matrix with these nonzeros and numbers of chance."""
    names, matrix = list(rows), _matrix(rows)
    found: set[frozenset[str]] = set()
    for size in range(1, len(names) + 1):
        for some in combinations(range(len(names)), size):
            chosen = frozenset(names[k] for k in some)
            if not any(c <= chosen for c in found) and _rank(matrix[list(some)]) < size:
                found.add(chosen)
    return found


@st.composite
def _models(draw: st.DrawFn) -> dict[str, str]:
    unknowns = [f"x{k}" for k in range(draw(st.integers(1, 5)))]
    some = st.sets(st.sampled_from(unknowns), min_size=1, max_size=3)
    return {f"e{k}": " ".join(sorted(draw(some))) for k in range(draw(st.integers(1, 8)))}


@pytest.mark.slow
@settings(max_examples=75, deadline=None)
@given(_models())
def test_tests_are_the_circuits_of_a_generic_matrix(rows: dict[str, str]) -> None:
    model = _structure(rows)
    found = model.tests(most=10_000)
    assert len(found) == len(set(found))
    assert set(found) == _circuits(rows)


@pytest.mark.slow
@settings(max_examples=75, deadline=None)
@given(_models(), st.data())
def test_isolability_is_that_of_generic_ranks(rows: dict[str, str], data: st.DataObject) -> None:
    """A fault a is isolable from b if its column is not in the span of the unknowns and the column of b."""
    a, b = (data.draw(st.sampled_from(sorted(rows))) for _ in range(2))
    model = _structure(rows, {"a": a, "b": b})
    matrix, unit = _matrix(rows), np.eye(len(rows))
    columns = {name: unit[:, [list(rows).index(at)]] for name, at in (("a", a), ("b", b))}
    assert ("a" in model.detectable) == (_rank(np.hstack([matrix, columns["a"]])) > _rank(matrix))
    known = np.hstack([matrix, columns["b"]])
    assert ("b" not in model.not_isolable_from["a"]) == (_rank(np.hstack([known, columns["a"]])) > _rank(known))


# -- rotors ------------------------------------------------------------------------------------------------------------


@cache
def _of(name: str, *sensors: str) -> Structure:
    diagram = load(name)
    return structure_of(diagram, sensors, insertions(diagram, entries_of(diagram, sensors)))


CONTROLLER = ("control_delay/0@controller.current", "controller_gain_error/0@controller.current")
ROTOR = ("residual_bow/0@rotor.force", "rub/0@rotor.force", "support_stiffness/0@rotor.force")


def test_controller_faults_are_isolable_from_rotor_faults_with_the_current() -> None:
    model = _of("jeffcott", *BOTH)
    assert model.redundancy == 4
    for fault in CONTROLLER:
        assert fault in model.detectable
        assert not set(ROTOR) & model.not_isolable_from[fault]
        assert not any(fault in model.not_isolable_from[other] for other in ROTOR)
    assert set(ROTOR) - {ROTOR[0]} <= model.not_isolable_from[ROTOR[0]]  # forces at one place, of any form
    assert "runout/0@rotor.displacement" in model.not_isolable_from[ROTOR[0]]
    assert "current_sensor_gain/0@controller.current" not in model.not_isolable_from[CONTROLLER[1]]


def test_controller_faults_are_not_isolable_from_rotor_faults_by_displacement_alone() -> None:
    model = _of("jeffcott", "rotor.displacement")
    unrecorded = "control_delay/1@amb.current"
    assert model.redundancy == 2
    assert unrecorded in model.detectable
    assert set(ROTOR) <= model.not_isolable_from[unrecorded]
    assert all(unrecorded in model.not_isolable_from[other] for other in ROTOR)
    assert model.gain(["controller.current"]).isolated.any()


def test_the_law_of_the_controller_is_tested_without_the_rotor() -> None:
    model = _of("jeffcott", *BOTH)
    smallest = min(model.tests(), key=len)
    blocks = {name.partition(".")[0] for name in smallest if not name.startswith(("sensor", "node"))}
    assert blocks == {"controller"}


@pytest.mark.slow
def test_forces_at_nodes_need_probes() -> None:
    one = _of("fe_rigid", "rotor.displacement[3]", "controller.current")
    bow = "residual_bow/0@rotor.force[{}]".format
    assert bow(4) in one.not_isolable_from[bow(2)]
    gain = {item.sensors[0]: item.counts[0] for item in one.placements()}
    assert gain["rotor.displacement[2]"] > gain["second rotor.displacement[3]"]
    assert "rotor.displacement[1]" not in gain  # a pinned node does not move
    four = _of("fe_rigid", *(f"rotor.displacement[{k}]" for k in (2, 3, 4, 5)), "controller.current")
    assert bow(4) not in four.not_isolable_from[bow(2)]
    assert bow(2) not in four.not_isolable_from[bow(4)]


def test_what_moves_no_sensor_is_not_detectable() -> None:
    diagram = load("jeffcott", set={}, without=["amb"])  # the controller's current goes nowhere
    sensors = ["rotor.displacement"]
    model = structure_of(diagram, sensors, insertions(diagram, entries_of(diagram, sensors)))
    assert "controller_gain_error/0@rotor.displacement" not in model.detectable
    assert "residual_bow/0@rotor.force" in model.detectable
    assert not any(name.startswith("second controller") for name in model.extra)


@pytest.mark.slow
def test_smallest_isolates_as_much_as_all_sensors() -> None:
    model = _of("fe_rigid", "rotor.displacement[3]", "controller.current")
    smallest, every = model.smallest(), model.gain(list(model.extra))
    assert smallest.detected == every.detected
    assert np.array_equal(smallest.isolated, every.isolated)
    assert len(smallest.sensors) < len(model.extra)
    for name in smallest.sensors:
        fewer = model.gain([other for other in smallest.sensors if other != name])
        assert fewer.counts < every.counts


def test_the_same_machine_of_elementary_blocks() -> None:
    """Drawn from sums, gains and integrators the machine has as many tests, and the controller has its own."""
    model = structure_of(load("jeffcott_elementary"), BOTH)
    assert model.redundancy == 4
    smallest = min(model.tests(), key=len)
    blocks = {name.partition(".")[0] for name in smallest if not name.startswith("sensor")}
    assert blocks & {"proportional_x", "proportional_y"}
    assert not any(block.startswith(("acceleration", "crack", "unbalance")) for block in blocks)


@pytest.mark.parametrize(
    ("sensor", "text"),
    [
        (
            "rotor.displacment",
            "error: sensor rotor.displacment: the diagram has no such output\n\n"
            "hint: did you mean 'rotor.displacement'?",
        ),
        (
            "rotor",
            "error: sensor rotor: is not a signal\n\n"
            "hint: write block.port, with [node] or [node,axis] counted from 1; signals: "
            "rotor.displacement, rotor.velocity",
        ),
        (
            "rotor.displacement[3]",
            "error: sensor rotor.displacement[3]: no such entry: the signal is 2\n\nhint: counted from 1",
        ),
        (
            "rotor.displacement[1,1]",
            "error: sensor rotor.displacement[1,1]: no such entry: the signal is 2\n\nhint: counted from 1",
        ),
    ],
)
def test_wrong_sensors(sensor: str, text: str) -> None:
    with pytest.raises(RotorsimError) as raised:
        entries_of(load("jeffcott"), [sensor])
    assert str(raised.value) == text


def test_no_sensors() -> None:
    with pytest.raises(RotorsimError) as raised:
        entries_of(load("jeffcott"), [])
    assert str(raised.value) == (
        "error: jeffcott: no sensors\n\n"
        "hint: signals: rotor.displacement, rotor.velocity, controller.current, amb.force, reference.signal, bus.output"
    )


# -- by laws -----------------------------------------------------------------------------------------------------------


@cache
def _isolated() -> Isolation:
    return isolate(load("jeffcott"), BOTH)


@pytest.mark.slow
def test_what_the_free_parameters_imitate() -> None:
    laws = _isolated().laws
    assert laws is not None
    assert set(laws.one.undetectable) == {
        "magnetic_pull/0@rotor.force",
        "support_stiffness/0@rotor.force",
        "support_stiffness/1@rotor.force",
        "sensor_gain/0@rotor.displacement",
        "unbalance_elsewhere/0@rotor.force",
    }
    detected, isolated = laws.sensors["second rotor.displacement"]
    assert detected == {"sensor_gain/0@rotor.displacement"}
    bow, runout = "residual_bow/0@rotor.force", "runout/0@rotor.displacement"
    assert (bow, runout) in isolated
    pair = next(item for item in laws.weakly_isolable if (item.fault, item.other) == (bow, runout))
    assert pair.size is not None
    assert pair.size_with_gains is not None
    assert laws.one.size(bow) < 1e-7 < pair.size_with_gains < pair.size
    assert laws.one.not_isolable_from[bow] >= {"thermal_bow/0@rotor.force"}


SPEEDS = np.array([90.0, 140.0, 200.0])
CHANNELS = [f"{name}[{axis}]" for name in BOTH for axis in (1, 2)]


def settled_runs(diagram: Diagram, changes: Mapping[str, float]) -> np.ndarray:
    """Return harmonics 0..14 of the channels by the solver of ``rotorsim periodic``, (R, 15, 4)."""
    names = [diagram.as_measured(name) for name in CHANNELS]
    found = periodic(diagram, speeds=SPEEDS, parameters=changes, signals=names, harmonics=60, stability=False)
    zero = int(np.flatnonzero(found.orders == 0)[0])
    return np.stack([found.harmonics[name][:, zero : zero + 15] for name in names], axis=2)


@pytest.mark.parametrize(
    ("key", "parameter", "steps", "shape"),
    [
        ("residual_bow/0@rotor.force", "amplitude", (2e-6, 1e-6), {"phase": 0.0}),
        ("rub/0@rotor.force", "stiffness", (40.0, 20.0), {}),
        ("eddy_current_lag/1@amb.current", "share", (2e-3, 1e-3), {"time_constant": 1e-3}),
        *(
            pytest.param(*each, {}, marks=pytest.mark.slow)
            for each in (
                ("support_stiffness/0@rotor.force", "stiffness", (2000.0, 1000.0)),
                ("seal_cross_coupling/0@rotor.force", "cross_stiffness", (200.0, 100.0)),
                ("sensor_gain/0@rotor.displacement", "gain_error", (2e-3, 1e-3)),
                ("current_sensor_gain/0@controller.current", "gain_error", (2e-3, 1e-3)),
            )
        ),
    ],
)
def test_signatures_are_the_limits_of_small_faults(
    key: str, parameter: str, steps: tuple[float, ...], shape: dict[str, float]
) -> None:
    """The sensitivity at no size is the change by a small fault, linear or not, up to an error that halves with it."""
    diagram = load("jeffcott")
    fault = {item.key: item for item in insertions(diagram, CHANNELS)}[key]
    runs = runs_of(diagram, SPEEDS)
    found = signatures_of(diagram, [fault], CHANNELS, runs)
    assert found.sizes[key].parameter == parameter
    base = settled_runs(diagram, {})
    scale = np.sqrt((np.abs(_both(runs, diagram)) ** 2).sum(axis=1).max(axis=0))
    rows = (found.row_set == 0).reshape(2, -1)[0]
    column = found.columns[key][:, 0].reshape(2, -1)[:, rows]
    slope = (column[0] + 1j * column[1]).reshape(base.shape) * scale
    start = {key: value for key, value in _starts(fault).items() if key != parameter}
    placed = load(fault.document(diagram.document, {**start, **shape, parameter: 0.0}))
    errors = []
    for step in steps:
        changed = settled_runs(placed, {f"{fault.name}.{parameter}": step})
        difference = np.abs((changed - base) / step - slope).max(axis=(0, 1))
        size = np.maximum(np.abs(slope).max(axis=(0, 1)), 1e-6 * np.abs(base).max(axis=(0, 1)))  # some do not change
        errors.append(float((difference / size).max()))
    assert errors[0] < 0.05
    assert errors[1] < 0.6 * errors[0] or errors[1] < (KINK if fault.physics == "rub" else 1e-6)


def _starts(fault: Insertion) -> dict[str, float]:
    largest = settled_runs(load("jeffcott"), {})
    moving = np.abs(largest[:, 0]) + 2 * np.sqrt((np.abs(largest[:, 1:]) ** 2).sum(axis=1))
    return starts_of(fault, {"displacement": float(moving[:, :2].max()), "velocity": 1.0})[0]


def _both(runs: Runs, diagram: Diagram) -> np.ndarray:
    """Return the harmonics of all runs, with the gains of each."""
    model = [
        periodic(
            diagram,
            speeds=[one["speed"]],
            parameters={k: v for k, v in one.items() if k != "speed"},
            signals=CHANNELS,
            harmonics=24,
            stability=False,
        )
        for one in runs.settings
    ]
    zero = [int(np.flatnonzero(found.orders == 0)[0]) for found in model]
    return np.array(
        [
            np.stack([found.harmonics[name][0, at : at + 15] for name in CHANNELS], axis=1)
            for found, at in zip(model, zero, strict=True)
        ]
    )


def test_harmonic_balance_finds_the_motion_of_linear_equations() -> None:
    """FAULT: slow states had the mean zero there, so that nonlinear faults were credited with the sag of the rotor."""
    diagram = load("jeffcott")
    motion = LinearMotion(diagram, CHANNELS, runs_of(diagram, SPEEDS), diagram.free, {})
    theta = np.array([free.value for free in diagram.free])
    linear, nonlinear = motion.linear(theta), motion.nonlinear(theta)
    assert linear is not None
    assert nonlinear is not None
    for exact, balanced in zip(linear, nonlinear, strict=True):
        np.testing.assert_allclose(balanced, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_a_gain_of_the_sensor_is_a_scale_of_other_parameters() -> None:
    """Undetectable is meant exactly, not only to first order: (1 + e) x obeys the equations of x with scaled forces."""
    diagram, gain = load("jeffcott"), 1.05
    fault = {item.key: item for item in insertions(diagram, CHANNELS)}["sensor_gain/0@rotor.displacement"]
    wrong = load(fault.document(diagram.document, {"gain_error": gain - 1}))
    found = periodic(wrong, speeds=SPEEDS, signals=["sensor_gain.sensed_displacement", "controller.current"])
    scaled = {name: gain * float(diagram.parameters[name]) for name in SCALED}
    other = periodic(diagram, speeds=SPEEDS, parameters=scaled, signals=BOTH)
    for name, same in zip(("sensor_gain.sensed_displacement", "controller.current"), BOTH, strict=True):
        for order in (-3, -1, 1, 2, 3):
            a, b = found.harmonic(name, order), other.harmonic(same, order)
            np.testing.assert_allclose(a, b, rtol=1e-9)


KINK = 2e-3  # what 128 samples of a turn make of a force that sets in at a gap: aliases fall as 1/n^2
SCALED = ("crack_stiffness", "eccentricity", "force_current_factor")


def test_only_linear_diagrams_are_compared_by_laws() -> None:
    found = isolate(load("jeffcott", set={"controller.KP": 12000}, without=["clock"]), ["rotor.displacement"])
    assert found.laws is None
    assert found.why
    data = isolation_data(found)
    assert data["laws"] is None
    assert data["laws_not_judged"] == found.why


@pytest.mark.slow
def test_data_form() -> None:
    data = isolation_data(_isolated())
    assert set(data) == {"diagram", "sensors", "faults", "structure", "laws", "laws_not_judged"}
    assert data["structure"]["redundancy"] == 4
    assert data["structure"]["undetectable"] == []
    assert sum(map(len, data["structure"]["groups"])) == len(data["faults"])
    law = data["laws"]["faults"]["residual_bow/0@rotor.force"]
    assert law["size"] == "amplitude"
    assert law["unit"] == "m"
    assert 0 < law["seen_from_with_gains"] < law["seen_from"]
    why = "no harmonics of the shaft: it shows as a line of its own or as sidebands"
    aperiodic = {key for key, text in data["laws"]["not_judged"].items() if text == why}
    swings = {"speed_fluctuation/0@clock.theta", "torsion_coupling/0@clock.theta"}
    assert aperiodic == {"base_excitation/0@rotor.force", *swings}
