"""Order vectors over the speed as evidence: what is noise, what is named, and what these rows cannot say."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.evidence.open import open_evidence
from rotorsim.diagnosis.evidence.orders.noise import (
    RowNoise,
    memory_of,
    plain,
    restricted,
    white_noise,
    whitened_search,
)
from rotorsim.diagnosis.evidence.orders.whiteness import _of_white, whiteness_of
from rotorsim.diagnosis.files import diagnosis_data
from rotorsim.errors import RotorsimError
from rotorsim.identification.left_out import standardised, surprise
from rotorsim.identification.waveform.order_tracking import tracked_orders
from rotorsim.model.load import load
from rotorsim.recordings.orders import load_orders
from rotorsim.report.diagnosis.compared import compared
from tests.diagnosis.orders import NOISE, drawn, passage, recorded, run_up, write_runs
from tests.identification.waveform.orders import ROTOR

X, Y = "1X of rotor.displacement[1]", "1X of rotor.displacement[2]"
ACROSS = "across rotor.displacement[1] nothing was measured, and planes that differ, or whirl, show only in part"


@pytest.fixture(scope="module")
def diagram(tmp_path_factory):
    file = tmp_path_factory.mktemp("diagram") / "disc.json"
    file.write_text(json.dumps(ROTOR))
    return load(str(file))


def diagnosed(diagram, folder, physics, **keys):
    return diagnose(diagram, load_orders(folder), physics=physics, workers=1, **keys)


# -- noise -------------------------------------------------------------------------------------------------------------


def rows_of(memory: float, seed: int, count: int = 100) -> np.ndarray:
    random = np.random.default_rng(seed)
    return lfilter([1.0], [1, -memory], random.normal(size=count + 50) + 1j * random.normal(size=count + 50))[50:]


@pytest.mark.slow
@pytest.mark.parametrize("count", [70, 100])
def test_white_rows_are_white_as_often_as_the_probability_says(count):
    """At most as often as it says (Bonferroni), + 3 standard deviations, in the tail that decides as well."""
    random = np.random.default_rng(count)
    rows = random.normal(size=(4000, count)) + 1j * random.normal(size=(4000, count))
    found = np.array([whiteness_of([one])[0] for one in rows])
    for level in (0.1, 0.01, 0.001):
        most = 4000 * level
        assert 0.3 * most - 3 * np.sqrt(most) <= (found < level).sum() <= most + 3 * np.sqrt(most)
    assert (found < 1e-4).sum() <= 2


@pytest.mark.slow
def test_rows_that_are_lost_do_not_make_white_rows_less_white():
    random = np.random.default_rng(5)
    there = random.random(100) < 0.7
    rows = np.where(there, random.normal(size=(2000, 100)) + 1j * random.normal(size=(2000, 100)), np.nan)
    found = np.array([whiteness_of([one[:60], one[60:]])[0] for one in rows])
    assert 3 <= (found < 0.01).sum() <= 33


@pytest.mark.parametrize("smooth", [np.exp(1j * np.arange(100) / 20), np.exp(1j * np.arange(100) ** 2 / 60)])
def test_a_smooth_curve_and_a_beat_beside_white_rows_are_structure(smooth):
    """As large as the noise: no share of the row before makes them white."""
    low = 0
    for seed in range(20):
        rows = rows_of(0.0, seed) + np.sqrt(2) * smooth
        memory = memory_of([rows])
        white = np.append(rows[0], rows[1:] - memory * rows[:-1])
        low += whiteness_of([white])[0] < 0.01
    assert low >= 15


def test_chi_squared_would_reject_white_rows_too_often():
    """Why the probability is counted: of 100 rows and 20 lags, 0.2 % are beyond the quantile of 0.01 %."""
    drawn = _of_white((np.ones(100, bool).tobytes(),), 20)
    assert 1e-3 < (drawn > chi2.isf(1e-4, 40)).mean() < 3e-3


@pytest.mark.slow
def test_what_a_fit_takes_up_of_slow_noise_is_not_taken_from_its_memory():
    """Eight slow curves beside rows that keep 0.8: what is left keeps less, its likelihood says 0.8 and 1."""
    n, found = 100, []
    curves = np.stack([np.cos(np.pi * k * (np.arange(n) + 0.5) / n) for k in range(4)], axis=1)
    flat = np.concatenate([np.kron(curves, [[1.0], [0.0]]), np.kron(curves, [[0.0], [1.0]])], axis=1)  # (2 n, 8)
    for seed in range(60):
        rows = rows_of(0.8, seed, n)
        y = np.stack([rows.real, rows.imag], axis=1)
        left = (y.ravel() - flat @ np.linalg.lstsq(flat, y.ravel(), rcond=None)[0]).reshape(n, 2)
        plain_one = memory_of([left[:, 0] + 1j * left[:, 1]])
        [variance], [memory] = restricted([left], [flat.reshape(n, 2, 8)], np.array([plain_one]))
        found.append((plain_one, memory, variance))
    plain_one, memory, variance = np.mean(found, axis=0)
    assert plain_one < 0.75
    assert memory == pytest.approx(0.8, abs=0.022)  # 4 of sqrt((1 - m^2) / 2 n / 60)
    assert variance == pytest.approx(1.0, abs=0.052)  # of 2 n numbers 60 times: 4 of sqrt(2 / 12000)


def test_memory_is_what_a_row_keeps_of_the_row_before():
    assert memory_of([rows_of(0.8, 1, 4000)]) == pytest.approx(0.8, abs=0.03)
    assert sum(memory_of([rows_of(0.0, seed)]) > 0 for seed in range(50)) <= 5
    gap = rows_of(0.8, 2, 4000)
    gap[::3] = np.nan  # of every third row pairs are lost
    assert memory_of([gap]) < 0.8


@pytest.mark.slow
def test_a_whitened_search_takes_the_row_before_away_and_begins_anew_after_a_gap(diagram, tmp_path):
    recording = load_orders(run_up(tmp_path / "r", drawn(1), 1))
    tracked = tracked_orders(diagram, recording, recording.runs, diagram.free)
    [track] = tracked.tracks
    y = track.vectors.copy()
    y[50] = complex(np.nan, np.nan)
    tracked = replace(tracked, tracks=(replace(track, vectors=y),))
    search = whitened_search(tracked, {X: RowNoise(4.0, 0.6, 100.0, 1.0)})
    at = search.first()
    e = search.evaluate(at, 1).residuals[0][0]
    r = plain(search).evaluate(at, 1).residuals[0][0]
    np.testing.assert_allclose(e[1:50], r[1:50] - 0.6 * r[:49], rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(e[[0, 51]], 0.8 * r[[0, 51]], rtol=1e-12)
    assert np.isnan(e[50]).all()
    assert search.root(0, 0)[50].tolist() == [0.0, 0.0]
    J = search.evaluate(at, 1).jacobians[0][0]
    step = np.zeros(len(at))
    step[2] = 1.0
    ends = [search.evaluate(at + sign * step, 1, sensitivities=False).residuals[0][0] for sign in (1, -1)]
    slope = (ends[0] - ends[1]) / 2
    np.testing.assert_allclose(np.nan_to_num(J[:, :, 2])[np.isfinite(slope)], slope[np.isfinite(slope)], rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_where_nothing_is_hidden_the_noise_is_found(diagram, tmp_path, memory):
    recording = load_orders(run_up(tmp_path / "r", drawn(3), 3, memory))
    opened = open_evidence(diagram, recording, None, Catalogue.of(diagram), [])
    noise = opened.evidence.noise[X]
    assert noise.std == pytest.approx(NOISE, rel=0.35 if memory else 0.2)
    assert noise.memory == pytest.approx(memory, abs=0.12)
    assert opened.base.goodness > 0.1
    assert opened.evidence.structure(opened.base) == 0


@pytest.mark.slow
def test_noise_of_a_run_that_is_not_explained_is_white_between_rows(diagram, tmp_path):
    folder = run_up(tmp_path / "r", drawn(1, cubic=1e12), 1)
    recording = load_orders(folder)
    opened = open_evidence(diagram, recording, None, Catalogue.of(diagram), [])
    assert opened.base.goodness < 1e-10
    assert opened.evidence.noise[X].memory == 0
    tracked = opened.evidence.tracked(opened.base.document)
    assert opened.evidence.noise[X].variance <= white_noise(tracked)[X].variance
    assert opened.evidence.structure(opened.base) > 0.3


def test_the_misfit_of_data_left_out_is_that_of_their_covariance():
    """e^T (I + J C J^T)^-1 e with C of the others, for what linear theory predicts of each run."""
    random = np.random.default_rng(3)
    S, J, e = random.normal(size=(30, 3)), random.normal(size=(8, 3)), random.normal(size=8)
    direct = e @ np.linalg.solve(np.eye(8) + J @ np.linalg.inv(S.T @ S) @ J.T, e)
    assert surprise(S, e, J) == pytest.approx(direct, rel=1e-9)
    both = np.concatenate([J, S])
    y = random.normal(size=38)
    left = y - both @ np.linalg.lstsq(both, y, rcond=None)[0]
    off = y[:8] - J @ np.linalg.lstsq(S, y[8:], rcond=None)[0]
    [(misfit, rows), _] = standardised(both, left, [8, 30])
    assert rows == 8
    assert misfit == pytest.approx(surprise(S, off, J), rel=1e-9)
    assert surprise(S, e * np.nan, J) is None


# -- verdicts ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_cubic_spring_is_named_and_predicts_a_coast_down(diagram, tmp_path):
    disc = drawn(1, cubic=1e12)
    up, down = passage(disc, 1250.0, 230.0), passage(disc, 2050.0, -150.0)
    runs = {"up": up, "down": down}
    noisy = {name: (speed, recorded(y[:, :1], k)) for k, (name, (speed, y)) in enumerate(runs.items())}
    folder = write_runs(tmp_path / "r", noisy, held="down")
    found = diagnosed(diagram, folder, ["cubic_stiffness", "anisotropic_support"])
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert effect.members == {"cubic_stiffness": 1.0}
    assert found.after.values["cubic_stiffness.stiffness"] == pytest.approx(1e12, rel=0.02)
    assert found.proof.status == "proved"
    assert found.held_out
    assert found.score_after.total < 1.15 * found.score_after.noise
    assert 5 * found.score_after.total < found.score_before.total
    assert found.statement.startswith("disc does not explain the recording: residual variance ")
    assert "times the noise from row to row. Missing physics: cubic_stiffness at rotor.force" in found.statement
    data = diagnosis_data(found)
    assert data["missing"][0]["place"] == "rotor.force"
    assert data["fit"]["held_out"] == "hold_out"
    drawings = [*compared(found).figures()]
    assert [drawing.name for drawing in drawings] == ["orders_down_1"]
    amplitude, phase, left = drawings[0].figure.axes
    labels = [line.get_label() for line in amplitude.lines]
    assert labels == ["measured", "diagram as given", "repaired diagram"]
    assert amplitude.get_ylabel() == "amplitude [um, 0-peak]"
    assert phase.get_ylabel() == "phase lag [deg]"
    assert left.get_xlabel() == "speed [rpm]"
    measured, given, repaired = (line.get_ydata() for line in amplitude.lines)
    assert np.abs(repaired - measured).max() < 0.6 < np.abs(given - measured).max()
    over, alike = compared(found).residuals().figure.axes
    assert over.get_ylabel() == "|measured - simulated| / noise"
    assert alike.get_xlabel() == "rows between"


@pytest.mark.slow
def test_planes_that_differ_are_named_with_two_probes_and_said_to_be_unseen_with_one(diagram, tmp_path):
    disc, physics = drawn(1, split=1500.0), ["anisotropic_support", "seal_cross_coupling"]
    found = diagnosed(diagram, run_up(tmp_path / "two", disc, 1, axes="xy"), physics)
    assert [effect.physics for effect in found.effects] == ["anisotropic_support"]
    assert found.after.values["anisotropic_support.stiffness_difference"] == pytest.approx(1500.0, rel=0.02)
    assert "Across" not in found.statement
    alone = diagnosed(diagram, run_up(tmp_path / "one", disc, 1), physics)
    assert alone.verdict == "not_identifiable"
    assert "Nothing is said of anisotropic_support" in alone.statement
    assert f"Whether that is all cannot be judged, though: {ACROSS}." in alone.statement
    assert alone.statement.count("nothing was measured, and planes") == 1
    assert alone.statement.endswith("Of orders other than 1X nothing was measured.")
    assert alone.next_experiment == f"a second probe at right angles: {ACROSS}"


@pytest.mark.slow
def test_a_bow_is_what_slow_roll_and_unbalance_take_up_and_that_is_said(diagram, tmp_path):
    found = diagnosed(diagram, run_up(tmp_path / "r", drawn(1, bow=4e-6), 1, axes="xy"), ["residual_bow"])
    assert found.verdict == "consistent"
    assert "Nothing is said of residual_bow: what is free changes these data alike." in found.statement
    assert "Slow roll was fitted along: " in found.statement
    assert f"deg of {X}, " in found.statement
    assert f"deg of {Y}: run-out, or a bow, which it would take up." in found.statement


@pytest.mark.slow
def test_run_out_that_was_not_subtracted_is_a_class_with_bow(diagram, tmp_path):
    folder = run_up(tmp_path / "r", drawn(0), 0, slow_roll="subtracted")
    found = diagnosed(diagram, folder, ["runout", "residual_bow", "cubic_stiffness"])
    assert found.verdict == "missing_physics"
    [effect] = found.effects
    assert {"runout", "residual_bow"} == set(effect.members)
    assert "no other speed, acceleration, probe or order does; a probe at the disc" in found.next_experiment
    assert "Slow roll was fitted" not in found.statement


@pytest.mark.slow
def test_few_rows_are_never_consistent(diagram, tmp_path):
    speed, vectors = passage(drawn(2), 1250.0, 700.0, rows=30)
    folder = write_runs(tmp_path / "r", {"up": (speed, recorded(vectors[:, :1], 2))})
    found = diagnosed(diagram, folder, ["cubic_stiffness"])
    assert found.verdict == "not_identifiable"
    few = f"30 rows of {X} are too few to tell structure from noise: 70 are needed"
    assert f"Whether that is all cannot be judged, though: {few}; {ACROSS}." in found.statement
    rows = f"rows at every turn, from slow roll to beyond a critical speed: {few}"
    assert found.next_experiment == f"{rows}; a second probe at right angles: {ACROSS}"


@pytest.mark.slow
def test_rows_at_one_speed_are_never_consistent(diagram, tmp_path):
    speed, vectors = passage(drawn(2), 1250.0, 20.0, rows=100)
    folder = write_runs(tmp_path / "r", {"up": (speed, recorded(vectors[:, :1], 2))})
    found = diagnosed(diagram, folder, ["cubic_stiffness"])
    assert found.verdict == "not_identifiable"
    assert "All its runs are alike, though: at one speed unbalance imitates bow and runout" in found.statement


@pytest.mark.slow
def test_what_cannot_be_compared_is_refused(diagram, tmp_path):
    speed, vectors = passage(drawn(2), 1250.0, 230.0, rows=40)
    one = load_orders(write_runs(tmp_path / "one", {"up": (speed, recorded(vectors[:, :1], 2))}))
    two = load_orders(write_runs(tmp_path / "two", {"up": (speed, recorded(vectors, 2))}, "xy"))
    with pytest.raises(RotorsimError, match=r"has no 1X of rotor.displacement\[2\], which the diagram is fitted to"):
        diagnose(diagram, two, hold_out=one)
    other = replace(one, slow_roll=False)
    with pytest.raises(RotorsimError, match="its slow roll is not treated as that of the recording"):
        diagnose(diagram, one, hold_out=other)
    held = replace(one, runs=tuple(replace(run, use="hold_out") for run in one.runs))
    with pytest.raises(RotorsimError, match="no run to identify from"):
        diagnose(diagram, held)
    named = {key: replace(channel, signal="rotr.displacement") for key, channel in one.channels.items()}
    with pytest.raises(RotorsimError, match="no such signal"):
        diagnose(diagram, replace(one, channels=named))
    document = values_in(diagram.document, {})
    document["blocks"]["second"] = document["blocks"]["clock"]
    (tmp_path / "clocks.json").write_text(json.dumps(document))
    with pytest.raises(RotorsimError, match="has 2 clocks: which one turns as recorded is not known"):
        diagnose(load(str(tmp_path / "clocks.json")), one)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "memory"), [(0, 0.0), (1, 0.8)])
def test_of_the_whole_catalogue_nothing_is_found_where_nothing_is_hidden(diagram, tmp_path, seed, memory):
    found = diagnosed(diagram, run_up(tmp_path / "r", drawn(seed), seed, memory, "xy"), None)
    assert found.verdict == "consistent"


@pytest.mark.slow
def test_of_the_whole_catalogue_what_is_hidden_is_named(diagram, tmp_path):
    """Supports that differ by 1500 N/m. A cubic spring: `test_a_cubic_spring_is_named_and_predicts_a_coast_down`."""
    found = diagnosed(diagram, run_up(tmp_path / "r", drawn(1, split=1500), 1, 0.8, "xy"), None)
    assert found.verdict == "missing_physics"
    assert [effect.physics for effect in found.effects] == ["anisotropic_support"]
