"""The generator of concealed cases: against closed forms and another integrator, and apart from rotorsim."""

from __future__ import annotations

import ast
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh, eigvals
from threadpoolctl import threadpool_limits

from benchmarks.concealed import generator, sets
from benchmarks.concealed.__main__ import main
from benchmarks.concealed.check import difference, drawn, scene
from benchmarks.concealed.core import Core
from benchmarks.concealed.detect import detectability
from benchmarks.concealed.machine_fe import bare_frequencies
from benchmarks.concealed.machines import fe_rigid
from benchmarks.concealed.measuring import Instruments
from benchmarks.concealed.rows.loop import late
from benchmarks.concealed.scores import score, tables
from benchmarks.concealed.simulate import Accuracy, Run, Simulation
from benchmarks.concealed.writing import write_case


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """Small matrices: threads only cost."""
    with threadpool_limits(1):
        yield


ROOT = Path(__file__).parents[2] / "benchmarks" / "concealed"
PARAMETERS = {"c": 76.0, "e": 24e-6, "dk": 3e5, "ks": 105210.0, "ki": 42.1, "beta": 0.5, "crack_phase": -0.4}
GAINS = (12200.0, 2000.0, 3.0)
RUNS = [Run(2 * math.pi * f, 0.7, (GAINS,), "A", 2000, "identify") for f in (2.03, 24.7, 71.2, 99.1)]
SAG = 26e-6
INSTRUMENTS = Instruments((2.5e-8, 4e-4), (1e-4, 1.0), 16, 1e-6)


