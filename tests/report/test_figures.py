"""Figures say what they show: units, titles, marks at the right place."""

import subprocess
import sys
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from rotorsim.report.figures.run import overview, save_figure, spectrum_figure, time_histories
from rotorsim.report.style import BLUE, ORANGE
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate


@pytest.fixture(scope="module")
def result():
    return simulate(load("jeffcott"), stop=1.0)


def drawn(made, path):
    """Save a figure, so that its ticks and layout are made too; return it."""
    save_figure(made, path)
    assert path.stat().st_size > 5_000
    return made


def legend(axes) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_the_overview_has_units_and_a_title_with_the_speed(result):
    made = overview(result)
    assert made.get_suptitle() == "jeffcott, 1500 rpm"
    labels = {axes.get_ylabel() for axes in made.axes}
    assert {"[um]", "[um, 0-peak]", "y [um]", "[A]", "[A, 0-peak]"} <= labels


def test_the_spectrum_figure_shows_the_amplitudes_of_the_harmonics(result):
    made = spectrum_figure(result, "rotor.displacement")
    lines = [line for drawn in made.axes[0].collections for line in drawn.get_segments()]
    height = {round(float(line[0][0])): float(line[1][1]) for line in lines}
    assert height[1] == pytest.approx(3.18, rel=0.01)  # um, thesis Table 2-2
    assert height[2] == pytest.approx(2.00, rel=0.01)


def test_the_orbit_marks_every_turn_of_the_shaft(result):
    marks = overview(result).axes[1].lines[1]
    assert len(marks.get_xdata()) == 4
    assert np.ptp(marks.get_xdata()) < 0.1  # um: the same place every turn


@pytest.mark.slow
def test_a_run_up_figure_names_resonances_and_peaks(tmp_path):
    result = simulate(load("jeffcott_runup"), record_every=5)
    made = drawn(overview(result), tmp_path / "r.png")
    texts = legend(made.axes[0])
    assert texts[:4] == ["each turn, 0-peak", "1X", "2X", "3X"]
    assert texts[4].startswith("1X at 73")
    assert texts[4].endswith("um, 0-peak")
    assert texts[5].startswith("2X at 36")
    assert texts[6].startswith("3X at 24")
    assert made.axes[0].get_xlabel() == "speed [rpm]"
    assert [axes.get_title("left") for axes in made.axes] == [
        "run-up: rotor.displacement[1], about its mean",
        "run-up: controller.current[1], about its mean",
    ]
    assert made.get_suptitle() == f"jeffcott_runup, 0 to {result['clock.speed'][-1] * 30 / np.pi:.0f} rpm"


def test_other_signals_are_drawn_against_time(result):
    made = time_histories(result, ["clock.theta"])
    assert made.axes[0].get_xlabel() == "time [s]"


def test_a_spectrum_without_a_turning_shaft_is_refused():
    found = simulate(load("jeffcott"), stop=0.1, record=["rotor.displacement"])
    still = replace(found, signals={**found.signals, "clock.theta": np.ones(len(found.time))})
    for result, text in (
        (found, "rotor.displacement: the shaft angle was not recorded\n\nhint: record clock.theta"),
        (still, "clock.theta: the shaft does not turn\n\nhint: set a speed other than zero"),
    ):
        with pytest.raises(RotorsimError) as caught:
            spectrum_figure(result, "rotor.displacement")
        assert str(caught.value) == f"error: {text}"
        assert [axes.get_title("left") for axes in overview(result).axes] == ["rotor.displacement"]  # time histories


