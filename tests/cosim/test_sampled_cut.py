"""Cuts at sampled controllers: their outputs are held by themselves, and their hits are communication points."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.cosim.cosimulation import cosimulate, cosimulate_diagram, couple, open_coupling
from rotorsim.cosim.coupling import Coupling
from rotorsim.cosim.stability import coupling_stability, why_not_linear
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.edit import swap
from rotorsim.fmi.export.export import export_fmu
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from rotorsim.ssp.from_diagram import export_ssp
from rotorsim.ssp.to_diagram import import_ssp

INNER, STOP = 2e-5, 0.03
SLOW_3 = pytest.param("3.0", marks=pytest.mark.slow)


def sampled(period: float, *, inner: float = INNER, stop: float = STOP, **changes: Any) -> Diagram:
    document = swap(load("jeffcott").document, "controller", "discrete_pid")
    document["blocks"]["controller"]["parameters"]["sample_time"] = period
    document["solver"] = {"step": inner, "stop": stop}
    return load(document, set=changes)


def held(coupling: Coupling) -> set[str]:
    names = [name for participant in coupling.participants for name in participant.outputs]
    return {name for name, constant in zip(names, coupling.is_held, strict=True) if constant}


def off(found: Any, diagram: Diagram) -> float:
    whole = simulate(diagram)
    right = whole["rotor.displacement"][:: round(found.time[1] / whole.time[1])][: len(found.time)]
    return float(np.abs(found["rotor.displacement"] - right).max() / np.abs(right).max())


def with_fmu(folder: Path, diagram: Diagram, version: str, interface: str) -> Diagram:
    export_fmu(diagram, folder / "controller.fmu", blocks=["controller"], version=version)
    document = json.loads(json.dumps(diagram.document))
    document.pop("identify", None)
    options = {"interface": interface, "in_process": True}
    document["blocks"]["controller"] = {"type": "fmu", "file": "controller.fmu", "parameters": options}
    return load(document, folder=folder, trust_blocks=True)


# ---- what is held ----


def test_outputs_that_follow_sampled_memory_only_are_held() -> None:
    diagram = sampled(1e-4)
    currents = {"controller.current[1]", "controller.current[2]"}
    assert held(couple(diagram, [["controller"]])) == currents
    assert held(couple(load("jeffcott"), [["controller"]])) == set()
    forces = {"amb.force[1]", "amb.force[2]"}
    assert not forces & held(couple(diagram, [["controller", "amb"]]))  # the bearing follows the displacement too


def chain(*kinds: tuple[str, str, dict[str, Any]]) -> Diagram:
    """Return a sine, blocks one after the other, and an integrator at the end."""
    names = ["source", *(name for name, _, _ in kinds), "end"]
    blocks: dict[str, Any] = {"source": {"type": "sine", "parameters": {"frequency": 5.0}}}
    blocks |= {name: {"type": kind, "parameters": values} for name, kind, values in kinds}
    return load(
        {
            "name": "chain",
            "blocks": {**blocks, "end": {"type": "integrator"}},
            "wires": [[f"{a}.output", f"{b}.input"] for a, b in pairwise(names)],
            "solver": {"step": 1e-3, "stop": 1.0},
            "record": ["end.output"],
        }
    )


@pytest.mark.slow
def test_what_follows_held_signals_is_held_across_cuts() -> None:
    """Behind a sampler a gain is piecewise constant, also in another participant; behind a sine it is not."""
    diagram = chain(("hold", "sample_hold", {"sample_time": 0.1}), ("gain", "gain", {"gain": 2.0}))
    assert held(couple(diagram, [["hold"], ["gain"]])) == {"hold.output", "gain.output"}
    assert held(couple(diagram, [["hold", "gain"]])) == {"gain.output"}
    other = chain(("gain", "gain", {"gain": 2.0}), ("hold", "sample_hold", {"sample_time": 0.1}))
    assert held(couple(other, [["hold"], ["gain"]])) == {"hold.output"}


def test_a_relay_is_held_and_still_follows_at_once() -> None:
    diagram = chain(("relay", "sign", {}))
    coupling = couple(diagram, [["relay"]])
    assert held(coupling) == {"relay.output"}
    relay = next(p for p in coupling.participants if p.name == "relay")
    assert relay.feedthrough.tolist() == [[True]]
    found = cosimulate(coupling, diagram, step=2e-3, order=1)
    assert np.abs(found["relay.output"]).max() == 1.0
    turns = np.abs(np.mod(5.0 * found.time, np.pi))
    assert found["end.output"].max() == pytest.approx(np.pi / 5, abs=2e-3)
    assert turns.size == found["end.output"].size


@pytest.mark.parametrize("version", ["2.0", SLOW_3])
def test_outputs_of_variability_discrete_are_held(tmp_path: Path, version: str) -> None:
    coupling = open_coupling(with_fmu(tmp_path, sampled(1e-4), version, "cs"))
    try:
        assert held(coupling) == {"controller.current[1]", "controller.current[2]"}
    finally:
        coupling.close()


# ---- runs ----


@pytest.mark.parametrize(
    ("master", "order"),
    [("gauss_seidel", 1)]
    + [
        pytest.param(*each, marks=pytest.mark.slow)
        for each in (("gauss_seidel", 0), ("gauss_seidel", 2), ("iterative", 1), ("iterative", 3))
    ],
)
@pytest.mark.parametrize(
    ("period", "step"),
    [
        (1e-4, 2e-4),
        (1e-3, 1e-4),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((1e-4, 1e-4), (1e-3, 4e-4))),
    ],
)
def test_the_run_is_that_of_the_whole_diagram(master: str, order: int, period: float, step: float) -> None:
    """Whatever the step and the order: what is sampled is known at the hit, and held signals are constant between."""
    diagram = sampled(period)
    found = cosimulate_diagram(diagram, [["controller"]], step=step, master=master, order=order)
    assert off(found, diagram) < 1e-12


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("interface", ["cs", "me"])
@pytest.mark.parametrize("period", [pytest.param(1e-4, marks=pytest.mark.slow), 1e-3])
def test_the_same_for_an_fmu(tmp_path: Path, version: str, interface: str, period: float) -> None:
    diagram = sampled(period)
    found = cosimulate_diagram(with_fmu(tmp_path, diagram, version, interface), step=1e-4, order=1)
    assert off(found, diagram) < 1e-12


@pytest.mark.parametrize("interface", ["cs", "me"])
def test_an_fmu_at_its_own_rate(tmp_path: Path, interface: str) -> None:
    diagram = sampled(1e-4)
    cut = with_fmu(tmp_path, diagram, "2.0", interface)
    found = cosimulate_diagram(cut, step=INNER, order=1, rates={"controller": 5})
    assert off(found, diagram) < 1e-12


@pytest.mark.parametrize("period", [1.3e-4, pytest.param(1.7e-4, marks=pytest.mark.slow)])
def test_hits_between_the_points_asked_for(tmp_path: Path, period: float) -> None:
    """RK4 steps end at the hits in both runs, at other places between: they differ by h^4 omega^5 t / 120."""
    diagram = sampled(period)
    allowed = INNER**4 * 770.0**5 * STOP / 120
    for given, parts in ((diagram, [["controller"]]), (with_fmu(tmp_path, diagram, "2.0", "me"), [])):
        found = cosimulate_diagram(given, parts, step=1e-4, order=1)
        assert len(found.time) == 301
        assert off(found, diagram) < allowed


@pytest.mark.parametrize(
    ("period", "step"),
    [(1e-4, 2e-4), (1.3e-4, 1e-4)]
    + [pytest.param(*each, marks=pytest.mark.slow) for each in ((1e-4, 4e-5), (1e-4, 1e-4), (1e-3, 1e-4))],
)
def test_extrapolation_is_never_worse_than_holding(period: float, step: float) -> None:
    """Jacobi: the displacement that is sampled is extrapolated, the current never."""
    diagram = sampled(period)
    errors = [
        off(cosimulate_diagram(diagram, [["controller"]], step=step, master="jacobi", order=order), diagram)
        for order in (0, 1, 2)
    ]
    assert errors[0] > 4 * errors[1] > 16 * errors[2]


@pytest.mark.slow
def test_sampled_and_continuous_blocks_in_one_part() -> None:
    """Continuous blocks see inputs of the middle of an internal step, sampled ones those of the hit: order 2."""
    errors = []
    for inner in (4e-5, 2e-5):
        diagram = sampled(2e-4, inner=inner, stop=0.02)
        found = cosimulate_diagram(diagram, [["rotor", "controller", "amb"]], step=2e-4, master="iterative")
        errors.append(off(found, diagram))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("how", [{"adaptive": 1e-4, "order": 1}, {"master": "waveform"}])
def test_other_ways_to_run_it(how: dict[str, Any]) -> None:
    """Adaptive steps end at hits; waveforms are splines, but for what is held."""
    diagram = sampled(1e-3, stop=0.01)
    found = cosimulate_diagram(diagram, [["controller"]], step=1e-3 if "adaptive" in how else 1e-4, **how)
    whole = simulate(diagram)
    right = np.column_stack([np.interp(found.time, whole.time, axis) for axis in whole["rotor.displacement"].T])
    assert np.abs(found["rotor.displacement"] - right).max() < 1e-5 * np.abs(right).max()


def test_the_first_hit_sees_the_signals_of_the_start() -> None:
    """A hit at t = 0 samples what the others then give, not zero."""
    diagram = chain(("hold", "sample_hold", {"sample_time": 0.3}), ("gain", "gain", {"gain": 2.0}))
    shifted = load(
        {
            **diagram.document,
            "blocks": {
                **diagram.document["blocks"],
                "source": {"type": "sine", "parameters": {"frequency": 5.0, "phase": 1.0}},
            },
        }
    )
    found = cosimulate_diagram(shifted, [["hold"]], step=0.1)
    assert found["hold.output"][:4] == pytest.approx(np.sin([1.0, 1.0, 1.0, 2.5]), rel=1e-12)
    whole = simulate(shifted)["end.output"][
        :: round(0.1 / shifted.solver.step)
    ]  # what is held gets to the part behind it
    assert found["end.output"] == pytest.approx(whole, rel=1e-9)


@pytest.mark.parametrize("interface", ["cs", "me"])
def test_a_held_and_a_moving_signal_on_one_input(tmp_path: Path, interface: str) -> None:
    """x' = t + the staircase of t: linear extrapolation is exact for the one, holding for the other."""
    blocks: dict[str, Any] = {
        "source": {"type": "ramp", "parameters": {"slope": 1.0}},
        "hold": {"type": "sample_hold", "parameters": {"sample_time": 0.1}},
        "both": {"type": "sum", "parameters": {"signs": "+"}},
        "end": {"type": "integrator"},
    }
    wires = [["source.output", "hold.input"], ["source.output", "both.input1"], ["both.output", "end.input"]]
    document = {"name": "a", "blocks": blocks, "wires": wires, "solver": {"step": 0.01, "stop": 1.0}, "record": []}
    export_fmu(load(document), tmp_path / "end.fmu", blocks=["end"])
    options = {"interface": interface, "in_process": True}
    cut = load(
        {
            **document,
            "blocks": {**blocks, "end": {"type": "fmu", "file": "end.fmu", "parameters": options}},
            "wires": [*wires, ["hold.output", "end.input"]],
        },
        folder=tmp_path,
        trust_blocks=True,
    )
    found = cosimulate_diagram(cut, [["hold"]], step=0.04, order=1)
    t, n = found.time, np.floor(found.time / 0.1 + 1e-9)
    assert found["end.output"] == pytest.approx(t**2 / 2 + 0.1 * n * t - 0.01 * n * (n + 1) / 2, abs=1e-12)