def settled(run: Run, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and current of thesis eq. (2.26), harmonic by harmonic; the integral action leaves no mean."""
    p, (KP, KI, KD) = PARAMETERS, run.gains[0]
    series = {0: 0.5} | {k: sign / (math.pi * k) for k, sign in ((1, 1), (3, -1), (5, 1), (7, -1), (9, 1))}
    opening: dict[int, float] = series | {-k: s for k, s in series.items() if k}  # s = sum of these e^{ika}
    force: dict[int, complex] = {}
    for k, s in opening.items():
        for order in (k, k + 2):
            force[order] = force.get(order, 0) + 0.5 * p["dk"] * SAG * s * np.exp(1j * order * p["crack_phase"])
    force[1] += 2.0 * p["e"] * run.speed**2 * np.exp(1j * p["beta"])
    z, i = np.zeros(len(time), complex), np.zeros(len(time), complex)
    for k, F in force.items():
        turn = np.exp(1j * k * (run.start + run.speed * time))
        if k == 0:
            i += F / p["ki"] * turn
            continue
        rate = 1j * k * run.speed
        C = KP + KI / rate + KD * rate
        Z = F / (2.0 * rate**2 + p["c"] * rate + 7.6e5 - p["ks"] + p["ki"] * C)
        z += Z * turn
        i += C * Z * turn
    return z, i


def test_plain_machine_agrees_with_its_harmonics() -> None:
    motion = Simulation("jeffcott", PARAMETERS, RUNS, 5000.0).run()
    time = np.arange(2000) / 5000.0
    for lane, run in enumerate(RUNS):
        for name, exact in zip(("p1", "current"), settled(run, time), strict=True):
            np.testing.assert_allclose(motion.signals[name][lane], exact, rtol=0, atol=1e-8 * np.abs(exact).max())


def test_mean_rises_with_the_slow_pole_after_lifting() -> None:
    motion = Simulation("jeffcott", PARAMETERS, RUNS, 5000.0, lifted=5.0).run()
    stiff = 7.6e5 - PARAMETERS["ks"] + PARAMETERS["ki"] * GAINS[0]
    rate = PARAMETERS["ki"] * GAINS[1] / stiff  # 1 / 13.9 s
    time = np.arange(2000) / 5000.0
    mean = (motion.signals["p1"][2] - settled(RUNS[2], time)[0]).mean()
    expected = 0.25 * PARAMETERS["dk"] * SAG / stiff * math.exp(-rate * (5.0 + time.mean()))
    assert abs(mean - expected) < 2e-4 * expected


@pytest.mark.parametrize(
    "name", ["dahl", *(pytest.param(name, marks=pytest.mark.slow) for name in ("rub", "magnetic_nonlinearity"))]
)
def test_feedback_agrees_with_another_integrator(name: str) -> None:
    parameters, runs, _, peaks = scene("jeffcott")
    fault = drawn(name, "jeffcott", 0.8, parameters, peaks, len(runs))
    run, lane = replace(runs[7], samples=750), 0
    simulation = Simulation("jeffcott", parameters, [run], 5000.0, (fault,))
    w = simulation.beginning(-simulation.sample)
    motion = simulation.follow(w)
    moved = Simulation("jeffcott", parameters, [run], 5000.0).run().signals["p1"] - motion.signals["p1"]
    assert np.abs(moved).max() > 1e-5 * np.abs(motion.signals["p1"]).max()  # a thousand times the tolerance below
    start = dict(zip(simulation.recorded, simulation.C[lane] @ w[lane], strict=True))
    KP, KI, KD = run.gains[0]
    e = fault.effect
    hidden = {"dahl": "aux0"}.get(name)
    z0, v0 = start["p1"], start.get("v1")
    if v0 is None:
        v0 = _velocity(simulation, w, lane)
    state = [z0, v0, (start["command"] - KP * z0 - KD * v0) / KI, start[hidden] if hidden else 0]

    def law(t: float, z: complex, v: complex, i: complex, w: complex) -> tuple[complex, complex]:
        if name == "rub":
            over = max(abs(z) - e["gap"], 0.0)
            return -(1 + 1j * e["mu"]) * e["k"] * over * z / abs(z), 0
        if name == "dahl":
            return -e["a"] * w, v - abs(v) * w / e["b"]
        i0, g0 = e["i0"], e["g0"]
        K = parameters["ki"] * g0**2 / 4 / i0

        def axis(x: float, j: float) -> float:
            force = K * (((i0 - j) / (g0 - x)) ** 2 - ((i0 + j) / (g0 + x)) ** 2)
            return force - parameters["ks"] * x + parameters["ki"] * j

        return axis(z.real, i.real) + 1j * axis(z.imag, i.imag), 0

    def rates(t: float, y: np.ndarray) -> list[complex]:
        z, v, q, hidden_state = y
        i = KP * z + KI * q + KD * v
        theta = run.start + run.speed * t
        a = theta + parameters["crack_phase"]
        s = 0.5 + 2 / math.pi * sum((-1) ** j * math.cos((2 * j + 1) * a) / (2 * j + 1) for j in range(5))
        F = 0.5 * s * parameters["dk"] * SAG * (1 + np.exp(2j * a))
        F += 2.0 * parameters["e"] * run.speed**2 * np.exp(1j * (theta + parameters["beta"]))
        extra, rate = law(t, z, v, i, hidden_state)
        F += extra + parameters["ks"] * z - parameters["ki"] * i
        return [v, (F - parameters["c"] * v - 7.6e5 * z) / 2.0, z, rate]

    time = np.arange(750) / 5000.0
    found = solve_ivp(
        rates,
        (-1 / 5000, time[-1]),
        np.array(state),
        t_eval=time,
        method="DOP853",
        rtol=1e-12,
        atol=1e-17,
        max_step=2e-4,
    )
    scale = np.abs(motion.signals["p1"][lane]).max()
    np.testing.assert_allclose(motion.signals["p1"][lane], found.y[0], rtol=0, atol=1e-8 * scale)


def _velocity(simulation: Simulation, w: np.ndarray, lane: int) -> complex:
    _, right, _ = Core(simulation.plants[lane], simulation.runs[lane].speed).eigen()
    return complex((right @ w[lane])[1])


@pytest.mark.slow
def test_step_does_not_matter() -> None:
    parameters, runs, _, peaks = scene("fe_rigid")
    runs = runs[::4]
    fault = drawn("anisotropic_support", "fe_rigid", 0.8, parameters, peaks, len(runs))
    one = Simulation("fe_rigid", parameters, runs, 5000.0, (fault,))
    w, _ = one.settle()
    other = Simulation("fe_rigid", parameters, runs, 5000.0, (fault,), accuracy=Accuracy(16, 2))
    assert difference(other.follow(w), one.follow(w)) < 1e-9


def test_beam_converges_with_the_fourth_power_of_the_element() -> None:
    for mode in range(3):
        exact = ((mode + 1) * math.pi / 0.5) ** 2 * math.sqrt(2.1e11 * 0.016**2 / 16 / 7850)
        errors = [bare_frequencies(n, 0.5, 0.016, 2.1e11, 7850.0)[mode] / exact - 1 for n in (10, 20)]
        assert math.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)


def test_rotor_on_the_mesh_of_the_diagram_has_the_known_frequencies() -> None:
    plant = fe_rigid(PARAMETERS, (GAINS,), parts=1)
    rest = np.sqrt(eigh(plant.stiffness.real, plant.mass.real, eigvals_only=True)[:3]) / 2 / math.pi
    np.testing.assert_allclose(rest, [54.3005, 338.398, 678.808], rtol=2e-6)
    n, speed = plant.size, 100 * math.pi
    inverse = np.linalg.inv(plant.mass)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ plant.stiffness, 1j * speed * inverse @ plant.gyroscopic]])
    whirl = np.sort(eigvals(A).imag / 2 / math.pi)
    forward, backward = whirl[whirl > 0], -whirl[whirl < 0][::-1]
    np.testing.assert_allclose([backward[0], forward[0]], [54.1532, 54.4399], rtol=2e-6)
    np.testing.assert_allclose([backward[1], forward[1]], [312.997, 364.277], rtol=3e-6)


def test_delay_is_a_delay() -> None:
    path, s = late(3e-4), 2j * np.pi * np.linspace(0, 1500, 61)
    H = path.direct + sum(r / (s - pole) for r, pole in zip(path.residues, path.poles, strict=True))
    np.testing.assert_allclose(H, np.exp(-s * 3e-4), rtol=0, atol=1e-10)


@pytest.mark.slow
def test_aliases_leave_no_trace_and_faults_do() -> None:
    parameters, runs, healthy, peaks = scene("jeffcott")
    changed = {"ks": 0.9, "ki": 1.1, "dk": 1.1, "e": 0.95, "c": 1.2}
    other = Simulation("jeffcott", parameters | {k: f * parameters[k] for k, f in changed.items()}, runs, 5000.0).run()
    assert detectability("jeffcott", parameters, runs, np.inf, healthy, other, INSTRUMENTS, 0.0) < 1e-3
    found = []
    for strength in (0.5, 0.6):
        fault = drawn("residual_bow", "jeffcott", strength, parameters, peaks, len(runs))
        motion = Simulation("jeffcott", parameters, runs, 5000.0, (fault,)).run()
        D = detectability("jeffcott", parameters, runs, np.inf, healthy, motion, INSTRUMENTS, 0.0)
        found.append(D / fault.effect["bow"])
    assert found[0] == pytest.approx(found[1], rel=0.02)  # a force: linear, but for the free parameters
    assert found[0] * 1e-6 > 1000


@pytest.mark.parametrize(
    ("kind", "machine"), [pytest.param("nothing", "fe_rigid", marks=pytest.mark.slow), ("one", "jeffcott")]
)
@pytest.mark.slow
def test_same_seed_writes_the_same_bytes(tmp_path: Path, kind: str, machine: str) -> None:
    for name in ("a", "b"):
        case = generator.make_case("c", kind, machine, (5, 0), 3)
        write_case(case, tmp_path / name, (5, 0))
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert len(files) > 14
    for file in files:
        if file.suffix != ".mat":  # which holds the time of writing
            assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file
    other = generator.make_case("c", kind, machine, (6, 0), 3)
    assert other.parameters != case.parameters


def test_recordings_are_read_and_fit_the_diagram(tmp_path: Path) -> None:
    from rotorsim.recordings.loading import load_recording

    write_case(generator.make_case("c", "nothing", "jeffcott", (1, 0), 0), tmp_path, (1, 0))
    truth = json.loads((tmp_path / "truth" / "c.json").read_text())
    assert (truth["missing"], truth["kind"], truth["effect"]) == ([], "nothing", {})
    recording = load_recording(tmp_path / "c")
    assert len(recording.runs) == 10
    assert len(load_recording(tmp_path / "hold_out" / "c").runs) == 5


@pytest.mark.parametrize("name", ["concealed", "generic"])
def test_nothing_of_rotorsim_is_imported(name: str) -> None:
    files = sorted((ROOT.parent / name).rglob("*.py"))
    assert len(files) > 10
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                assert name.split(".")[0] not in ("rotorsim", "blocks", "tests", "casadi"), f"{file.name}: {name}"
                assert name != "importlib", file.name
            assert not (isinstance(node, ast.ImportFrom) and node.level), f"{file.name}: relative import"


def test_a_plan_mixes_kinds_and_does_not_depend_on_its_length() -> None:
    long, short = (sets.plan(Path("x"), n, 1, "mixed", "both", ()) for n in (60, 20))
    assert long[:20] == short
    kinds = [job[1] for job in long]
    counts = {kind: kinds.count(kind) for kind in generator.KINDS}
    for kind, share in zip(generator.KINDS, generator.MIX, strict=True):
        assert abs(counts[kind] - 60 * share) <= 2, kind


TRUTHS: list[dict[str, Any]] = [
    {
        "case": "a",
        "kind": "nothing",
        "machine": "jeffcott",
        "missing": [],
        "effect": {},
        "class": {},
        "nodes": {},
        "blocks": {},
        "parameters": {"ki": 42.0, "beta": 3.1},
        "detectability": 0.0,
        "noise_floor": 0.01,
    },
    {
        "case": "b",
        "kind": "one",
        "machine": "jeffcott",
        "missing": ["rub"],
        "effect": {"gap": 1e-5, "k": 1e5, "mu": 0.1},
        "class": {"rub": ["rub"]},
        "nodes": {},
        "blocks": {"rub": ["rotor"]},
        "parameters": {},
        "detectability": 500.0,
    },
    {
        "case": "c",
        "kind": "one",
        "machine": "fe_rigid",
        "missing": ["residual_bow"],
        "effect": {"bow": 1e-6, "bow_phase": 1.0},
        "class": {"residual_bow": ["residual_bow"]},
        "nodes": {"residual_bow": 4},
        "blocks": {"residual_bow": ["rotor"]},
        "parameters": {},
        "detectability": 50.0,
    },
    {
        "case": "d",
        "kind": "outside",
        "machine": "jeffcott",
        "missing": ["outside_catalogue"],
        "law": "dahl",
        "effect": {},
        "class": {},
        "nodes": {},
        "blocks": {},
        "parameters": {},
        "detectability": 5000.0,
    },
    {
        "case": "e",
        "kind": "alias",
        "machine": "jeffcott",
        "missing": ["mass_error"],
        "effect": {"dm": 0.1},
        "class": {"mass_error": ["mass_error", "sensor_gain"]},
        "nodes": {},
        "blocks": {},
        "parameters": {},
        "detectability": 0.1,
    },
]


def _diagnosis(verdict: str, missing: list[dict[str, Any]] | None = None, **more: Any) -> dict[str, Any]:
    return {"verdict": verdict, "missing": missing or [], "where": [], "fit": {}, **more}


def test_scores_of_known_answers() -> None:
    value = {"value": 1.1e-5, "std": 1e-6, "interval90": [0.9e-5, 1.3e-5]}
    phase = {"value": -3.1, "interval90": [-3.3, -2.9]}  # 0.08 rad from 3.1 the short way round
    current = {"value": 42.0, "interval90": [42.1, 43.0]}
    elsewhere = [{"block": "rotor", "node": 3, "probability": 0.9}]
    answers = [
        _diagnosis("consistent", parameters={"after": {"force_current_factor": current, "unbalance_phase": phase}}),
        _diagnosis(
            "missing_physics",
            [{"physics": "clearance", "class": ["clearance", "rub"], "parameters": {"gap": value}}],
            fit={"before": {"hold_out": 0.2}, "after": {"hold_out": 0.02}, "noise_floor": 0.01},
        ),
        _diagnosis("missing_physics", [{"physics": "runout", "class": ["runout"]}], where=elsewhere),
        _diagnosis("outside_catalogue", [{"physics": "outside_catalogue", "class": []}]),
        _diagnosis("consistent"),
    ]
    judged = [score.judge(truth, answer) for truth, answer in zip(TRUTHS, answers, strict=True)]
    result = tables.summary([*judged, score.judge(TRUTHS[1] | {"case": "f"}, None)])
    assert (result["cases"], result["diagnosed"]) == (6, 5)
    assert (result["named"]["hits"], result["named"]["of"]) == (1, 2)
    assert result["named_exactly"]["hits"] == 0
    assert (result["false_name"]["hits"], result["located"]["hits"], result["located"]["of"]) == (1, 0, 2)
    assert (result["false_alarm"]["hits"], result["false_alarm"]["of"]) == (0, 1)
    assert result["outside_recognised"]["hits"] == 1
    assert (result["alias_said"]["hits"], result["alias_absorbed"]["hits"]) == (0, 1)
    assert result["held_out_gain"]["of_one_and_two"]["median"] == pytest.approx(math.log(10) / math.log(20))
    assert result["free_parameters"]["coverage90"] == {
        "hits": 1,
        "of": 2,
        "share": 0.5,
        "interval95": pytest.approx((0.01258, 0.98742), abs=1e-5),
    }
    assert result["free_parameters"]["each"]["unbalance_phase"]["error"]["median"] == pytest.approx(2 * math.pi - 6.2)
    assert result["named_by_detectability"]["D 100 to 1000"]["hits"] == 1
    page = tables.markdown(result, "title")
    assert "| effects named, with credit for the class | 1/2 = 50 % (1 to 99 %) |" in page
    assert "| dahl | 1/1 = 100 % (" in page


def test_parameters_of_an_effect_are_compared_where_it_is_named_exactly() -> None:
    found = {
        "gap": {"value": 1.1e-5, "interval90": [0.9e-5, 1.3e-5]},
        "friction": {"value": 0.3, "interval90": [0.2, 0.4]},
    }
    answer = _diagnosis("missing_physics", [{"physics": "rub", "class": ["rub"], "parameters": found}])
    numbers = {number["name"]: number for number in score.judge(TRUTHS[1], answer)["parameters"]}
    assert numbers["gap"]["error"] == pytest.approx(0.1)
    assert numbers["gap"]["covered"] is True
    assert numbers["friction"]["covered"] is False


@pytest.mark.parametrize(
    ("hits", "of", "expected"), [(0, 10, (0.0, 0.308497)), (10, 10, (0.691503, 1.0)), (5, 10, (0.187086, 0.812914))]
)
def test_clopper_pearson(hits: int, of: int, expected: tuple[float, float]) -> None:
    assert tables.interval(hits, of) == pytest.approx(expected, abs=1e-6)


def test_misuse_of_the_commands(tmp_path, capsys):
    assert main(["make", str(tmp_path / "set"), "--kind", "one", "--rows", "rub, wobble"]) == 2
    assert capsys.readouterr().err == (
        "error: --rows: no wobble of kind one; hint: python -m benchmarks.concealed rows\n"
    )
    assert main(["run", str(tmp_path), str(tmp_path / "found")]) == 2
    assert capsys.readouterr().err == (
        f"error: {tmp_path}: no set.json; hint: a set of others needs --diagram jeffcott or fe_rigid\n"
    )
    assert main(["score", str(tmp_path), str(tmp_path / "found")]) == 2
    assert capsys.readouterr().err == f"error: {tmp_path}: no truth/CASE.json and no CASE/truth.json\n"
    assert main(["score", str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        f"error: {tmp_path}: no folder of its diagnoses; hint: FOLDER DIAGNOSES, for each set\n"
    )
