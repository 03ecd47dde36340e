"""Diagnosis by resonances: responses of a beam with discs, from matrices and a modal sum of the test's own."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.linalg import eigh

from rotorsim.cli.app import rotorsim
from rotorsim.diagnosis.diagnosis import Diagnosis, diagnose
from rotorsim.diagnosis.evidence.resonance.resonances import resonances
from rotorsim.errors import Place, RotorsimError
from rotorsim.identification.waveform.recorded.data import SampledRun
from rotorsim.model.load import load
from rotorsim.recordings.recording import Channel, Recording, Run

SHARED = Path(__file__).parents[4] / "shared" / "recordings"
LENGTH, COUNT, DIAMETER, E, DENSITY = 0.08, 9, 0.01, 2.1e11, 7850.0
DISCS = {3: (1.0, 2.5e-3), 8: (0.7, 1.2e-3)}  # node (from 1): mass, diametral inertia
LEFT, RIGHT, DAMPING = 1.2e5, 2e5, 15.0
SENSORS = (1, 2, 4, 5, 6, 7, 9, 10)
RATE, SECONDS = 2048.0, 16.0


def matrices(inertia: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return M, C and K of one plane: Euler-Bernoulli elements with consistent mass, discs, springs with dampers."""
    size = 2 * (COUNT + 1)
    M, C, K = (np.zeros((size, size)) for _ in range(3))
    area, second, a = np.pi / 4 * DIAMETER**2, np.pi / 64 * DIAMETER**4, LENGTH
    mass = np.array(
        [[156, 22 * a, 54, -13 * a], [0, 4 * a**2, 13 * a, -3 * a**2], [0, 0, 156, -22 * a], [0, 0, 0, 4 * a**2]]
    )
    bent = np.array([[12, 6 * a, -12, 6 * a], [0, 4 * a**2, -6 * a, 2 * a**2], [0, 0, 12, -6 * a], [0, 0, 0, 4 * a**2]])
    for k in range(COUNT):
        part = slice(2 * k, 2 * k + 4)
        M[part, part] += DENSITY * area * a / 420 * (mass + np.triu(mass, 1).T)
        K[part, part] += E * second / a**3 * (bent + np.triu(bent, 1).T)
    for node, (m, i) in DISCS.items():
        M[2 * node - 2, 2 * node - 2] += m
        M[2 * node - 1, 2 * node - 1] += inertia * i
    for node, stiffness in ((2, LEFT), (9, RIGHT)):
        K[2 * node - 2, 2 * node - 2] += stiffness
        C[2 * node - 2, 2 * node - 2] += DAMPING
    return M, C + 1e-6 * K, K


def frequencies(inertia: float) -> np.ndarray:
    M, _, K = matrices(inertia)
    return np.sqrt(np.maximum(eigh(K, M, eigvals_only=True), 0)) / (2 * np.pi)


@cache
def recording(inertia: float, driven: int = 9) -> Recording:
    """Return accelerations under a sweep of current to 400 Hz that acts with 40 N/A at a node."""
    M, C, K = matrices(inertia)
    n = int(RATE * SECONDS)
    t = np.arange(n) / RATE
    u = 0.3 * np.sin(np.pi * 400 / SECONDS * t**2)
    U, f = np.fft.rfft(u), np.fft.rfftfreq(n, 1 / RATE)
    load_at = np.zeros(len(M))
    load_at[2 * driven - 2] = 40.0
    w = 2 * np.pi * f[:, None, None]
    q = np.linalg.solve(K - w**2 * M + 1j * w * C, np.broadcast_to(load_at[:, None], (len(f), len(M), 1)))[:, :, 0]
    y = np.fft.irfft(-((2 * np.pi * f) ** 2)[:, None] * q[:, [2 * s - 2 for s in SENSORS]] * U[:, None], n, axis=0)
    rng = np.random.default_rng(1)
    y += 1e-3 * y.std(axis=0) * rng.normal(size=y.shape)
    channels = {"i": Channel("i", "drive.output", None, None, None, "A")}
    values = {"i": u}
    for k, sensor in enumerate(SENSORS):
        channels[f"a{k}"] = Channel(f"a{k}", "rotor.acceleration", "x", None, (sensor - 1) * LENGTH, "m/s^2")
        values[f"a{k}"] = y[:, k]
    run = Run("sweep", "sweep.npz", t, values, None, None, {}, "identify", Place("recording.json"), RATE)
    return Recording("beam", "computed", Path("."), channels, (run,))


