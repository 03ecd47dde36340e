"""Rotors whose ground shakes or whose speed swings, solved by equations of their own: named, measured, repaired."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from rotorsim.diagnosis.diagnosis import Diagnosis, diagnose
from rotorsim.diagnosis.files import diagnosis_data, save_diagnosis
from rotorsim.errors import Place
from rotorsim.model.load import load
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.report.comparison.speed_curves import settled_harmonics
from rotorsim.report.diagnosis.compared import compared
from rotorsim.report.figures.spectra import spectra_figure
from rotorsim.signals.harmonics import harmonics_of
from rotorsim.simulation.run import simulate

pytestmark = pytest.mark.slow  # each machine is diagnosed in three to ten seconds

TURN = 2 * np.pi
RATE, N = 2000.0, 2000
SETTLING = 0.4  # s: the closed loop decays with 56 and 79 per second
NOISE = {"r": 2e-9, "i": 3e-5}  # m, A
SPEEDS = TURN * np.array([17.3, 24.1, 38.6, 55.2, 31.4, 47.9])
USES = ("identify",) * 4 + ("hold_out",) * 2
GAINS = np.array([(12200.0, 2000.0, 3.0), (9000.0, 2000.0, 5.0)] * 3)  # K_P, K_I, K_D of each run
SHAKEN, SWINGING = TURN * 41.7, TURN * 11.3
ACCELERATION, DIRECTION, SWING = 0.05, 0.6, 1.5e-3
PHYSICS = ("base_excitation", "speed_fluctuation", "torsion_coupling", "residual_bow", "runout", "anisotropic_support")
OTHERS = (*PHYSICS[:1], *PHYSICS[3:5])
FAINT = 4e-3  # of a shaking that every run shows
ODD = np.arange(1, 10, 2)


@dataclass(frozen=True)
class Machine:
    """The rotor of thesis Table 2-1, with other values where the diagram has them free; r = x + i y.

    m r'' + c r' + k r = k_s r - k_i i + dk s(a) sag (1 + e^{2ia}) / 2
                         + m e (th'^2 - i th'') e^{i (th + beta)} - m shaking cos(nu t + phase) e^{i direction}
    i = K_P r + K_I int r + K_D r',   th = W t + th0 + swing sin(nu t + phase),   a = th + crack_phase
    s = 1/2 + 2/pi (cos a - cos 3a / 3 + cos 5a / 5 - cos 7a / 7 + cos 9a / 9)
    """

    mass: float = 2.0
    stiffness: float = 7.6e5
    viscous_damping: float = 91.0
    force_displacement_factor: float = 98e3
    force_current_factor: float = 45.0
    crack_stiffness: float = 2.4e5
    crack_phase: float = 0.9
    sag: float = 26e-6
    eccentricity: float = 31e-6
    unbalance_phase: float = -1.1
    shaking: float = 0.0
    swing: float = 0.0
    nu: float = 0.0
    directions: tuple[int, ...] = (1,) * len(SPEEDS)

    @property
    def speeds(self) -> np.ndarray:
        return SPEEDS * np.array(self.directions)

    def angle(self, t: np.ndarray | float, start: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """Return theta of all runs, (..., R), at times (..., 1)."""
        return self.speeds * t + start + self.swing * np.sin(self.nu * t + phase)

    def force(self, t: np.ndarray, start: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """Return what acts on the rotor whatever its motion, (..., R), at times (..., 1)."""
        theta, inside = self.angle(t, start, phase), self.nu * t + phase
        rate = self.speeds + self.swing * self.nu * np.cos(inside)
        growth = -self.swing * self.nu**2 * np.sin(inside)
        a = theta + self.crack_phase
        s = 0.5 + 2 / np.pi * np.cos(np.multiply.outer(a, ODD)) @ ((-1) ** np.arange(5) / ODD)
        force = 0.5 * self.crack_stiffness * s * self.sag * (1 + np.exp(2j * a))
        force += self.mass * self.eccentricity * (rate**2 - 1j * growth) * np.exp(1j * (theta + self.unbalance_phase))
        return force - self.mass * self.shaking * np.cos(inside) * np.exp(1j * DIRECTION)

    def motion(self, start: np.ndarray, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return displacement [m] and current [A] of all runs, (R, N), complex, from t = 0; begun before.

        Variation of constants for x = [int r, r, r'], from sample to sample: x(t + h) = e^{A h} x(t)
        + int e^{A (h - s)} [0, 0, force(t + s) / m] ds by Gauss's rule (order 10: at most 0.4 rad of an eigenvalue).
        """
        A = np.zeros((len(SPEEDS), 3, 3))
        A[:, 0, 1] = A[:, 1, 2] = 1.0
        A[:, 2] = -self.force_current_factor * GAINS[:, [1, 0, 2]]
        A[:, 2] += [0.0, self.force_displacement_factor - self.stiffness, -self.viscous_damping]
        A[:, 2] /= self.mass
        nodes, weights = np.polynomial.legendre.leggauss(5)
        h, s = 1 / RATE, (1 + nodes) / 2 / RATE
        before = round(SETTLING * RATE)
        at = (np.arange(-before, N - 1) / RATE)[:, None, None] + s[:, None]
        pull = weights / 2 * h / self.mass * expm(A[:, None] * (h - s)[:, None, None])[..., 2].swapaxes(1, 2)
        steps = np.einsum("rij,njr->nri", pull, self.force(at, start, phase))
        mean = 0.25 * self.crack_stiffness * self.sag * (1 + 2 / np.pi)  # of the crack: held by the integral
        states = np.zeros((before + N, len(SPEEDS), 3), complex)
        states[0, :, 0] = mean / (self.force_current_factor * GAINS[:, 1])
        whole = expm(A * h)
        for n, step in enumerate(steps):
            states[n + 1] = (whole @ states[n][..., None])[..., 0] + step
        integral, r, v = np.moveaxis(states[before:], 2, 0)
        return r.T, current(integral, r, v).T


def current(integral: np.ndarray, r: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return K_P r + K_I int r + K_D r' of all runs, (..., R)."""
    return GAINS[:, 0] * r + GAINS[:, 1] * integral + GAINS[:, 2] * v


@cache
def recording(machine: Machine, seed: int = 1) -> Recording:
    """Return noisy runs at any angle of shaft and second frequency, with pulses at the true angle of the shaft."""
    random = np.random.default_rng(seed)
    start, phase = random.uniform(0, TURN, (2, len(SPEEDS)))
    time = np.arange(N) / RATE
    signals = dict(zip("ri", machine.motion(start, phase), strict=True))
    runs = []
    for k, speed in enumerate(machine.speeds):

        def turns(t: float, k: int = k) -> float:
            return float(machine.angle(t, start, phase)[k]) / TURN

        ends = sorted((turns(0.0), turns(time[-1])))
        passed = range(int(np.ceil(ends[0])), int(np.floor(ends[1])) + 1)
        tacho = sorted(brentq(lambda t, n=n, turns=turns: turns(t) - n, 0.0, time[-1], xtol=1e-14) for n in passed)
        values = {}
        for name, z in signals.items():
            for axis, part in (("x", z[k].real), ("y", z[k].imag)):
                values[name + axis] = part + NOISE[name] * random.standard_normal(N)
        settings = {f"controller.{key}": float(gain) for key, gain in zip(("KP", "KI", "KD"), GAINS[k], strict=True)}
        place = Place("recording.json", k + 10, 3)
        runs.append(Run(f"run{k}", "", time, values, speed, np.array(tacho), settings, USES[k], place, RATE))
    channels = {}
    for axis in "xy":
        channels[f"r{axis}"] = Channel(f"r{axis}", "rotor.displacement", axis, None, None, "m")
        channels[f"i{axis}"] = Channel(f"i{axis}", "controller.current", axis, None, None, "A")
    return Recording("made", "tests/diagnose", Path(), channels, tuple(runs))


MACHINES = {
    "healthy": Machine(),
    "shaken": Machine(shaking=ACCELERATION, nu=SHAKEN),
    "faint": Machine(shaking=ACCELERATION * FAINT, nu=SHAKEN),
    "swinging": Machine(swing=SWING, nu=SWINGING),
    "either way": Machine(swing=SWING, nu=SWINGING, directions=(1, -1, -1, 1, 1, -1)),
}
SWUNG = ("swinging", "either way")


@cache
def diagnosed(name: str) -> Diagnosis:
    few = {"shaken": OTHERS, "faint": OTHERS, "either way": PHYSICS[:2]}
    return diagnose(load("jeffcott"), recording(MACHINES[name]), physics=few.get(name, PHYSICS), workers=1)


def off(found: Diagnosis, name: str, true: float) -> float:
    """Return what a parameter is off, in its standard deviations."""
    j = [item.name for item in found.after.free].index(name)
    return float((found.after.theta[j] - true) / np.sqrt(found.after.covariance[j, j]))


def test_a_shaken_base_is_named_and_measured():
    found = diagnosed("shaken")
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert list(effect.members) == ["base_excitation"]
    assert str(found.spots[0]) == "rotor.force"
    assert abs(off(found, "base_excitation.acceleration", ACCELERATION)) < 3
    half = np.round((found.after.values["base_excitation.direction"] - DIRECTION) / np.pi) * np.pi
    assert abs(off(found, "base_excitation.direction", DIRECTION + half)) < 3
    frequency = diagnosis_data(found)["missing"][0]["parameters"]["frequency"]
    assert abs(frequency["value"] - SHAKEN) < 3 * frequency["std"]
    assert frequency["std"] < 1e-4 * SHAKEN


def test_a_shaking_too_faint_for_any_run_is_named_from_all():
    found = diagnosed("faint")
    assert not any(item.fit.lines for item in harmonics_of(recording(MACHINES["faint"])))
    assert found.verdict == "missing_physics"
    assert [list(effect.members) for effect in found.effects] == [["base_excitation"]]
    assert abs(off(found, "base_excitation.acceleration", ACCELERATION * FAINT)) < 3
    assert found.score_before.total < 1.1 * found.score_before.noise


@pytest.mark.parametrize("name", ["shaken", "faint"])
def test_lines_that_no_row_explains_are_described(name):
    """The force that acts is mass times acceleration, 0-peak; faint: noise adds 40 % at most."""
    machine = MACHINES[name]
    found = diagnose(load("jeffcott"), recording(machine), physics=("residual_bow",), workers=1)
    assert (found.verdict, found.effects) == ("outside_catalogue", ())
    assert found.unknown.data["place"] == "rotor.force"
    assert "orders" not in found.unknown.data  # harmonics are noise
    lines = found.unknown.data["lines"]
    assert lines["unit"] == "Hz"
    assert abs(lines["value"] - SHAKEN / TURN) < 4 * lines["std"]
    assert lines["orders"]["0"] == pytest.approx(machine.mass * machine.shaking, rel=0.01 if name == "shaken" else 0.4)
    assert f"asynchronous lines at {lines['value']:.4g} Hz" in found.statement


def test_a_swinging_speed_is_named_as_a_class_and_measured():
    """Drive or disc: the pulses of both look alike, for an even angle explains them too."""
    found = diagnosed("swinging")
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert set(effect.members) == {"speed_fluctuation", "torsion_coupling"}
    assert abs(off(found, f"{effect.physics}.amplitude", SWING)) < 3
    frequency = diagnosis_data(found)["missing"][0]["parameters"]["frequency"]
    assert abs(frequency["value"] - SWINGING) < 3 * frequency["std"]
    assert found.next_experiment


def test_it_is_measured_with_a_shaft_that_turns_either_way():
    found = diagnosed("either way")
    assert [effect.physics for effect in found.effects] == ["speed_fluctuation"]
    assert abs(off(found, "speed_fluctuation.amplitude", SWING)) < 3


@pytest.mark.parametrize("name", MACHINES)
def test_the_free_parameters_are_the_true_ones(name):
    found = diagnosed(name)
    own = [item.name for item in found.before.free]
    assert len(own) == 7
    for parameter in own:
        assert abs(off(found, parameter, getattr(MACHINES[name], parameter))) < 4, parameter


def test_nothing_is_found_in_a_healthy_machine():
    found = diagnosed("healthy")
    assert (found.verdict, found.effects, found.evidence.second) == ("consistent", (), None)
    assert found.score_after.total < 1.05 * found.score_after.noise
    runs = compared(found).held.runs
    assert runs.lines(0, runs.signals[0]) is None


@pytest.mark.parametrize("name", ["shaken", *SWUNG])
def test_repaired_diagrams_predict_runs_that_took_no_part(name, tmp_path):
    found = diagnosed(name)
    assert found.score_before.total > 2 * found.score_after.noise
    assert found.score_after.total < 1.05 * found.score_after.noise
    save_diagnosis(found, tmp_path)
    repaired = load(tmp_path / "diagram.json")
    physics = found.effects[0].physics
    assert repaired.nodes[physics].values["frequency"] == pytest.approx(MACHINES[name].nu, rel=1e-3)
    assert simulate(repaired, stop=0.01).status == "finished"


@pytest.mark.parametrize("name", ["shaken", SWUNG[0]])
def test_curves_over_speed_pass_through_what_is_predicted_of_the_runs(name):
    both = compared(diagnosed(name)).fitted
    signal, runs, orders = both.signals[0], both.runs, np.arange(-3, 4)
    for r in range(len(runs.speeds)):
        here = settled_harmonics(runs, r, runs.speeds[r : r + 1], signal, orders)[0]
        there = signal.combined(runs.predicted[r : r + 1], runs.experiment.predicted, orders)[0]
        moving = orders != 0  # the mean of a run that has not settled is its own
        assert np.abs(here - there)[moving].max() < 0.01 * NOISE["r"]


@pytest.mark.parametrize("name", ["shaken", *SWUNG])
def test_spectra_show_lines_that_the_repaired_diagram_explains(name):
    """|measured - model|^2 over its variance is one on average, in both directions; as given it is far more."""
    both = compared(diagnosed(name)).held
    ratios = {"before": [], "after": []}
    for label, (_, runs) in zip(ratios, both.diagrams, strict=True):
        for r in range(len(runs.speeds)):
            for signal in runs.signals:
                measured, model = runs.lines(r, signal)
                ratios[label] += (np.abs(measured.value - model) ** 2 / (2 * measured.amplitude_std**2)).tolist()
    count = len(ratios["after"])
    assert count >= 8
    assert np.mean(ratios["after"]) < 1 + 4 / np.sqrt(count)
    assert np.mean(ratios["before"]) > 100
    made = spectra_figure(both)
    assert "measured at kX + nu" in [text.get_text() for text in made.legends[0].get_texts()]
