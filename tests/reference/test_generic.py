"""The generator of generic cases: against closed forms, against rotorsim, and apart from it; its sets and scores."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from benchmarks.concealed import sets as runs_of_sets
from benchmarks.concealed.scores import score, tables
from benchmarks.generic import generator, measuring, sets
from benchmarks.generic.__main__ import main
from benchmarks.generic.effects import Effect, effects_of
from benchmarks.generic.laws import LAWS, ORDER
from benchmarks.generic.native import System, simulate
from benchmarks.generic.plants import PLANTS, Plant
from benchmarks.generic.topology import accepted
from benchmarks.generic.writing import write_case

ROOT = Path(__file__).parents[2] / "benchmarks" / "generic"
BELT = PLANTS["belt_drive"]
Solution = Callable[[complex, dict[str, float]], list[complex]]


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """Small matrices: threads only cost."""
    with threadpool_limits(1):
        yield


def system(plant: Plant, factor: float = 1.0, effects: tuple[Effect, ...] = ()) -> System:
    """Return a plant as its diagram is written, free parameters times a factor, inputs linear between samples."""
    values = [plant.written(key) * (factor if key in plant.free else 1.0) for key in plant.parameters]
    sizes = (plant.number, len(plant.channels), len(plant.places))
    acting = tuple(effect.acting for effect in effects)
    return System(*sizes, tuple(values), plant.start, (True,) * len(plant.inputs), acting)


def heated(s: complex, p: dict[str, float]) -> list[complex]:
    C = p["proportional"] + p["integral_gain"] / s
    G, L = p["conductance"], p["loss"]
    heater, chamber = s / p["inverse_heater_capacity"] + G, s / p["inverse_chamber_capacity"] + G + L
    plant = G / (heater * chamber - G * G)  # power to chamber
    power = C / (1 + C * plant)
    return [power, power * plant * chamber / G, power * plant]


def buck(s: complex, p: dict[str, float]) -> list[complex]:
    C, Y = p["proportional"] + p["integral_gain"] / s, s / p["inverse_capacitance"] + p["load"]
    plant = 24.0 / (1 + (s / p["inverse_inductance"] + p["coil_resistance"]) * Y)
    duty = C / (1 + C * plant)
    return [duty, duty * plant * Y, duty * plant]


def cylinder(s: complex, p: dict[str, float]) -> list[complex]:
    A, valve = p["area"], 1 / (1 + p["valve"] * s)
    mass = s / p["inverse_mass"] + p["viscous"]
    pressure = p["flow_gain"] * valve / (s / p["stiffness"] + p["leakage"] + A * A / mass)
    plant = pressure * A / mass / s
    command = p["controller"] / (1 + p["controller"] * plant)
    return [command, command * pressure, command * plant]


def crane(s: complex, p: dict[str, float]) -> list[complex]:
    length = 1 / p["inverse_length"]
    swing = -(s**2) / (length * s**2 + p["swing_damping"] * length * s + p["gravity"])  # angle over distance
    drive = s**2 / p["inverse_mass"] + p["trolley_friction"] * s - p["load_weight"] * swing
    x = p["proportional"] / (drive + p["proportional"] + p["velocity_gain"] * s)
    return [x * drive, x, x * swing]


def belt(s: complex, p: dict[str, float]) -> list[complex]:
    Z = p["belt_stiffness"] / s + p["belt_damping"]
    one = s / p["inverse_carriage_mass"] + p["carriage_friction"] + Z
    two = s / p["inverse_load_mass"] + p["load_friction"] + Z
    return [two / (one * two - Z * Z), Z / (one * two - Z * Z)]


def dc_generator(s: complex, p: dict[str, float]) -> list[complex]:
    C = p["proportional"] + p["integral_gain"] / s
    field = 1 / (s / p["inverse_field_inductance"] + p["field_resistance"])
    armature = 1 / (s / p["inverse_armature_inductance"] + p["armature_resistance"] + p["load"])
    plant = field * p["flux"] * 150.0 * armature * p["load"]
    U = C / (1 + C * plant)
    return [U, U * field, U * plant]


def ball(s: complex, p: dict[str, float]) -> list[complex]:
    slope, roll = 1 / (1 + p["servo"] * s), p["rolling"] / (s * s + p["resistance"] * s)
    lead = p["derivative_gain"] * s / (1 + p["derivative"] * s)
    command = p["proportional"] / (1 + (p["proportional"] + lead) * slope * roll)
    return [command, command * slope, command * slope * roll]


LINEAR: dict[str, tuple[Solution, float]] = {  # and a frequency [Hz] near what matters in it
    "heated_chamber": (heated, 0.005),
    "buck_converter": (buck, 300.0),
    "hydraulic_cylinder": (cylinder, 20.0),
    "crane": (crane, 0.5),
    "belt_drive": (belt, 12.0),
    "generator": (dc_generator, 5.0),
    "ball_and_beam": (ball, 0.4),
}


@pytest.mark.parametrize("name", LINEAR)
def test_settled_sine_is_that_of_the_transfer_function(name: str) -> None:
    plant, (solution, frequency) = PLANTS[name], LINEAR[name]
    per, periods = 400, 40 if name != "buck_converter" else 120
    t = np.arange(per * periods + 1) / per
    first = plant.inputs[0]
    u = np.column_stack([np.full(len(t), item.rest) for item in plant.inputs])
    u[:, 0] = 1e-3 * first.amplitude * np.sin(2 * np.pi * t)  # small: sin(slope) is the slope
    y, _ = simulate(system(plant, 1.1), u, per * frequency, 4)
    assert y is not None
    turn = np.exp(-2j * np.pi * t[-per:])
    found = 2j * (y[-per:] * turn[:, None]).mean(axis=0) / (1e-3 * first.amplitude)
    p = {key.split(".")[0]: value for key, value in zip(plant.parameters, system(plant, 1.1).parameters, strict=True)}
    exact = np.array(solution(2j * np.pi * frequency, p))
    np.testing.assert_allclose(found / exact, 1.0, rtol=0, atol=2e-4)  # straight lines between samples: (pi/400)^2 / 3


def test_tanks_rest_where_what_flows_in_flows_out() -> None:
    plant = PLANTS["two_tanks"]
    for volts in (4.0, 7.0):
        y, _ = simulate(system(plant, 1.1), np.full((3000, 1), volts), 1.0, 4)
        assert y is not None
        np.testing.assert_allclose(y[0], [0.25, 0.3], rtol=1e-12)
        np.testing.assert_allclose(y[-1], [(2e-5 * volts / 2e-4) ** 2, (2e-5 * volts / 1.8e-4) ** 2], rtol=1e-8)


@pytest.mark.parametrize("name", ["belt_drive", *(pytest.param(n, marks=pytest.mark.slow) for n in PLANTS)])
def test_rotorsim_computes_the_same_motion(name: str, tmp_path: Path) -> None:
    import rotorsim

    plant, n, steps = PLANTS[name], 25 if name == "belt_drive" else 120, 16
    case = generator._plain("c", "nothing", plant, np.random.default_rng(3))
    u = case.runs[0][45 : 45 + n]  # beyond the rest
    document = json.loads(plant.file.read_text())
    document["blocks"]["time"] = {"type": "ramp"}
    for k, item in enumerate(plant.inputs):
        block = item.signal.split(".")[0]
        table = {"breakpoints": [j / plant.rate for j in range(n)], "values": u[:, k].tolist()}
        document["blocks"][block] = {"type": "lookup_table", "parameters": table}
        document["wires"].append(["time.output", f"{block}.input"])
    for key, value in zip(plant.parameters, case.parameters, strict=True):
        block, parameter = key.split(".")
        if key in plant.free:
            own = document["blocks"][block]["parameters"]
            own.update({parameter: value} if parameter in own else {parameter[:-3]: [value, 1.0]})  # a denominator
    del document["identify"], document["layout"]
    (tmp_path / "driven.json").write_text(json.dumps(document))
    rate = plant.rate
    result = rotorsim.simulate(
        rotorsim.load(str(tmp_path / "driven.json")),
        step=1 / rate / steps,
        stop=(n - 1) / rate,
        record_every=steps,
        use_compiler=False,
    )
    y, _ = simulate(replace(case.system(case.parameters, ()), linear=(True,) * len(plant.inputs)), u, rate, steps)
    assert y is not None
    for k, (_, signal, _) in enumerate(plant.channels):
        assert np.abs(result[signal] - y[:, k]).max() < 1e-6 * case.floors[k]


@pytest.mark.parametrize("name", PLANTS)
def test_diagrams_have_what_the_plants_say(name: str) -> None:
    plant = PLANTS[name]
    document = plant.document
    ports = {port for wire in document["wires"] for port in wire} | set(document["record"])
    assert {port for _, port in plant.places} <= ports
    assert {signal for _, signal, _ in plant.channels} | {item.signal for item in plant.inputs} == set(
        document["record"]
    )
    assert 3 <= len(plant.free) <= 5
    assert set(plant.free) <= set(plant.parameters)
    for item in plant.inputs:
        block = document["blocks"][item.signal.split(".")[0]]
        assert block["parameters"]["interpolation"] == ("linear" if item.linear else "hold")
    for outside in (False, True):
        for effect in effects_of(plant, outside):
            argument = effect.port(effect.argument) if effect.argument else None
            found = accepted(document, effect.port(effect.place), effect.law.moves, argument)
            assert set(found) <= ports


def test_laws_are_numbered_as_in_c() -> None:
    text = (ROOT / "effects.c").read_text()
    listed = re.search(r"enum law \{(.*?)\}", text, re.DOTALL)
    assert listed is not None
    assert tuple(word.strip().lower() for word in listed[1].split(",")) == ORDER
    assert set(ORDER) == set(LAWS)


def force(key: str, values: tuple[float, ...], u: np.ndarray, argument: str | None = None, rate: float = 500.0) -> Any:
    """Return the force on the carriage of the belt drive and the signals beside it, with a law in its wire."""
    effect = Effect(BELT, LAWS[key], "FORCE", argument, values)
    _, taps = simulate(system(BELT, 1.0, (effect,)), u[:, None], rate, 8, taps=True)
    assert taps is not None
    return taps[:, BELT.place("FORCE")], taps[:, BELT.place(argument or "FORCE")]


U = 50.0 * np.sin(0.11 * np.arange(600.0)) * np.linspace(0.0, 1.0, 600)
STATIC: dict[str, tuple[tuple[float, ...], str | None, Callable[..., Any]]] = {
    "saturation": ((20.0,), None, lambda v, o, t: np.clip(v, -20, 20)),
    "dead_zone": ((7.0,), None, lambda v, o, t: np.sign(v) * np.maximum(np.abs(v) - 7, 0)),
    "friction": ((5.0, 0.01), "SPEED1", lambda v, o, t: v - 5 * np.tanh(o / 0.01)),
    "cubic": ((1e-4,), None, lambda v, o, t: v + 1e-4 * v**3),
    "quadratic": ((1e-3,), None, lambda v, o, t: v + 1e-3 * v**2),
    "asymmetry": ((0.2,), None, lambda v, o, t: np.where(v > 0, 1.2 * v, 0.8 * v)),
    "stop": ((0.1, 30.0), "SPEED1", lambda v, o, t: v - 30 * np.where(o > 0.1, o - 0.1, 0)),
    "leak": ((3.0,), "SPEED1", lambda v, o, t: v - 3 * o),
    "offset": ((4.0,), None, lambda v, o, t: v + 4),
    "drift": ((4.0,), None, lambda v, o, t: v + 4 * t),
    "jump": ((4.0, 0.5), None, lambda v, o, t: v + 4.0 * (t >= 0.5)),
    "line": ((4.0, 30.0, 1.0), None, lambda v, o, t: v + 4 * np.sin(30 * t + 1)),
    "cross_talk": ((4.0,), "SPEED2", lambda v, o, t: v + 4 * o),
    "gain_drift": ((0.3,), None, lambda v, o, t: v * (1 + 0.3 * t)),
    "gain_schedule": ((0.3,), "SPEED1", lambda v, o, t: v * (1 + 0.3 * o)),
    "quantisation": ((6.0,), None, lambda v, o, t: 6 * np.floor(v / 6 + 0.5)),
    "ripple": ((6.0, 0.1, 0.4), "SPEED1", lambda v, o, t: v + 6 * (np.sin(o / 0.1 + 0.4) - np.sin(0.4))),
}


@pytest.mark.parametrize("key", STATIC)
def test_laws_without_memory(key: str) -> None:
    values, argument, law = STATIC[key]
    found, other = force(key, values, U, argument)
    np.testing.assert_allclose(found, law(U, other, np.arange(600) / 500.0), rtol=0, atol=1e-10)


def test_laws_with_memory() -> None:
    expected, several = [], []
    kept, five = U[0], np.full(5, U[0])
    radii = 4.0 * np.arange(1, 6)
    for v in U:  # exact: between samples the force is straight
        kept = min(max(kept, v - 9.0), v + 9.0)
        five = np.clip(five, v - radii, v + radii)
        expected.append(kept)
        several.append(0.3 * v + 0.7 * five.mean())
    np.testing.assert_allclose(force("play", (9.0,), U)[0], expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(force("prandtl", (0.7, 4.0), U)[0], several, rtol=0, atol=1e-10)
    limited = force("rate_limit", (800.0,), U)[0]
    assert np.abs(np.diff(limited)).max() == pytest.approx(800.0 / 500.0, rel=1e-9)
    late = 7.4  # samples
    straight = np.interp(np.arange(600) - late, np.arange(600), U)
    found = force("delay", (late / 500.0,), U)[0]
    np.testing.assert_allclose(found, straight, rtol=0, atol=1e-7)  # sides of a jump: 1e-8 of a sample, times 6 N


@pytest.mark.parametrize(
    ("key", "values", "transfer", "error"),
    [
        ("lag", (0.01,), lambda s: 1 / (1 + 0.01 * s), 1e-4),
        ("mode", (300.0, 0.2), lambda s: 9e4 / (s * s + 120 * s + 9e4), 1e-4),
        ("fractional", (0.004,), lambda s: 1 / (1 + np.sqrt(0.004 * s)), 0.02),  # poles end at 4 times the rate
    ],
)
def test_laws_of_linear_dynamics(key: str, values: tuple[float, ...], transfer: Any, error: float) -> None:
    per, rate = 200, 2000.0
    t = np.arange(60 * per + 1) / per
    found, _ = force(key, values, np.sin(2 * np.pi * t), rate=rate)
    answer = 2j * (found[-per:] * np.exp(-2j * np.pi * t[-per:])).mean()
    assert abs(answer - transfer(2j * np.pi * rate / per)) < error


def test_bouc_wen_is_stiff_at_first_and_then_slides() -> None:
    found, speed = force("bouc_wen", (8.0, 0.002, 1.0), np.where(np.arange(600) < 5, 0.0, 30.0), "SPEED1")
    lost = np.where(np.arange(600) < 5, 0.0, 30.0) - found
    moved = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)]) / 500.0
    np.testing.assert_allclose(lost[20:], 8.0 * (1 - np.exp(-moved[20:] / 0.002)), rtol=0, atol=0.02)


def test_recorder_has_the_errors_that_the_truth_says() -> None:
    rng = np.random.default_rng(2)
    for rate in (1.0, 500.0):
        recorder = measuring.draw(3.0, rate, rng)
        assert 0.003 <= recorder.white / 3.0 <= 0.01
        assert recorder.mains == 0 or rate > measuring.LEAST_RATE
        read = np.concatenate([measuring.read(np.zeros(5000), recorder, rate, rng) for _ in range(8)])
        assert read.std() == pytest.approx(recorder.floor, rel=0.03)
        steps = read / recorder.step
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "plant"),
    [
        ("nothing", "buck_converter"),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (("one", "crane"), ("two", "heated_chamber"), ("outside", "belt_drive"))
        ),
    ],
)
def test_same_seed_writes_the_same_bytes_and_a_whole_truth(tmp_path: Path, kind: str, plant: str) -> None:
    for name in ("a", "b"):
        case = generator.make_case("c", kind, plant, (5, 0), 3)
        truth = write_case(case, tmp_path / name, (5, 0))
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert len(files) >= 7
    for file in files:
        if file.suffix != ".mat":  # which holds the time of writing
            assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file
    assert generator.make_case("c", kind, plant, (6, 0), 3).parameters != case.parameters
    assert len(truth["effects"]) == len(truth["missing"]) == {"nothing": 0, "two": 2}.get(kind, 1)
    for key, value in truth["parameters"].items():
        assert 0.1 <= abs(value / PLANTS[plant].written(key) - 1) <= 0.3
    assert truth["integration_error"] < 1e-3
    assert truth["scores"]["true_model"]["chi"] == pytest.approx(1.0, abs=0.03)
    if kind == "nothing":
        assert truth["detectability"] == pytest.approx(1.0, abs=0.03)
        return
    for effect in truth["effects"]:
        assert effect["location"] in effect["accepted_locations"]
        assert effect["chi_without"] > 1.5
        assert set(truth["class"][effect["physics"]]) == {effect["physics"], *effect["also_called"]}
    low, high = generator.CHI
    assert low * 0.97 < truth["detectability"] < 2 * high
    assert truth["predictable"] is False or truth["scores"]["true_refitted"]["chi"] == pytest.approx(1.0, abs=0.03)
    assert ("outside_catalogue" in truth["effects"][0]["also_called"]) == (kind == "outside")


@pytest.mark.slow
def test_recordings_are_read(tmp_path: Path) -> None:
    from rotorsim.recordings.loading import load_recording

    case = generator.make_case("c", "nothing", "generator", (1, 0), 0)
    write_case(case, tmp_path, (1, 0))
    recording = load_recording(tmp_path / "c")
    assert [run.use for run in recording.runs] == ["identify"] * 3
    assert 1 <= len(load_recording(tmp_path / "hold_out" / "c").runs) <= 2


def test_a_plan_mixes_kinds_and_diagrams_and_does_not_depend_on_its_length() -> None:
    long, short = (sets.plan(Path("x"), n, 1, "mixed", tuple(PLANTS)) for n in (80, 20))
    assert long[:20] == short
    kinds = [job[1] for job in long]
    assert [kinds.count(kind) for kind in generator.KINDS] == [20, 44, 8, 8]
    assert {job[2] for job in long if job[1] == "two"} == set(PLANTS)


def test_places_that_are_one() -> None:
    document = PLANTS["hydraulic_cylinder"].document
    assert set(accepted(document, "valve.input", "static")) == {"valve.input", "controller.output"}
    late = accepted(document, "valve.input", "linear")  # a delay passes the valve, too
    assert {"valve.output", "flow_gain.input", "flow.input1"} <= set(late)
    assert "load_pressure.output" not in late
    pushed = accepted(document, "net_force.output", "added", "velocity.output")
    assert {"net_force.input1", "viscous.output", "inverse_mass.output", "velocity.output"} <= set(pushed)
    assert "load_pressure.output" not in pushed  # recorded by way of its sensor, and leaks


def test_scores_of_known_answers(tmp_path: Path) -> None:
    effect = {"physics": "transport_delay", "also_called": ["delay"], "accepted_locations": ["valve.input"]}
    ends = {"base_refitted": {"chi": 5.0, "held_out_total": 0.1}, "true_refitted": {"held_out_total": 0.01}}
    truth = {
        "case": "a",
        "diagram": "crane",
        "missing": ["transport_delay"],
        "parameters": {},
        "effects": [effect],
        "scores": ends | {"true_model": {"held_out_total": 0.01}},
    }
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "truth.json").write_text(json.dumps(truth))
    [read] = score.read_truths(tmp_path).values()
    answer = {
        "verdict": "missing_physics",
        "missing": [{"physics": "lag", "class": ["lag", "delay", "mode", "gain"]}],
        "where": [
            {"block": "pump", "port": "output", "probability": 0.6, "class": 1},
            {"block": "valve", "port": "input", "probability": 0.6, "class": 1},
            {"block": "valve", "port": "output", "probability": 0.4, "class": 2},
        ],
        "fit": {"before": {"hold_out": 0.1}, "after": {"hold_out": 0.1 / 10**0.5}, "noise_floor": 0.01},
    }
    judged = score.judge(read, answer)
    assert (judged["kind"], judged["right"], judged["named"], judged["located"], judged["credit"]) == (
        *("one", True, {"transport_delay": True}, {"transport_delay": True}),
        {"transport_delay": 0.25},
    )
    assert judged["achieved"] == pytest.approx(0.5)
    second = score.judge(read | {"accepted": {"transport_delay": ["valve.output"]}}, answer)
    assert (second["located"], second["listed"]) == ({"transport_delay": False}, {"transport_delay": True})
    assert "| ... or at any place reported | 1/1" in tables.markdown(tables.summary([second]), "title")
    page = tables.markdown(tables.summary([judged]), "title")
    assert "| names, 1/n in a class of n | mean 0.25 (1) |" in page
    assert "| classes of places reported | mean 2 (1) |" in page
    assert "| places in them | mean 3 (1) |" in page


def test_diagrams_of_sets_are_found(tmp_path: Path) -> None:
    folder = tmp_path / "development"
    for name, file, data in (
        ("a", "truth.json", {"diagram": "crane"}),
        ("b", "recording.json", {"description": "compare with the diagram crane.json"}),
    ):
        (folder / name).mkdir(parents=True)
        (folder / name / "recording.json").write_text("{}")
        (folder / name / file).write_text(json.dumps(data))
    (tmp_path / "diagrams").mkdir()
    (tmp_path / "diagrams" / "crane.json").write_text("{}")
    expected = str(tmp_path / "diagrams" / "crane.json")
    assert runs_of_sets.diagrams_of(folder, None) == {"a": expected, "b": expected}
    (folder / "set.json").write_text(json.dumps({"diagrams": {"a": "diagrams/x.json", "b": "jeffcott"}}))
    assert runs_of_sets.diagrams_of(folder, None) == {"a": str(folder / "diagrams" / "x.json"), "b": "jeffcott"}


def test_misuse_of_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for option, hint in (("--rows", "wobble"), ("--diagrams", "toaster")):
        assert main(["make", str(tmp_path / "set"), option, hint]) == 2
        assert capsys.readouterr().err == f"error: {option}: no {hint}; hint: python -m benchmarks.generic list\n"
    assert main(["list"]) == 0
    assert "| crane | friction | trolley_force.output | trolley_speed.output |" in capsys.readouterr().out
