"""Figures say what they show: units, titles, marks at the right place."""

import numpy as np
import pytest

from rotorsim.diagram import load
from rotorsim.errors import RotorsimError
from rotorsim.report.figures import orbit, overview, run_up_figure, save_figure, spectrum_figure, time_histories
from rotorsim.report.linear_figures import campbell_figure, sensitivity_figure
from rotorsim.simulate.campbell_diagram import campbell
from rotorsim.simulate.frequency import sensitivity
from rotorsim.simulate.run import simulate


@pytest.fixture(scope="module")
def result():
    return simulate(load("jeffcott"), stop=1.0)


def test_the_overview_has_units_and_a_title_with_the_speed(result):
    made = overview(result)
    assert made.get_suptitle() == "jeffcott, 1500 rpm"
    labels = {axes.get_ylabel() for axes in made.axes}
    assert {"[um]", "[um, 0-peak]", "y [um]", "[A]", "[A, 0-peak]"} <= labels


def test_the_spectrum_figure_shows_the_amplitudes_of_the_harmonics(result):
    made = spectrum_figure(result, "rotor.displacement")
    lines = made.axes[0].collections[0].get_segments()
    height = {round(float(line[0][0])): float(line[1][1]) for line in lines}
    assert height[1] == pytest.approx(3.18, rel=0.01)  # um, thesis Table 2-2
    assert height[2] == pytest.approx(2.00, rel=0.01)


def test_the_orbit_marks_every_turn_of_the_shaft(result):
    made = orbit(result, "rotor.displacement", turns=4)
    marks = made.axes[0].lines[1]
    assert len(marks.get_xdata()) == 4
    assert np.ptp(marks.get_xdata()) < 0.1  # um: the same place every turn


def test_a_run_up_figure_names_resonance_and_peak():
    made = run_up_figure(simulate(load("jeffcott_runup"), record_every=5), "rotor.displacement[1]")
    texts = [t.get_text() for t in made.axes[0].get_legend().get_texts()]
    assert texts[1].startswith("largest at 73")
    assert texts[1].endswith("um, 0-peak")
    assert made.axes[0].get_xlabel() == "speed [rpm]"


def test_campbell_and_sensitivity_figures_are_drawn(tmp_path):
    found = campbell(load("fe_rigid", without=["amb"]), np.linspace(0.0, 700.0, 15))
    made = campbell_figure(found, "fe_rigid")
    assert made.axes[0].get_ylabel() == "damped natural frequency [Hz]"
    save_figure(sensitivity_figure(sensitivity(load("jeffcott")), "jeffcott"), tmp_path / "s.png")
    assert (tmp_path / "s.png").stat().st_size > 10_000


def test_other_signals_are_drawn_against_time(result):
    made = time_histories(result, ["clock.theta"])
    assert made.axes[0].get_xlabel() == "time [s]"


def test_a_spectrum_without_the_shaft_angle_is_refused():
    found = simulate(load("jeffcott"), stop=0.1, record=["rotor.displacement"])
    with pytest.raises(RotorsimError):
        spectrum_figure(found, "rotor.displacement")