# ---- stability ----


STRUCK = {"unbalance.eccentricity": 0.0, "crack.stiffness": 0.0, "rotor.initial_velocity": [0.01, 0.0]}


def decay(x: np.ndarray, period: float) -> complex:
    """Return the eigenvalue [1/s] of the swing in x, of which there is one, and the slow mode of the integral."""
    fitted = np.linalg.lstsq(np.column_stack([x[2:-1], x[1:-2], x[:-3]]), x[3:])[0]
    roots = np.roots([1.0, *-fitted])
    return complex(np.log(roots[np.argmax(roots.imag)]) / period)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("master", "order", "step"),
    [("gauss_seidel", 1, 2e-4), ("jacobi", 0, 2e-4), ("jacobi", 0, 1e-4), ("jacobi", 1, 2e-4)],
)
def test_the_damping_told_is_that_of_a_run(master: str, order: int, step: float) -> None:
    """The sampled loop as a whole, and with the master in it, against free swings of both (a linear rotor)."""
    period = 2e-4
    diagram = sampled(period, stop=0.1, **STRUCK)
    coupling = couple(diagram, [["controller"]])
    told = coupling_stability(coupling, step, master=master, order=order)
    assert told is not None
    every = round(period / INNER)
    whole = decay(simulate(diagram)["rotor.displacement"][::every, 0][50:300], period)
    found = cosimulate(coupling, diagram, step=step, master=master, order=order)
    coupled = decay(found["rotor.displacement"][:: round(period / step), 0][50:300], period)
    assert told.whole.real == pytest.approx(whole.real, rel=2e-3)
    assert told.coupled.real == pytest.approx(coupled.real, rel=2e-3)
    assert told.kept == pytest.approx((coupled.real / abs(coupled)) / (whole.real / abs(whole)), rel=2e-3)
    if master == "gauss_seidel":
        assert told.kept == pytest.approx(1, abs=1e-9)


