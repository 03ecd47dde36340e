"""Beams of the generator of concealed cases: against the diagrams they are made for, and another integrator."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from threadpoolctl import threadpool_limits

from benchmarks.concealed import generator, machines, sets
from benchmarks.concealed.check import drawn, scene
from benchmarks.concealed.core import Core
from benchmarks.concealed.detect import detectability
from benchmarks.concealed.healthy import ORDERS, Healthy
from benchmarks.concealed.machines import FREE, MACHINES, nominal, nominal_parameters
from benchmarks.concealed.measuring import Instruments
from benchmarks.concealed.plant import Plant
from benchmarks.concealed.scores import score
from benchmarks.concealed.simulate import Run, Simulation
from benchmarks.concealed.sites import SITES
from benchmarks.concealed.writing import write_case
from rotorsim.recordings.loading import load_recording
from rotorsim.settled.periodic import periodic
from tests.systems.shipped import document, load_document

BEAMS = ("fe_flexible", "two_amb_rotor")


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """Small matrices: threads only cost."""
    with threadpool_limits(1):
        yield


def as_in_diagram(parameters: dict[str, float], plant: Plant, run: Run) -> dict[str, Any]:
    """Return parameters and gains as the diagram has them: the entries of a vector together."""
    named: dict[str, Any] = {}
    for name, value in parameters.items():
        if name.endswith("]"):
            named.setdefault(name[:-3], []).append(value)
        else:
            named[name] = value
    for own, bearing in zip(run.gains, plant.bearings, strict=True):
        named |= {f"{bearing.controller}.{gain}": value for gain, value in zip(("KP", "KI", "KD"), own, strict=True)}
    return named


# beams of 5 mm: the diagram's M^-1 K is rounded to 2e-16 (w_max / W)^2 = 5e-6 of W^2, w_max^2 = 2e15 / s^2
@pytest.mark.slow
@pytest.mark.parametrize(
    ("machine", "parts", "tolerance"),
    [("fe_flexible", 3, 1e-9), ("two_amb_rotor", 1, 1e-8), ("two_amb_rotor", 3, 5e-6)],
)
def test_healthy_machine_is_its_diagram(
    machine: str, parts: int, tolerance: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(MACHINES, machine, partial(MACHINES[machine], parts=parts))
    rng = np.random.default_rng(3)
    parameters, runs = generator.draw_parameters(rng, machine), generator.draw_runs(rng, machine)[1::6]
    assert {run.label for run in runs} == {"A", "B", "C"}
    simulation, plant = Simulation(machine, parameters, runs, generator.RATE), nominal(machine)
    order, found = simulation.harmonics()
    content = document(machine)
    content["blocks"]["rotor"]["parameters"]["subdivisions"] = parts
    diagram = load_document(content)
    outputs = {f"rotor.displacement[{node}]": f"p{node}" for node in plant.probes}
    outputs |= {f"{bearing.controller}.current": f"command{bearing.mark}" for bearing in plant.bearings}
    for lane, run in enumerate(runs):
        settled = periodic(
            diagram,
            speeds=[run.speed],
            parameters=as_in_diagram(parameters, plant, run),
            signals=list(outputs),
            harmonics=11,
        )
        for signal, output in outputs.items():
            expected = settled.harmonics[signal][0]
            mine = found[lane, simulation.recorded.index(output)][[list(order).index(k) for k in settled.orders]]
            np.testing.assert_allclose(mine, expected, rtol=0, atol=tolerance * np.abs(expected).max())


@pytest.mark.parametrize("machine", BEAMS)
def test_free_parameters_are_those_of_the_diagram(machine: str) -> None:
    assert [free.name for free in load_document(document(machine)).free] == list(FREE[machine])


def test_rows_are_placed_by_what_is_at_a_node() -> None:
    assert SITES["two_amb_rotor"] == {
        "probe": (3, 4, 5, 6, 7),
        "bearing": (2, 8),
        "off bearing": (4, 5, 6),
        "disc": (4, 6),
        "off disc": (3, 5, 7),
        "crack": (5,),
        "off crack": (3, 4, 6, 7),
        "machine": (2,),
    }
    for entry in (generator.ROWS | generator.OUTSIDE).values():
        assert all(bool(entry.nodes(machine)) == bool(entry.beam) for machine in ("fe_rigid", *BEAMS))


@pytest.mark.parametrize(
    ("name", "node", "blocks"), [("control_delay", 7, ["controller_b"]), ("amb_cross_coupling", 8, ["amb_b"])]
)
def test_a_row_of_a_bearing_is_that_of_the_bearing_at_its_node(name: str, node: int, blocks: list[str]) -> None:
    fault = drawn(name, "two_amb_rotor", 0.5, nominal_parameters("two_amb_rotor"), {}, 1, 8)
    assert (fault.node, list(fault.blocks)) == (node, blocks)
    assert fault.reads == (("i2",) if name == "amb_cross_coupling" else ())
    plant = nominal("two_amb_rotor")
    if fault.alter:
        fault.alter(plant, 100.0)
        assert [len(bearing.path.poles) for bearing in plant.bearings] == [0, 8]


@pytest.mark.slow
def test_recordings_have_both_controllers(tmp_path: Path) -> None:
    write_case(generator.make_case("c", "nothing", "two_amb_rotor", (1, 0), 0), tmp_path, (1, 0))
    recording = load_recording(tmp_path / "c")
    signals = {channel.signal for channel in recording.channels.values()}
    assert signals == {"rotor.displacement", "controller_a.current", "controller_b.current"}
    gains = recording.runs[-1].settings
    assert set(gains) == {f"controller_{end}.{gain}" for end in "ab" for gain in ("KP", "KI", "KD")}
    assert gains["controller_a.KD"] != gains["controller_b.KD"]


def test_free_parameters_are_scored_by_the_names_of_the_diagram() -> None:
    numbers = {"unbalance_phase2": 3.1, "support_left.stiffness[1]": 4e8, "crack_stiffness": 3e5}
    truth = {"case": "a", "kind": "nothing", "machine": "fe_flexible", "missing": [], "parameters": numbers}
    after = {name: {"value": value} for name, value in numbers.items()} | {"unbalance_phase2": {"value": -3.1}}
    found = {"verdict": "consistent", "parameters": {"after": after}}
    errors = {item["name"]: item["error"] for item in score.judge({**truth, "class": {}, "nodes": {}}, found)["free"]}
    assert errors == pytest.approx({**dict.fromkeys(numbers, 0.0), "unbalance_phase2": 2 * np.pi - 6.2})


def test_beams_are_made_in_turn() -> None:
    jobs = sets.plan(Path("x"), 4, 1, "nothing", "beams", ())
    assert [job[2] for job in jobs] == ["fe_rigid", "fe_flexible", "two_amb_rotor", "fe_rigid"]
    assert [job[4][1:] for job in jobs] == [(1, 0, 0), (2, 0, 0), (3, 0, 0), (1, 0, 1)]


@pytest.mark.parametrize("machine", ["fe_rigid", *BEAMS])
def test_condensed_motion_is_the_settled_motion_at_other_parameters(machine: str) -> None:
    rng = np.random.default_rng(4)
    parameters, runs = generator.draw_parameters(rng, machine), generator.draw_runs(rng, machine)[::5]
    other = {name: value * rng.uniform(0.9, 1.1) for name, value in parameters.items()}
    condensed = Healthy(machine, parameters, runs, np.inf).orders(other)
    simulation = Simulation(machine, other, runs, generator.RATE)
    order, found = simulation.harmonics()
    bearings = simulation.plants[0].bearings
    names = [*(f"p{node}" for node in simulation.plants[0].probes), *(f"command{b.mark}" for b in bearings)]
    rows = [simulation.recorded.index(name) for name in names]
    expected = found[:, rows][..., [list(order).index(k) for k in ORDERS]]
    scale = np.abs(expected).max(axis=-1, keepdims=True)
    assert (np.abs(condensed[..., :-1] - expected) / scale).max() < 1e-7
    assert (np.abs(condensed[..., -1]) / scale[..., 0]).max() < 1e-12  # the mean has come to rest


@pytest.mark.slow
@pytest.mark.parametrize(
    ("machine", "name"), [("fe_flexible", "force_displacement_factor"), ("two_amb_rotor", "force_current_factor_b")]
)
def test_other_values_of_free_parameters_leave_no_trace(machine: str, name: str) -> None:
    rng = np.random.default_rng(6)
    parameters, runs = generator.draw_parameters(rng, machine), generator.draw_runs(rng, machine)[::3]
    healthy, other = (
        Simulation(machine, parameters | {name: factor * parameters[name]}, runs, generator.RATE).run()
        for factor in (1.0, 1.25)
    )
    instruments = Instruments((1e-9, 1e-5), (1e-4, 1.0), 18, 1e-6)
    assert detectability(machine, parameters, runs, np.inf, healthy, other, instruments, 0.0) < 0.1


@pytest.mark.parametrize("machine", BEAMS)
def test_mean_of_a_lifted_rotor_settles_as_its_integrators_do(machine: str) -> None:
    rng = np.random.default_rng(5)
    parameters, runs = generator.draw_parameters(rng, machine), generator.draw_runs(rng, machine)[1:3]
    motion = Simulation(machine, parameters, runs, generator.RATE, lifted=5.0).run()
    t = motion.clock.t[0]
    condensed, still = (
        Healthy(machine, parameters, runs, age).orders(parameters) for age in (5.0 + float(t.mean()), np.inf)
    )
    for lane in range(2):
        basis = np.vstack([np.exp(1j * ORDERS[:, None] * motion.clock.theta[lane]), t - t.mean()])
        for row, value in enumerate(motion.signals.values()):
            seen = np.linalg.lstsq(basis.T, value[lane], rcond=None)[0]
            mean, rest = (each[lane, row, 16] for each in (condensed, still))
            assert abs(seen[16] - mean) < 2e-2 * abs(mean - rest)
            assert abs(seen[-1] - condensed[lane, row, -1]) < 5e-2 * abs(condensed[lane, row, -1])


@pytest.mark.slow
def test_a_rotor_that_falls_out_of_its_bearings_ends_the_simulation() -> None:
    """A floating rotor whose current is cut off at half of what holds it: an unstable pole is left."""
    parameters, runs, _, peaks = scene("two_amb_rotor")
    peaks |= {"i": 0.5 * peaks["i"]}
    fault = drawn("current_clipping", "two_amb_rotor", 0.0, parameters, peaks, 1, 2)
    with pytest.raises(ArithmeticError, match="without bound"):
        Simulation("two_amb_rotor", parameters, runs[3:4], generator.RATE, (fault,)).run()


@pytest.mark.parametrize(
    ("machine", "name", "node"),
    [
        ("fe_flexible", "anisotropic_support", 4),
        ("fe_flexible", "rub", 4),
        ("two_amb_rotor", "amb_cross_coupling", 8),
        ("two_amb_rotor", "rub", 7),
    ],
)
@pytest.mark.slow
def test_faults_agree_with_another_integrator(
    machine: str, name: str, node: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By explicit Runge-Kutta steps, on elements that these can follow: no short ones, one beam each."""
    monkeypatch.setattr(machines, "STEPPED", replace(machines.STEPPED, lengths=(0.0875,) * 8))
    monkeypatch.setitem(MACHINES, machine, partial(MACHINES[machine], parts=1))
    parameters, runs, _, peaks = scene(machine)
    fault = drawn(name, machine, 0.8, parameters, peaks, len(runs), node)
    run = replace(runs[6], samples=250)
    simulation = Simulation(machine, parameters, [run], generator.RATE, (fault,))
    w = simulation.beginning(-simulation.sample)
    motion = simulation.follow(w)
    shown = motion.signals[f"p{node if name == 'rub' else 3}"][0]
    moved = Simulation(machine, parameters, [run], generator.RATE).run().signals[f"p{node if name == 'rub' else 3}"][0]
    assert np.abs(moved - shown).max() > 1e-5 * np.abs(shown).max()  # a thousand times the tolerance below

    plant = simulation.plants[0]
    n, e = plant.size, fault.effect
    inverse = np.linalg.inv(plant.mass)
    D = inverse @ (plant.damping - 1j * run.speed * plant.gyroscopic)
    K, none = inverse @ plant.stiffness, np.zeros_like(inverse)
    D_conj, K_conj = (inverse @ (none if m is None else m) for m in (plant.damping_conj, plant.stiffness_conj))
    dof, p = plant.displacement[node], parameters

    def law(q: np.ndarray, v: np.ndarray, currents: list[complex]) -> complex:
        if name == "anisotropic_support":
            return -e["dk"] * np.conj(q[dof]) - e["dc"] * np.conj(v[dof])
        if name == "amb_cross_coupling":
            return -p["force_current_factor_b"] * e["eps"] * np.conj(currents[1])
        radius = abs(q[dof])
        slide = run.speed * 8e-3 + (np.conj(q[dof]) * v[dof]).imag / radius
        return -(1 + 1j * e["mu"] * np.sign(slide)) * e["k"] * max(radius - e["gap"], 0.0) * q[dof] / radius

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        q, v = y[:n], y[n : 2 * n]
        theta = run.start + run.speed * t
        F, currents, seen = np.zeros(n, complex), [], []
        a = theta + p["crack_phase"]
        s = 0.5 + 2 / np.pi * sum((-1) ** j * np.cos((2 * j + 1) * a) / (2 * j + 1) for j in range(5))
        size = 0.5 * s * p["crack_stiffness"] * plant.crack.sag
        F[plant.displacement[plant.crack.node]] = size * (1 + np.exp(2j * a))
        for k, unbalance in enumerate(plant.unbalances, 1):
            size = unbalance.mass * p[f"eccentricity{k}"] * run.speed**2
            F[plant.displacement[unbalance.node]] += size * np.exp(1j * (theta + p[f"unbalance_phase{k}"]))
        for k, bearing in enumerate(plant.bearings):
            KP, KI, KD = run.gains[k]
            there = plant.displacement[bearing.probe]
            seen.append(q[there])
            currents.append(KP * q[there] + KI * y[2 * n + k] + KD * v[there])
            at = plant.displacement[bearing.node]
            F[at] += bearing.ks * q[at] - bearing.ki * currents[-1]
        F[dof] += law(q, v, currents)
        pull = inverse @ F - K @ q - D @ v - K_conj @ q.conj() - D_conj @ v.conj()
        return np.concatenate([v, pull, seen])

    core = Core(plant, run.speed)
    start = (core.eigen()[1] @ w[0])[: core.one]
    time = np.arange(run.samples) / generator.RATE
    rule = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-16}
    found = solve_ivp(rates, (-1 / generator.RATE, time[-1]), start, t_eval=time, **rule)
    shown_at = plant.displacement[node if name == "rub" else 3]
    np.testing.assert_allclose(shown, found.y[shown_at], rtol=0, atol=1e-8 * np.abs(shown).max())