def document(driven: int = 9) -> dict:
    nodes = list(DISCS)
    bearing = {"type": "support", "parameters": {"damping": [DAMPING, DAMPING]}}
    return {
        "name": "beam",
        "schema_version": 1,
        "parameters": {"left": "1e5 N/m", "right": "1e5 N/m"},
        "blocks": {
            "drive": {"type": "recorded"},
            "coil": {"type": "gain", "parameters": {"gain": "40 N/A"}},
            "at_rest": {"type": "constant", "parameters": {"value": 0.0}},
            "rotor": {
                "type": "rotor_fe",
                "parameters": {
                    "elements": COUNT,
                    "element_length": LENGTH,
                    "outer_diameter": DIAMETER,
                    "young_modulus": E,
                    "density": DENSITY,
                    "stiffness_damping": 1e-6,
                    "point_discs": True,
                    "disc_nodes": nodes,
                    "disc_mass": [DISCS[k][0] for k in nodes],
                    "disc_diametral_inertia": [DISCS[k][1] for k in nodes],
                },
            },
            "left": {**bearing, "parameters": {**bearing["parameters"], "stiffness": "$left"}},
            "right": {**bearing, "parameters": {**bearing["parameters"], "stiffness": "$right"}},
        },
        "wires": [
            ["drive.output", "coil.input"],
            ["coil.output", f"rotor.force[{driven},1]"],
            ["at_rest.output", "rotor.speed"],
            *(
                wire
                for name, node in (("left", 2), ("right", 9))
                for wire in (
                    [f"rotor.displacement[{node}]", f"{name}.displacement"],
                    [f"rotor.velocity[{node}]", f"{name}.velocity"],
                    [f"{name}.force", f"rotor.force[{node}]"],
                )
            ),
        ],
        "identify": {"left": {}, "right": {}},
        "solver": {"step": "1e-6 s", "stop": "1 ms"},
        "record": ["rotor.displacement[4]"],
    }


PHYSICS = ("disc_rotary_inertia", "support_stiffness", "foundation_mode", "seal_cross_coupling")


@cache
def diagnosed(inertia: float, driven: int = 9) -> Diagnosis:
    return diagnose(load(document(driven)), recording(inertia), physics=PHYSICS, workers=1)


@pytest.mark.slow
def test_the_rotary_inertia_of_discs_is_named_and_measured():
    found = diagnosed(1.0)
    assert found.verdict == "missing_physics"
    assert [effect.physics for effect in found.effects] == ["disc_rotary_inertia"]
    assert found.spots[0].block == "rotor"
    assert found.after.values["rotor.disc_inertia_factor"] == pytest.approx(1.0, rel=0.02)
    assert found.after.values["left"] == pytest.approx(LEFT, rel=0.03)
    assert found.after.values["right"] == pytest.approx(RIGHT, rel=0.03)
    assert found.score_before.total > 0.1
    assert found.score_after.total < 0.01  # each resonance predicted from the others
    assert found.warnings == ()
    assert "times the error of models from drawings (3% of a frequency)" in found.statement
    assert "On resonances left out one by one the error falls from " in found.statement
    assert "The recorded input acts at rotor.force[9], as the diagram says" in found.statement


@pytest.mark.slow
def test_nothing_is_missing_where_discs_are_points():
    found = diagnosed(0.0)
    assert found.verdict == "consistent"
    assert found.score_before.total < 0.01
    assert found.after.values["left"] == pytest.approx(LEFT, rel=0.03)


@pytest.mark.slow
def test_a_drive_at_the_other_bearing_is_noticed():
    assert "The recorded input acts at rotor.force[9], not where the diagram says" in diagnosed(1.0, 2).statement