def test_a_sample_time_that_is_too_long_is_not_put_on_the_coupling() -> None:
    """At 1 ms the sampled loop itself is unstable: no step helps, and none is refused for it."""
    coupling = couple(sampled(1e-3), [["controller"]])
    told = coupling_stability(coupling, 1e-4, master="gauss_seidel", order=1)
    assert told is not None
    assert (told.stable, told.largest_step) == (False, 0.0)


def test_it_is_said_where_the_stability_is_not_told(tmp_path: Path) -> None:
    found = cosimulate_diagram(with_fmu(tmp_path, sampled(1e-4), "2.0", "cs"), step=1e-4, check=True)
    why = found.provenance["stability_not_analysed"]
    assert why == (
        "controller has values that change at events (controller.integral[1]), "
        "which directional derivatives do not show"
    )
    coupling = couple(sampled(1e-4 * 2**0.5), [["controller"]])
    assert coupling_stability(coupling, 1e-4, master="gauss_seidel", order=1) is None
    assert why_not_linear(coupling, 1e-4) == (
        "steps and sample times (0.0001 s, 0.000141421 s) have no common period of 240 steps or fewer"
    )


@pytest.mark.parametrize("version", ["2.0", SLOW_3])
@pytest.mark.slow
def test_constants_of_an_fmu_do_not_stand_in_the_way(tmp_path: Path, version: str) -> None:
    """A force beside the controller is of variability discrete, and depends on a parameter at most."""
    made = dict(load("jeffcott").document)
    made["blocks"] = {**made["blocks"], "load": {"type": "constant", "parameters": {"value": [1.0, 0.0]}}}
    made["wires"] = [*made["wires"], ["load.output", "rotor.force"]]
    diagram, part = load(made), ["controller", "load"]
    export_ssp(diagram, tmp_path / "j.ssp", {"part": part}, version=version)
    cut = import_ssp(tmp_path / "j.ssp", tmp_path / "j", trust_blocks=True).diagram
    found = cosimulate_diagram(cut, step=1e-4, stop=1e-3, check=True).provenance
    told = coupling_stability(couple(diagram, [part]), 1e-4, master="gauss_seidel")
    assert told is not None
    assert found["damping_kept"] == pytest.approx(told.kept, rel=1e-9)
    assert found["largest_stable_step"] == pytest.approx(told.largest_step, rel=1e-5)
