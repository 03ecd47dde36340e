"""Figures of ensembles show the numbers that were kept, with units and what did not finish."""

from __future__ import annotations

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from rotorsim.report.figures.ensemble import ensemble_figure
from rotorsim.simulation.ensemble.many import simulate_many
from rotorsim.simulation.ensemble.result import Ensemble

SIGNAL = "rotor.displacement"
SPEEDS = np.array([120.0, 160.0, 200.0])


@pytest.fixture(scope="module")
def grid() -> Ensemble:
    """Three speeds, each with four gains, of which the first makes the bearing unstable."""
    gains = np.array([-2e4, 1.2e4, 1.3e4, 1.4e4])
    values = {"speed": np.repeat(SPEEDS, 4), "controller.KP": np.tile(gains, 3)}
    kinds = ["peak", "radius", "poincare", "history"]
    return simulate_many(load("jeffcott"), values, stop=0.3, reduce=kinds)


@pytest.fixture(scope="module")
def line() -> Ensemble:
    return simulate_many(load("jeffcott"), {"speed": SPEEDS[::-1]}, stop=0.3, reduce=["harmonics=2", "peak"])


def test_a_curve_in_order_of_the_parameter_in_rpm_and_um(line: Ensemble) -> None:
    axes = ensemble_figure(line).axes[0]
    assert axes.get_xlabel() == "speed [rpm]"
    assert axes.get_ylabel() == "peak, 0-peak [um]"
    drawn = axes.get_lines()[0]
    assert np.asarray(drawn.get_xdata()) == pytest.approx(SPEEDS * 30 / np.pi)
    assert np.asarray(drawn.get_ydata()) == pytest.approx(line["peak", SIGNAL][::-1, 0] * 1e6)


def test_the_amplitude_of_1x(line: Ensemble) -> None:
    drawn = ensemble_figure(line, "curve", "controller.current[2]", "harmonics").axes[0].get_lines()
    assert len(drawn) == 1
    assert np.asarray(drawn[0].get_ydata()) == pytest.approx(
        np.abs(line["harmonics", "controller.current"][::-1, 1, 1])
    )


def test_a_map_marks_what_did_not_finish(grid: Ensemble) -> None:
    made = ensemble_figure(grid, "map", of="radius")
    axes = made.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("speed [rpm]", "controller.KP [A/m]")
    [mesh] = axes.collections
    values = np.ma.filled(np.ma.masked_invalid(mesh.get_array()), np.nan).reshape(4, 3)  # type: ignore[union-attr]
    assert np.isnan(values[0]).all()
    assert values[1:] == pytest.approx(grid["radius", SIGNAL].reshape(3, 4).T[1:] * 1e6)
    [marks] = axes.get_lines()
    assert marks.get_label() == "unstable"
    assert len(np.asarray(marks.get_xdata())) == 3
    assert "12 runs (3 unstable)" in made.get_suptitle()


def test_a_map_needs_a_grid_of_two(line: Ensemble, grid: Ensemble) -> None:
    with pytest.raises(RotorsimError, match="a map needs 2 parameters that vary"):
        ensemble_figure(line, "map")
    part = Ensemble(
        {name: values[:-1] for name, values in grid.parameters.items()},
        {"peak": {SIGNAL: grid["peak", SIGNAL][:-1]}},
        grid.status[:-1], grid.message[:-1], grid.step_error[:-1], grid.units, grid.shapes,
        grid.window[:-1], grid.stop[:-1], grid.step[:-1],
    )  # fmt: skip
    with pytest.raises(RotorsimError, match="the runs are no grid of two parameters"):
        ensemble_figure(part, "map")


def test_a_band_is_of_the_runs_that_finished(grid: Ensemble) -> None:
    axes = ensemble_figure(grid, "band", f"{SIGNAL}[1]", over="speed").axes[0]
    median = next(line for line in axes.get_lines() if line.get_label() == "median")
    expected = np.median(grid["peak", SIGNAL][:, 0].reshape(3, 4)[:, 1:], axis=1) * 1e6
    assert np.asarray(median.get_ydata()) == pytest.approx(expected)
    [band] = axes.collections
    assert band.get_label() == "5 to 95 %"
    low = [np.percentile(part, 5) for part in grid["peak", SIGNAL][:, 0].reshape(3, 4)[:, 1:] * 1e6]
    assert band.get_paths()[0].vertices[:, 1].min() == pytest.approx(min(low))  # type: ignore[index]


def test_a_distribution_where_nothing_lies_on_a_grid() -> None:
    masses = np.random.default_rng(1).normal(2.0, 0.05, 40)
    values = {"rotor.mass": masses, "controller.KP": 1.2e4 + 1e3 * masses}
    found = simulate_many(load("jeffcott"), values, stop=0.1)
    axes = ensemble_figure(found).axes[0]
    assert axes.get_ylabel() == "runs"
    assert sum(int(patch.get_height()) for patch in axes.patches) == 40  # type: ignore[attr-defined]


def test_a_bifurcation_diagram_has_every_point(grid: Ensemble) -> None:
    axes = ensemble_figure(grid, "bifurcation", f"{SIGNAL}[2]", over="speed").axes[0]
    points = np.asarray(axes.get_lines()[0].get_ydata())
    expected = grid["poincare", SIGNAL][grid.finished][:, :, 1].ravel() * 1e6
    assert np.sort(points[np.isfinite(points)]) == pytest.approx(np.sort(expected[np.isfinite(expected)]))
    assert axes.get_ylabel() == "[um]"


def test_a_cascade_has_its_line_at_the_shaft_frequency() -> None:
    found = simulate_many(load("jeffcott"), {"speed": SPEEDS}, turns=12, window=(4, 12), step=1e-3, reduce=["history"])
    axes = ensemble_figure(found).axes[0]
    spectra = [line for line in axes.get_lines() if len(np.asarray(line.get_xdata())) > 50]
    assert len(spectra) == 3
    for speed, spectrum in zip(SPEEDS[::-1], spectra, strict=True):
        frequency, height = np.asarray(spectrum.get_xdata()), np.asarray(spectrum.get_ydata())
        there = np.abs(frequency) > 1.0
        assert frequency[there][np.argmax(height[there])] == pytest.approx(speed / (2 * np.pi), rel=0.01)
    assert axes.get_xlabel() == "frequency [Hz], backward < 0 < forward"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("pie",), "error: kind: no figure 'pie'"),
        (("curve", "rotor.velocity"), "error: rotor.velocity: no peak of this signal was kept"),
        (("curve", "", "rms"), "error: of: 'rms' of one number was not kept\n\nhint: one of peak, harmonics"),
        (("curve", "", "", "sped"), "error: over: no parameter 'sped' varies\n\nhint: did you mean 'speed'?"),
        (("bifurcation",), "error: poincare: this was not kept of the runs"),
        (("cascade",), "error: history: this was not kept of the runs"),
    ],
)
def test_what_cannot_be_drawn_is_said(line: Ensemble, arguments: tuple[str, ...], said: str) -> None:
    with pytest.raises(RotorsimError) as error:
        ensemble_figure(line, *arguments)
    assert str(error.value).startswith(said)


def test_no_run_finished() -> None:
    found = simulate_many(load("jeffcott"), {"controller.KP": [-2e4, -3e4]}, stop=0.1, reduce=["peak", "history"])
    assert ensemble_figure(found, "curve").axes[0].get_lines()
    with pytest.raises(RotorsimError, match="no run finished"):
        ensemble_figure(found, "cascade")
