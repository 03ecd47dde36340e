"""Sensitivity studies: against what can be worked out by hand, the statistics of the noise, and the thesis."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from rotorsim.errors import RotorsimError
from rotorsim.identification.study.plan import Case, Study
from rotorsim.identification.study.printed import PRINTED_LEVELS, TABLES, misprints
from rotorsim.identification.study.questions import compare_controllers, smallest_rows, smallest_size
from rotorsim.identification.study.runs import Bench, bench_of, clean_runs
from rotorsim.identification.study.study import run_study, study_data, study_of_table, study_rows, write_rows
from rotorsim.model.load import load
from rotorsim.settled.periodic import periodic
from rotorsim.signals.harmonic_fit import Samples, fit_harmonics
from rotorsim.units import parse_quantity

RPM = np.pi / 30
FREE = (
    "viscous_damping",
    "crack_stiffness",
    "eccentricity",
    "unbalance_phase",
    "force_displacement_factor",
    "force_current_factor",
)
MISPRINTED = {
    ("2-5", "Delta k_22", 0.02),
    ("2-7", "k_s", 0.05),
    ("4-2", "k_I", 0.01),
    ("5-4", "k_L^x", 0.0),
    *(("5-3", "beta_2", level) for level in PRINTED_LEVELS),
    ("5-3", "beta_1", 0.0),
    *(("5-5", beta, level) for beta in ("beta_1", "beta_2") for level in PRINTED_LEVELS),
}


def study(*rpm: float, **changes) -> Study:
    fields = {"diagram": load("jeffcott").document, "speeds": tuple(n * RPM for n in rpm), "free": FREE}
    return Study(**(fields | {"seeds": 4} | changes))


def run(wanted: Study, **options):
    return run_study(wanted, scheduler="synchronous", **options)


# -- the tables --------------------------------------------------------------------------------------------------------


def test_printed_errors_are_those_of_printed_values_but_for_known_misprints():
    assert {(number, symbol, level) for number, symbol, level, _, _ in misprints()} == MISPRINTED


@pytest.mark.parametrize("number", TABLES)
def test_tables_agree_with_the_shipped_diagrams(number):
    table = TABLES[number]
    diagram = load(table.diagram)
    known = {item.name: item for item in diagram.free}
    for row in table.rows:
        assert known[row.parameter].value == pytest.approx(
            parse_quantity(f"{row.true} {row.unit}", known[row.parameter].unit)
        )
    assert len(table.speeds) == 9
    for names in table.groups.values():
        for name in names:
            block, _, key = name.partition(".")
            assert key in diagram.nodes[block].values


def test_study_of_a_table_is_complete():
    found = study_of_table("2-7", seeds=3)
    assert [str(case) for case in found.cases] == ["clean", "bias 1 %", "bias 2 %", "bias 5 %"]
    assert found.groups["mass"] == ("rotor.mass", "unbalance.mass")
    assert found.reduction == "exact"
    assert study_of_table("3-3").reduction == "central"
    kinds = [str(case) for case in study_of_table("2-5", noise=(0.0, 0.05)).cases]
    assert kinds == ["clean", "thesis 5 %", "uniform 5 %", "white 5 %"]


# -- what the estimates must be ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_without_noise_the_parameters_come_back():
    """From rest: what the integrator has not settled yet is a drift that the fit takes out, not exactly."""
    found = run(study_of_table("2-5", noise=(0.0,)))
    assert all(abs(row.mean_percent) < 0.01 for row in found.rows)
    assert found.estimates[Case("", 0.0, 0.0)].shape == (1, 6)  # nothing differs from seed to seed


@pytest.mark.slow
def test_settled_motion_is_that_of_harmonic_balance():
    diagram = load("jeffcott")
    speed = 1500 * RPM
    recording, (item,) = clean_runs(diagram, [speed], settled=True)
    motion = periodic(diagram, speeds=[speed])
    for column, name in enumerate(recording.channels):
        expected = [motion.harmonic(name, order)[0] for order in (1, 2, 3, 5)]
        assert item.fit.values[[1, 2, 3, 5], column] == pytest.approx(expected, rel=1e-9, abs=1e-15)
    assert all(abs(row.mean_percent) < 1e-4 for row in run(study(1140, 1500, settled=True)).rows)


@pytest.mark.slow
def test_wrong_sag_scales_the_crack_and_wrong_stiffness_moves_to_the_bearing():
    """Eq. (2.64): the crack enters as stiffness times sag, shaft and bearing stiffness as k - k_s."""
    level, seed = 0.05, 3
    draw = np.random.default_rng([seed, 0]).standard_normal()
    for name, parameter, expected in (
        ("crack.sag", "crack_stiffness", 3e5 / (1 + level * draw)),
        ("rotor.stiffness", "force_displacement_factor", 105210 + 7.6e5 * level * draw),
    ):
        clean, wrong = (
            bench_of(study(1140, 1380, 1620, groups={"one": (name,)}, bias=(level,)).text).solve(
                "white", 0.0, bias, seed
            )
            for bias in (0.0, level)
        )
        j = FREE.index(parameter)
        assert wrong["values"][j] == pytest.approx(expected, rel=1e-4)
        others = [k for k in range(6) if k != j]
        assert np.array(wrong["values"])[others] == pytest.approx(np.array(clean["values"])[others], rel=1e-6)


@pytest.mark.slow
def test_regression_on_white_noise_fails_in_the_upper_range():
    """Noise in the columns: k_s about -100 %, c about +30 %, k_i about -20 % at 5 %."""
    found = run(study_of_table("2-6", noise=(0.05,), kinds=("white",), seeds=12))
    case = found.study.cases[0]
    assert -140 < found.row("force_displacement_factor", case).mean_percent < -50
    assert 15 < found.row("viscous_damping", case).mean_percent < 45
    assert -30 < found.row("force_current_factor", case).mean_percent < -10


@pytest.mark.slow
def test_normal_noise_of_the_thesis_rescales_and_uniform_noise_does_not():
    """Eq. (2.67) has the mean r (1 - level / 2) with R ~ N(0, 1), and r with R uniform: so have the amplitudes."""
    found = run(study_of_table("2-5", noise=(0.05,), kinds=("thesis", "uniform"), seeds=10))
    thesis, uniform = found.study.cases
    for name in ("eccentricity", "crack_stiffness"):
        assert found.row(name, thesis).mean_percent == pytest.approx(-2.5, abs=0.1)
        assert abs(found.row(name, uniform).mean_percent) < 0.1


def test_harmonics_for_the_regression_are_those_of_the_fit():
    bench = Bench(study(1140, 1620, free=FREE))
    quick = bench.harmonics("white", 0.02, np.random.default_rng(5))
    random = np.random.default_rng(5)
    for item, found in zip(bench.clean, quick, strict=True):
        values = item.values + random.standard_normal(item.values.shape) * 0.02 * item.rms
        signals = dict(zip(bench.names, values.T, strict=True))
        fit = fit_harmonics(Samples("r", item.run.time, item.angle.theta, signals))
        assert not fit.lines
        assert found.fit.values == pytest.approx(fit.values, rel=1e-9, abs=1e-9 * np.abs(fit.values).max())


@pytest.mark.slow
def test_intervals_of_the_likelihood_cover_and_expected_scatter_is_seen():
    wanted = study(1140, 1380, 1620, noise=(0.02,), method="likelihood", seeds=24, profile=False)
    found = run(wanted)
    expected = bench_of(wanted.text).expected_std("white", 0.02)
    spread = found.estimates[wanted.cases[0]].std(axis=0, ddof=1)
    assert spread == pytest.approx(expected, rel=3 / np.sqrt(2 * 23))  # three standard deviations of a spread
    for row in found.rows:
        assert row.coverage >= 0.9 - 3 * np.sqrt(0.09 / 24)
        assert row.identified == 1.0


def test_angles_are_judged_as_angles():
    """An estimate a turn away is no error; of a true zero there is no percentage."""
    found = run(study(1140, 1500, free=(*FREE, "crack_phase"), noise=(0.01,), seeds=3))
    row = found.row("crack_phase", found.study.cases[0])
    assert row.rms_percent is None
    assert row.rms_error < np.radians(0.1)


# -- running -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_longer_study_resumes_from_the_store(tmp_path):
    store = tmp_path / "study.jsonl"
    short, long = (study(1140, 1500, noise=(0.0, 0.02), seeds=seeds) for seeds in (2, 4))
    run(short, store=store)
    assert len(store.read_text().splitlines()) == 3  # the clean case once
    found = run(long, store=store)
    assert len(store.read_text().splitlines()) == 5
    assert np.array_equal(found.estimates[long.cases[1]], run(long).estimates[long.cases[1]])


def test_data_and_files(tmp_path):
    found = run(study(1140, 1500, noise=(0.0, 0.02)))
    rows = study_rows(found)
    assert rows[1]["noise"] == 0.02
    assert rows[1]["seeds"] == 4
    assert rows[1]["coverage90"] is None
    write_rows(rows, json.loads(json.dumps(study_data(found))), tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text())["rows"] == rows
    write_rows(rows, None, tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0].startswith("parameter,unit,true,kind,noise")
    assert len(lines) == 13


@pytest.mark.slow
def test_beam_models_run(tmp_path: Path):
    """All measured nodes, two discs, anisotropic supports; the condensation at one frequency as in the thesis."""
    found = run(study_of_table("5-3", speeds=(1560 * RPM, 2040 * RPM), noise=(0.0,)))
    assert len(found.rows) == 11
    assert all(abs(row.mean_percent) < 1 for row in found.rows)


def test_mistakes_are_said_at_once():
    with pytest.raises(RotorsimError) as caught:
        study(kinds=("pink",), noise=(2.0,), bias=(0.01,), method="guess", seeds=0, window=(5.0, 4.0))
    text = str(caught.value)
    for words in ("pink", "2 is no level of noise", "which known", "guess", "0 seeds", "window", "speeds"):
        assert words in text
    with pytest.raises(RotorsimError, match=r"no parameter 'rotor\.mas'"):
        bench_of(study(1140, groups={"m": ("rotor.mas",)}).text)
    with pytest.raises(RotorsimError, match="cannot be known wrongly"):
        bench_of(study(1140, groups={"m": ("rotor.viscous_damping",)}).text)
    with pytest.raises(RotorsimError, match="no table"):
        study_of_table("2-1")


def test_a_run_that_diverges_is_named():
    document = json.loads(json.dumps(load("jeffcott").document))
    document["blocks"]["controller"]["parameters"]["KP"] = "-30000 A/m"
    with pytest.raises(RotorsimError, match="run at 1140 rpm"):
        run(study(1140, diagram=document))


# -- questions ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_smallest_crack():
    wanted = study(1140, 1620, noise=(0.02, 0.05), seeds=10, free=(*FREE, "crack_phase"), profile=False)
    small, large = smallest_size(wanted, scheduler="synchronous")
    assert small.expected == pytest.approx((norm.ppf(0.95) + norm.ppf(0.9)) * small.std)
    assert large.expected == pytest.approx(2.5 * small.expected, rel=0.1)  # in proportion to the noise
    assert small.share >= 0.9
    assert small.size < 2 * small.expected
    assert small.left_out == ("crack_phase",)
    assert smallest_rows([small])[0]["taken_as_known"] == "crack_phase"
    with pytest.raises(RotorsimError, match="without noise"):
        smallest_size(study(1140))
    with pytest.raises(RotorsimError, match="not among"):
        smallest_size(study(1140, noise=(0.1,)), "crack")


@pytest.mark.slow
def test_controllers_are_compared():
    """Only the integral action tells the bearing's stiffness from the current's share in a regression."""
    found = compare_controllers(study(1140, 1620, noise=(0.02,), seeds=3), scheduler="synchronous")
    assert {"discrete_pid", "modal_pid", "state_space"} == set(found.left_out)
    case = Case("white", 0.02, 0.0)
    errors = {name: result.row("force_displacement_factor", case).rms_percent for name, result in found.results.items()}
    assert errors["pd"] > 10 * errors["pid"]