@pytest.mark.slow
def test_held_out_runs_are_compared_by_their_resonances():
    made = recording(1.0)
    held = Recording("held", made.source, made.folder, made.channels, made.runs)
    found = diagnose(load(document()), made, hold_out=held, physics={"disc_rotary_inertia"}, workers=1)
    measured = np.array([30.48, 64.63, 109.73, 165.17, 317.04, 353.52])  # of the matrices; see the next test
    assert frequencies(1.0)[:6] == pytest.approx(measured, rel=1e-4)
    mine = found.evidence.frequencies(found.after)
    assert found.score_after.total == pytest.approx(float(np.sqrt(np.mean((mine / measured - 1) ** 2))), abs=2e-3)
    assert "On hold-out runs the error falls from " in found.statement


@pytest.mark.slow
def test_the_end_of_a_sweep_is_no_resonance():
    made = recording(1.0)
    names = [f"rotor.acceleration[{k},1]" for k in SENSORS]
    values = {n: made.runs[0].values[f"a{k}"] for k, n in enumerate(names)}
    run = SampledRun("sweep", {**values, "drive.output": made.runs[0].values["i"]}, {}, made.runs[0].time, {})
    ends = [item.frequency for item in resonances([run], names) if 380 < item.frequency < 402]
    assert ends  # a peak of the spectrum
    assert not [f for f in ends if f in [item.frequency for item in resonances([run], names, ["drive.output"])]]


def test_resonances_are_those_of_the_matrices():
    made = recording(1.0)
    names = [f"rotor.acceleration[{k},1]" for k in SENSORS]
    values = {n: made.runs[0].values[f"a{k}"] for k, n in enumerate(names)}
    run = SampledRun("sweep", {**values, "drive.output": made.runs[0].values["i"]}, {}, made.runs[0].time, {})
    found = [item for item in resonances([run], names, ["drive.output"]) if item.strong]
    M, _, K = matrices(1.0)
    values, vectors = eigh(K, M)
    exact = np.sqrt(values) / (2 * np.pi)
    assert len(found) >= 4
    for item in found:
        k = int(np.argmin(np.abs(exact - item.frequency)))
        assert item.frequency == pytest.approx(exact[k], rel=0.02)
        mode = vectors[[2 * s - 2 for s in SENSORS], k]
        assert abs(np.vdot(mode, item.shape)) ** 2 / (mode @ mode) > 0.95


def test_a_position_without_a_node_is_refused():
    made = recording(1.0)
    channels = {**made.channels, "a0": Channel("a0", "rotor.acceleration", "x", None, 0.03, "m/s^2")}
    with pytest.raises(RotorsimError) as caught:
        diagnose(load(document()), Recording("beam", "computed", Path("."), channels, made.runs), workers=1)
    assert str(caught.value) == (
        "error: channel a0: no node at 0.03 m\n\n"
        "hint: the nearest is node 1 at 0 m; divide the shaft so that a node is where it was measured"
    )


@pytest.mark.slow
@pytest.mark.skipif(not (SHARED / "tum_amb_rotor").exists(), reason="the shared recordings are not here")
def test_the_rotor_of_munich(tmp_path):
    given = ["diagnose", "tum_amb_rotor", str(SHARED / "tum_amb_rotor"), "--out", str(tmp_path), "--json"]
    given += ["--physics", "disc_rotary_inertia"]  # all of them: benchmarks.diagnosis.measured
    result = CliRunner().invoke(rotorsim, [*given, "--workers", "1"])
    assert result.exit_code == 1
    found = json.loads(result.stdout)
    assert [item["physics"] for item in found["missing"]] == ["disc_rotary_inertia"]
    assert "Open: 204.5 Hz" in found["statement"]
    assert "acts at rotor.force[16], as the diagram says" in found["statement"]
    result = CliRunner().invoke(rotorsim, ["modes", str(tmp_path / "diagram.json"), "--json"])
    modes = [mode["frequency_hz"] for mode in json.loads(result.stdout)["modes"]][::2][:6]  # both planes are alike
    stated = np.array([17, 51, 60, 100.5, 162, 203.3])  # recording.json
    assert np.sqrt(np.mean((np.array(modes) / stated - 1) ** 2)) < 0.05
    assert found["fit"]["before"]["hold_out"] > 10 * found["fit"]["after"]["hold_out"]
    assert found["next_experiment"].startswith("sensors along the second axis, and a sweep through the other bearing")