def test_the_overview_shows_the_node_that_moves_most():
    result = simulate(load("fe_rigid"), stop=0.25, record_every=10)
    made = overview(result)
    motion = np.ptp(result["rotor.displacement"][len(result.time) // 2 :], axis=0).max(axis=1)
    assert made.axes[0].get_title("left") == f"rotor.displacement[{int(np.argmax(motion)) + 1}]"


@pytest.mark.slow
def test_every_panel_says_what_its_axes_are(result):
    for made in (overview(result), spectrum_figure(result, "controller.current")):
        for axes in made.axes:
            assert axes.get_ylabel()
        assert made.axes[-1].get_xlabel()
    assert overview(result).axes[1].get_aspect() == 1  # an orbit is not stretched


def test_marks_of_the_key_phasor_lie_between_samples():
    time = np.arange(1000) * 1e-3  # 7.3 Hz: theta = 0 falls between two samples
    theta = 2 * np.pi * 7.3 * time
    r = 1e-6 * np.exp(1j * (theta + 0.5))
    result = Result(time, {"r.d": np.column_stack([r.real, r.imag]), "clock.theta": theta}, {"r.d": "m"})
    marks = overview(result).axes[1].lines[1]
    places = np.asarray(marks.get_xdata()) + 1j * np.asarray(marks.get_ydata())
    assert places == pytest.approx(
        np.full(4, np.exp(0.5j)), abs=2.7e-4
    )  # below the arc between samples: 1 - cos(pi / 137)


def test_forward_whirl_is_with_the_shaft_also_when_it_turns_backward():
    time = np.arange(2000) * 1e-3
    theta = -2 * np.pi * 10 * time
    r = 2e-6 * np.exp(1j * theta) + 1e-6 * np.exp(-2j * theta)
    result = Result(time, {"r.d": np.column_stack([r.real, r.imag]), "drive.theta": theta}, {"r.d": "m"})
    made = spectrum_figure(result, "r.d")
    height = {}
    for lines in made.axes[0].collections:
        for segment in lines.get_segments():
            height[round(float(segment[0][0]))] = (
                float(segment[1][1]),
                mpl.colors.to_hex(lines.get_color()[0]).upper(),
            )
    assert height[1] == (pytest.approx(2.0, rel=1e-3), BLUE)
    assert height[-2] == (pytest.approx(1.0, rel=1e-3), ORANGE)
    assert made.get_suptitle() == "run, -600 rpm"


@pytest.mark.slow
def test_growth_without_bound_is_drawn_on_a_logarithmic_scale(tmp_path):
    result = simulate(load("jeffcott", set={"controller.KP": 0.0, "controller.KD": -50.0}), stop=3.0)
    assert result.status == "diverged"
    made = drawn(overview(result), tmp_path / "diverged.png")
    assert made.get_suptitle() == "jeffcott (diverged), 1500 rpm"
    axes = made.axes[0]
    assert axes.get_yscale() == "log"
    x = axes.lines[0]
    time, size = np.asarray(x.get_xdata()), np.asarray(x.get_ydata())
    kept = np.isfinite(size) & (time > 0.05)
    rate = np.polyfit(time[kept], np.log(size[kept]), 1)[0]
    assert rate == pytest.approx(507.3, rel=0.02)  # the pole that the message names
    assert "507.3 1/s" in result.message


@pytest.mark.slow
def test_short_and_empty_runs_are_drawn(tmp_path):
    for n in (0, 1, 5):
        values = {"r.d": np.ones((n, 2)), "clock.theta": np.arange(float(n))}
        drawn(overview(Result(np.arange(float(n)), values, {"r.d": "m"}, "stopped")), tmp_path / f"{n}.png")


@pytest.mark.slow
def test_figures_leave_matplotlib_as_it_was(result):
    before = dict(mpl.rcParams)
    overview(result)
    assert dict(mpl.rcParams) == before
    code = "import sys, rotorsim.report.figures.linear; print('matplotlib.pyplot' in sys.modules)"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "False"


@pytest.mark.parametrize("suffix", ["png", "svg", pytest.param("pdf", marks=pytest.mark.slow)])
def test_figures_are_written_whole(result, tmp_path, suffix):
    drawn(spectrum_figure(result, "rotor.displacement"), tmp_path / f"spectrum.{suffix}")
    assert [path.name for path in tmp_path.iterdir()] == [f"spectrum.{suffix}"]
