"""Figures of linear analyses: curves, marks, zones and units are those of the numbers given."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from rotorsim.errors import RotorsimError
from rotorsim.linear.control.frequency import FrequencyResponse, frequency_response
from rotorsim.linear.control.margins import margins
from rotorsim.linear.modes.campbell import Campbell, Crossing, campbell
from rotorsim.model.load import load
from rotorsim.report.figures.linear import campbell_figure, frequency_response_figure, periodic_figure
from rotorsim.report.figures.margins import margins_figure
from rotorsim.report.figures.run import save_figure
from rotorsim.report.style import BLUE, ORANGE
from rotorsim.settled.result import Periodic

RPM = np.pi / 30


def drawn(made, path):
    save_figure(made, path)
    assert path.stat().st_size > 10_000
    return made


def legend(axes) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


@pytest.mark.slow
def test_a_campbell_diagram_of_the_rigid_rotor(tmp_path):
    found = campbell(load("fe_rigid", without=["amb"]), speeds=np.linspace(0.0, 1000.0, 21))
    axes = drawn(campbell_figure(found, "fe_rigid"), tmp_path / "c.png").axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("speed [rpm]", "damped natural frequency [Hz]")
    assert legend(axes) == ["backward", "forward", "critical speed [rpm]"]
    marks = {round(float(x)) for line in axes.lines if line.get_marker() == "o" for x in line.get_xdata()}
    assert marks == {round(float(c.speed / RPM)) for c in found.crossings}
    texts = [text.get_text() for text in axes.texts]
    assert {"3248", "3267"} <= set(texts)
    renderer = FigureCanvasAgg(axes.figure).get_renderer()
    axes.figure.canvas.draw()
    frames = [text.get_window_extent(renderer) for text in axes.texts if text.get_text().isdigit()]
    assert not any(one.overlaps(other) for k, one in enumerate(frames) for other in frames[:k])


def test_a_crossing_of_a_folded_mode_has_a_mark_of_its_own() -> None:
    speeds = np.array([0.0, 200.0, 400.0, 600.0])
    frequency = np.array([[30.0, 60.0]] * 4)
    sure = Crossing(1, 2 * np.pi * 30, 30.0, 1, "forward", 0.01)
    folded = Crossing(1, 2 * np.pi * 60, 60.0, 2, "forward", 0.01, modulo=2000.0)
    whirl = np.full((4, 2), "forward")
    found = Campbell(speeds, frequency, np.full((4, 2), 0.01), whirl, (sure, folded))
    axes = campbell_figure(found).axes[0]
    assert legend(axes) == ["forward", "critical speed [rpm]", "critical speed [rpm], frequency modulo 2000 Hz"]
    marks = {line.get_marker(): line.get_xdata().tolist() for line in axes.lines if line.get_marker() in "os"}
    assert marks == {"o": pytest.approx([1800.0]), "s": pytest.approx([3600.0])}


def test_whirl_that_changes_with_speed_changes_its_line():
    speeds = np.array([0.0, 100.0, 200.0, 300.0])
    whirl = np.array([["planar"], ["backward"], ["forward"], ["forward"]])
    crossings = (Crossing(1, 200.0, 31.8, 0, "forward", 0.01),)
    found = Campbell(speeds, np.array([[30.0], [31.0], [32.0], [33.0]]), np.zeros((4, 1)), whirl, crossings)
    axes = campbell_figure(found).axes[0]
    stretches = [(line.get_color(), list(np.round(line.get_xdata() * RPM))) for line in axes.lines[:2]]
    assert stretches == [(ORANGE, [0, 100]), (BLUE, [100, 200, 300])]


def test_modes_that_do_not_oscillate_leave_an_empty_diagram(tmp_path):
    nothing = np.full((2, 1), np.nan)
    found = Campbell(np.array([0.0, 100.0]), nothing, nothing, np.array([[""], [""]]), ())
    save_figure(campbell_figure(found, "rigid body"), tmp_path / "c.png")


@pytest.mark.slow
def test_a_frequency_response_has_magnitude_phase_and_unit(tmp_path):
    hz = np.geomspace(1, 1000, 200)
    found = frequency_response(load("jeffcott"), "controller.current", "rotor.displacement", frequencies=hz)
    made = drawn(frequency_response_figure(found, "jeffcott"), tmp_path / "f.png")
    upper, lower = made.axes
    assert upper.get_ylabel() == "magnitude [m/A]"
    assert (lower.get_ylabel(), lower.get_xlabel()) == ("phase [deg]", "frequency [Hz]")
    shown = [text.get_text() for text in made.legends[0].get_texts()]
    assert shown == [f"rotor.displacement[{k}] / controller.current[{k}] [m/A]" for k in (1, 2)]
    magnitude = np.asarray(upper.lines[0].get_ydata())
    phase = np.radians(np.asarray(lower.lines[0].get_ydata()))
    assert magnitude * np.exp(1j * phase) == pytest.approx(found.value[:, 0, 0], rel=1e-9)


@pytest.mark.slow
def test_of_many_entries_the_largest_are_drawn(tmp_path):
    """FAULT: of 36 the legend took two thirds of the figure."""
    hz = np.geomspace(5, 800, 100)
    found = frequency_response(load("two_amb_rotor"), "amb_a.force", "rotor.displacement", frequencies=hz)
    made = drawn(frequency_response_figure(found, "beam"), tmp_path / "f.png")
    assert made.get_suptitle() == "beam (the 8 largest of 36)"
    peaks = np.sort(np.abs(found.value).max(axis=0).ravel())[::-1]
    shown = sorted((np.max(line.get_ydata()) for line in made.axes[0].lines), reverse=True)
    assert shown == pytest.approx(peaks[:8])
    assert {tick % 90 for tick in made.axes[1].get_yticks()} == {0.0}


def test_phases_begin_within_half_a_turn():
    hz = np.array([1.0, 2.0, 3.0])
    value = np.exp(1j * np.radians([170.0, 250.0, 350.0]))[:, None, None]
    made = frequency_response_figure(FrequencyResponse(hz, value, ("y",), ("u",), (("1",),), False), "x")
    assert np.asarray(made.axes[1].lines[0].get_ydata()) == pytest.approx([170.0, 250.0, 350.0])
    assert made.get_suptitle() == "x (not stable: no settled response)"


@pytest.mark.slow
def test_the_sensitivity_is_drawn_over_the_zones_of_the_standard_and_the_open_loop_below(tmp_path):
    found = margins(load("jeffcott"))
    upper, middle, lower = drawn(margins_figure(found, "jeffcott"), tmp_path / "s.png").axes
    assert [text.get_text() for text in upper.texts] == ["A", "B", "C", "D"]
    axis = found.axes[0]
    assert legend(upper) == [
        *(f"controller.displacement[{k}]: peak 3.43 at 124 Hz, zone B" for k in (1, 2)),
        "largest singular value",
    ]
    assert np.asarray(upper.lines[0].get_ydata()).max() == pytest.approx(axis.peak, rel=1e-3)
    assert np.asarray(middle.lines[0].get_ydata()) == pytest.approx(np.abs(found.open_loop()[:, 0]))
    assert (lower.get_ylabel(), lower.get_xlabel()) == ("phase of G_o [deg]", "frequency [Hz]")


def periodic_of(orders: np.ndarray, stable: tuple[bool | None, ...] = (True, False, None)) -> Periodic:
    values = np.array([1e-6, 2e-6, 3e-6])[:, None] * (1 + np.arange(len(orders)))
    values[2] = np.nan
    status = ("settled", "settled", "failed: no solution")
    speeds = np.array([100.0, 200.0, 300.0])
    return Periodic(speeds, orders, {"r.d": values.astype(complex)}, {"r.d": "m"}, status, stable, *np.zeros((2, 3)))


@pytest.mark.slow
def test_harmonics_over_speed_are_found_by_their_order(tmp_path):
    halves = periodic_of(np.arange(-2, 2.5, 0.5))  # a period of two turns: -2, -1.5, ... 2
    made = drawn(periodic_figure(halves, "r.d", orders=(1, 0.5, 7)), tmp_path / "p.png")
    axes, phase = made.axes
    assert [text.get_text() for text in made.legends[0].get_texts()] == ["+1X", "+0.5X", "unstable"]
    assert np.asarray(axes.lines[0].get_ydata())[:2] == pytest.approx([7.0, 14.0])  # um: order 1 is the seventh
    assert np.isnan(np.asarray(axes.lines[0].get_ydata())[2])
    assert list(axes.lines[1].get_xdata() * RPM) == pytest.approx([200.0])
    assert (axes.get_ylabel(), axes.get_xlabel()) == ("amplitude [um, 0-peak]", "speed [rpm]")
    assert (phase.get_ylabel(), phase.get_xlabel(), phase.get_ylim()) == ("phase [deg]", "speed [rpm]", (-190, 190))


def test_every_two_axis_signal_has_amplitude_and_phase_and_rounding_is_not_drawn():
    orders, speeds = np.arange(-1, 3), np.array([100.0, 200.0, 300.0])
    turning = np.exp(1j * np.radians([170.0, -170.0, 90.0]))  # wraps between the first two
    pair = np.stack([1e-15 * turning, 0 * turning, 1e-5 * turning, 1e-9 * turning], axis=1)
    harmonics = {"r.d": pair, "r.d[1]": pair, "c.i": 1e6 * pair, "c.i[1]": pair}
    units = {"r.d": "m", "r.d[1]": "m", "c.i": "A", "c.i[1]": "A"}
    found = Periodic(speeds, orders, harmonics, units, ("settled",) * 3, (True,) * 3, *np.zeros((2, 3)))
    axes = periodic_figure(found).axes
    assert [axis.get_title("left") for axis in axes] == ["r.d", "", "c.i", ""]
    assert [axis.get_ylabel() for axis in axes[::2]] == ["amplitude [um, 0-peak]", "amplitude [A, 0-peak]"]
    for left, right in (axes[:2], axes[2:]):
        sizes = [np.asarray(line.get_ydata()) for line in left.lines[::2]]  # every other is the crosses
        assert np.isfinite(sizes[0]).all()
        assert np.isfinite(sizes[1]).all()
        assert np.isnan(sizes[2]).all()  # -1X: 1e-10 of the largest
        assert right.lines[0].get_ydata() == pytest.approx([170.0, np.nan, -170.0, np.nan, 90.0], nan_ok=True)


def test_a_signal_that_was_not_computed_is_refused():
    with pytest.raises(RotorsimError) as caught:
        periodic_figure(periodic_of(np.arange(-1.0, 2.0)), "r.e")
    assert str(caught.value) == "error: r.e: no such signal in this result\n\nhint: did you mean 'r.d'?"
