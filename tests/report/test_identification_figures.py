"""Figures of an identification: what is drawn are the numbers of an independent solution, with units and names."""

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from click.testing import CliRunner

from rotorsim.cli.app import rotorsim
from rotorsim.errors import Place
from rotorsim.identification.identification import identify
from rotorsim.model.load import load
from rotorsim.recordings.recording import Channel, Recording, Run
from rotorsim.report.comparison.speed_curves import speed_curve
from rotorsim.report.figures.orbits import orbits_figure
from rotorsim.report.figures.spectra import spectra_figure
from rotorsim.report.figures.speed_curves import speed_curves_figure
from rotorsim.report.identification.figures import save_figures
from rotorsim.report.identification.harmonics import compare
from rotorsim.report.identification.parameters import correlation_figure, parameters_figure
from rotorsim.report.style import BLUE, GREY, INK, RED
from rotorsim.settled.periodic import periodic
from tests.recordings import made as written

RPM = np.pi / 30
TRUE = {"crack_stiffness": 2.5e5, "eccentricity": 26e-6, "unbalance_phase": 0.8, "force_current_factor": 41.0}
GAINS = {"A": {"controller.KP": 12200.0, "controller.KD": 3.0}, "B": {"controller.KP": 9000.0, "controller.KD": 4.5}}
PLAN = (("A", 600.0), ("A", 1500.0), ("A", 2900.0), ("B", 1500.0), ("B", 2500.0))  # gains, rpm
SIGMA = {"rotor.displacement": 3e-8, "controller.current": 3e-4}  # of the noise
RATE, SAMPLES = 4000.0, 2000
CHANNELS = {
    column: Channel(column, signal, column[-1], None, None, unit)
    for signal, unit, columns in (("rotor.displacement", "m", "x y"), ("controller.current", "A", "ix iy"))
    for column in columns.split()
}
LABEL = "KP = 12200 A/m, KD = 3 A s/m"


def harmonics(gains: str, speeds: np.ndarray, signal: str, orders: np.ndarray) -> np.ndarray:
    """Return the true harmonics R_k, (speeds, orders), from the solver of periodic motion."""
    found = periodic(load("jeffcott"), speeds=speeds, parameters={**TRUE, **GAINS[gains]}, stability=False)
    there = np.abs(orders) <= found.orders[-1]
    out = np.zeros((len(speeds), len(orders)), complex)
    out[:, there] = np.array([found.harmonic(signal, k) for k in orders[there]]).T
    return out


def measured_run(gains: str, speed: float, seed: int) -> Run:
    noise, time, orders = np.random.default_rng(seed), np.arange(SAMPLES) / RATE, np.arange(-16, 17)
    theta, values = speed * RPM * time + 1.0, {}
    for signal, (x, y) in (("rotor.displacement", ("x", "y")), ("controller.current", ("ix", "iy"))):
        R = harmonics(gains, np.array([speed * RPM]), signal, orders)[0]
        r = np.exp(1j * np.outer(theta, orders)) @ R
        values[x], values[y] = (part + noise.normal(0, SIGMA[signal], SAMPLES) for part in (r.real, r.imag))
    tacho = (2 * np.pi * np.arange(1, int(theta[-1] / (2 * np.pi)) + 1) - 1.0) / (speed * RPM)
    return Run(f"{gains}{speed:.0f}", "", time, values, speed * RPM, tacho, GAINS[gains], "identify", Place(""), RATE)


@pytest.fixture(scope="module")
def recording() -> Recording:
    runs = tuple(measured_run(gains, speed, k) for k, (gains, speed) in enumerate(PLAN))
    return Recording("bench", "made for a test", Path(), MappingProxyType(CHANNELS), runs)


@pytest.fixture(scope="module")
def diagram():
    whole = load("jeffcott")
    return replace(whole, free=tuple(item for item in whole.free if item.name in TRUE))


@pytest.fixture(scope="module")
def found(diagram, recording):
    return identify(diagram, recording)


@pytest.fixture(scope="module")
def compared(found, recording):
    return compare(found, recording)


@pytest.fixture(scope="module")
def runs(compared):
    return compared.runs


@pytest.mark.slow
def test_a_curve_leaves_out_what_is_rounding(runs):
    """The series of the crack has no fourth harmonic: a solver gives 1e-20 m there, with phases of no meaning."""
    group = next(iter(runs.groups))
    _, values = speed_curve(runs, group, runs.signals[0], np.array([1, 4]))
    assert np.isfinite(values[:, 0]).all()
    assert np.isnan(values[:, 1]).all()


def legend(made) -> list[str]:
    return [text.get_text() for text in made.legends[0].get_texts()]


def bars(container) -> tuple[np.ndarray, np.ndarray]:
    """Return values and half widths (upper) of error bars."""
    values = np.asarray(container.lines[0].get_ydata())
    tops = np.array([segment[1, 1] for segment in container.lines[2][0].get_segments()])
    return values, tops - values


@pytest.mark.slow
def test_the_command_writes_them(recording, tmp_path):
    runs = [
        written.run(
            id=run.id,
            file=f"{run.id}.npz",
            sample_rate=f"{RATE} Hz",
            speed=run.speed,
            tacho=run.tacho.tolist(),
            set=dict(run.settings),
        )
        for run in recording.runs
    ]
    tables = {f"{run.id}.npz": dict(run.values) for run in recording.runs}
    folder = written.write(tmp_path / "bench", written.document(*runs), tables)
    result = CliRunner().invoke(rotorsim, ["identify", "jeffcott", str(folder), "--out", str(tmp_path / "out")])
    assert result.exit_code in (0, 1), result.output
    for name in ("parameters", "correlation", "spectrum", "speed_curve", "orbits"):
        file = tmp_path / "out" / f"{name}.png"
        assert f"written: {file}" in result.stderr
        assert file.stat().st_size > 10_000


@pytest.mark.slow
def test_parameters_have_names_intervals_numbers_and_start_values(found, recording):
    made = parameters_figure(found, recording)
    axes, right = made.axes
    assert made.get_suptitle() == "Parameters, jeffcott identified from bench"
    assert [text.get_text() for text in axes.get_yticklabels()] == list(found.parameters)
    assert axes.get_xlabel().startswith("difference from the identified value [%]")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "identified, 90 % interval",
        "start value in the diagram",
        "wanted: \u00b15 %",
    ]
    lines = [line for line in axes.lines if len(line.get_xdata()) == 2 and line.get_color() == BLUE]
    starts = {item.name: item.value for item in found.free}
    marks = [line for line in axes.lines if line.get_color() == RED and len(line.get_xdata()) == 1]
    for k, item in enumerate(found.parameters.values()):
        scale = 1.0 if item.unit == "rad" else item.value
        assert lines[k].get_xdata() == pytest.approx([100 * (end - item.value) / scale for end in item.interval90])
        assert marks[k].get_xdata() == pytest.approx([100 * (starts[item.name] - item.value) / scale])
    numbers = [text.get_text() for text in right.get_yticklabels()]
    assert [number.split(" ", 3)[3] for number in numbers] == ["N/m", "um", "deg", "N/A"]
    item, number = found.parameters["eccentricity"], numbers[1].split()
    half = max(item.interval90[1] - item.value, item.value - item.interval90[0])
    assert float(number[2]) == pytest.approx(half * 1e6, rel=0.05)  # two digits
    assert float(number[0]) == pytest.approx(item.value * 1e6, abs=half * 1e6 / 10)


@pytest.mark.slow
def test_parameters_that_are_not_identified_are_grey(found):
    name = "eccentricity"
    item = replace(found.parameters[name], interval90=(-np.inf, np.inf))
    item = replace(item, verdict=replace(item.verdict, identifiable=False))
    axes, right = parameters_figure(replace(found, parameters={**found.parameters, name: item})).axes
    for side in (axes, right):
        assert [text.get_color() for text in side.get_yticklabels()] == [INK, GREY, INK, INK]
    assert "not identified" in [text.get_text() for text in axes.get_legend().get_texts()]


@pytest.mark.parametrize(
    ("value", "interval", "unit", "text"),
    [
        (24.5e-6, (24.49e-6, 24.51e-6), "m", "24.500 \u00b1 0.010 um"),
        (1.0, (0.9, 1.3), "1", "1.00 +0.30 \u22120.10"),
        (np.radians(-45.0), tuple(np.radians([-45.5, -44.5])), "rad", "\u221245.00 \u00b1 0.50 deg"),
        (123456.0, (122222.0, 124690.0), "N/m", "123500 \u00b1 1200 N/m"),
        (1e-30, (0.0, np.inf), "N/m", "0 N/m"),  # the search ended at its bound
        (0.0, (0.0, 0.0), "1", "0"),
    ],
)
def test_numbers_have_two_digits_of_their_uncertainty(found, value, interval, unit, text):
    item = replace(found.parameters["crack_stiffness"], value=value, interval90=interval, unit=unit)
    starts = () if text[0] != "0" else found.free
    made = parameters_figure(replace(found, parameters={"crack_stiffness": item}, free=starts))
    assert [label.get_text() for label in made.axes[1].get_yticklabels()] == [text]


def test_a_model_that_does_not_explain_the_data_is_said_so(found, recording):
    title = correlation_figure(replace(found, adequate=False, excess=2.8234), recording).get_suptitle()
    assert " ".join(title.split()).endswith("not explained by the model: residual variance 2.82 times the noise")


def test_correlation_shows_its_numbers(found, recording):
    axes = correlation_figure(found, recording).axes[0]
    m = len(found.parameters)
    for text in axes.texts:
        j, i = text.get_position()
        assert float(text.get_text().replace("\u2212", "-")) == pytest.approx(found.correlation[i, j], abs=0.006)
    assert len(axes.texts) == m * m - m
    assert [text.get_text() for text in axes.get_xticklabels()] == list(found.parameters)


def test_measured_harmonics_have_the_uncertainty_of_white_noise(runs):
    """Of n samples with noise of standard deviation s in x and y, R_k has s / sqrt(n) in every direction."""
    for signal in runs.signals:
        sigma = SIGMA[signal.title] / np.sqrt(SAMPLES)
        for r in range(len(PLAN)):
            one = runs.measured(r, signal)
            inner = np.abs(one.orders) > 2  # the drift of the mean is fitted along and costs the lowest orders
            assert one.noise[inner] == pytest.approx(np.sqrt(2 * np.log(20)) * sigma, rel=0.1)
            weak = inner & (np.abs(one.value) < 1e-3 * np.abs(one.value).max())  # no share of the shaft angle
            assert one.amplitude_std[weak] == pytest.approx(sigma, rel=0.1)
            strong = inner & (np.abs(one.value) > 20 * sigma)
            truth = harmonics(PLAN[r][0], np.array([PLAN[r][1] * RPM]), signal.title, one.orders)[0]
            off = np.abs(np.abs(one.value) - np.abs(truth)) / one.amplitude_std
            turned = np.abs(np.angle(one.value[strong] / truth[strong])) / one.phase_std[strong]
            assert off[strong].max() < 4.5
            assert turned.max() < 4.5


def test_an_uncertain_shaft_angle_turns_harmonics_but_does_not_change_their_size(found, compared, recording):
    jitter = 1e-2  # rad, of angle zero; harmonic k turns by k times that
    runs = tuple(replace(item, fit=replace(item.fit, angle_std=jitter)) for item in found.runs)
    signal, shaken = compared.signals[0], compare(replace(found, runs=runs), recording)
    before, after = compared.runs.measured(1, signal), shaken.runs.measured(1, signal)
    own = np.hypot(before.phase_std, np.abs(before.orders) * jitter)
    strong = np.abs(before.value) > 20 * before.noise
    assert {-3, -1, 1, 2} <= set(before.orders[strong])
    assert after.phase_std[strong] == pytest.approx(own[strong], rel=1e-3)
    assert after.amplitude_std == pytest.approx(before.amplitude_std, rel=1e-3)
    assert after.noise == pytest.approx(before.noise)


@pytest.mark.slow
def test_spectra_show_measured_and_predicted_harmonics(compared):
    made = spectra_figure(compared)
    assert legend(made) == ["noise alone (95 %)", "model", "residual, model", "measured, 90 % interval"]
    assert len(made.axes) == 8
    assert made.axes[0].get_title(loc="left") == f"rotor.displacement, 600 rpm, {LABEL}"
    assert made.axes[-2].get_xlabel() == "order of running speed (negative: backward)"
    ticks = [text.get_text() for text in made.axes[-1].get_xticklabels()]
    assert {"-3X", "0", "1X", "7X"} <= set(ticks)
    for k, axes in enumerate(made.axes):
        signal, r = compared.signals[k % 2], compared.runs.spread(4)[k // 2]
        factor = (1e6, 1.0)[k % 2]
        assert axes.get_ylabel() == ("[um, 0-peak]", "[A, 0-peak]")[k % 2]
        assert axes.get_yscale() == "log"
        values, half = bars(axes.containers[0])
        orders = axes.containers[0].lines[0].get_xdata().astype(int)
        one = compared.runs.measured(r, signal)
        place = np.searchsorted(one.orders, orders)
        assert values == pytest.approx(factor * np.abs(one.value[place]))
        assert half == pytest.approx(1.6449 * factor * one.amplitude_std[place], rel=1e-4)
        rings = next(line for line in axes.lines if line.get_label() == "model")
        truth = harmonics(PLAN[r][0], np.array([PLAN[r][1] * RPM]), signal.title, one.orders)[0]
        chosen = (np.abs(truth) > 20 * one.noise) & (one.orders != 0)  # the mean has no time to settle
        assert chosen.sum() >= 4
        assert np.asarray(rings.get_ydata())[chosen] == pytest.approx(factor * np.abs(truth[chosen]), rel=2e-3)


def test_chosen_runs_are_spread_over_speed_and_gains(runs):
    assert [PLAN[r] for r in runs.spread(4)] == [PLAN[0], PLAN[2], PLAN[3], PLAN[4]]
    assert len(runs.spread(9)) == 5


@pytest.mark.parametrize("which", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_curves_over_speed_are_those_of_the_true_rotor(compared, which):
    signal, factor = compared.signals[which], (1e6, 1.0)[which]
    made = speed_curves_figure(compared, signal=signal)
    count = len(made.axes) // 2
    assert legend(made) == [
        f"model, {LABEL}",
        "model, KP = 9000 A/m, KD = 4.5 A s/m",
        f"measured, 90 % interval, {LABEL}",
        "measured, 90 % interval, KP = 9000 A/m, KD = 4.5 A s/m",
    ]
    titles = [axes.get_title(loc="left") for axes in made.axes[:count]]
    assert titles[:2] == ["1X (forward)", "-1X (backward)"]
    assert made.axes[0].get_ylabel() == f"{signal.title}\n[{('um', 'A')[which]}, 0-peak]"
    assert made.axes[count].get_ylabel() == "phase [deg]"
    for k, title in enumerate(titles):
        order = np.array([int(title.partition("X")[0])])
        upper, lower = made.axes[k], made.axes[count + k]
        assert lower.get_xlabel() == "speed [rpm]"
        for gains, j in (("A", 0), ("B", 1)):
            lines = [[line for line in axes.lines if len(line.get_xdata()) > 20][j] for axes in (upper, lower)]
            speeds = np.asarray(lines[0].get_xdata())
            assert speeds[0] < 600 < 2900 < speeds[-1]
            truth = harmonics(gains, speeds[::7] * RPM, signal.title, order)[:, 0]
            phase = np.asarray(lines[1].get_ydata())
            assert np.asarray(lines[0].get_ydata())[::7] == pytest.approx(factor * np.abs(truth), rel=5e-3)
            turned = np.angle(np.exp(1j * np.radians(phase[::7])) / truth)
            assert np.abs(turned).max() < 5e-3
            assert np.abs(np.diff(phase)).max() < 90  # no jump of a turn
            at = upper.containers[j].lines[0].get_xdata()
            assert at == pytest.approx([speed for name, speed in PLAN if name == gains], rel=1e-4)
            for axes, line in zip((upper, lower), lines, strict=True):
                values, half = bars(axes.containers[j])
                between = np.abs(np.interp(at, speeds, line.get_ydata())) * 2e-3  # two points of the line
                assert (np.abs(values - np.interp(at, speeds, line.get_ydata())) < 2.7 * half + between).all()


def test_orbits_are_measured_and_predicted_with_their_start_and_direction(compared, runs):
    made = orbits_figure(compared)
    assert legend(made) == ["samples", "measured, synchronous", "model", "shaft angle zero"]
    assert made.get_suptitle() == "Orbits of rotor.displacement, jeffcott identified from bench"
    for axes, r in zip(made.axes, runs.spread(4), strict=True):
        assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_aspect()) == ("x [um]", "y [um]", 1.0)
        drawn = {line.get_label(): line.get_xdata() + 1j * line.get_ydata() for line in axes.lines}
        one = runs.measured(r, runs.signals[0])
        theta = np.linspace(0, 2 * np.pi, 721)
        orbit = 1e6 * np.exp(1j * np.outer(theta, one.orders)) @ one.value
        assert drawn["measured, synchronous"] == pytest.approx(orbit)
        assert drawn["shaft angle zero"] == pytest.approx(orbit[:1])
        assert np.abs(drawn["model"] - orbit).max() < 0.05
        x, y = (1e6 * runs.experiment.recording.runs[r].values[name] for name in "xy")
        assert drawn["samples"] == pytest.approx(x + 1j * y)
        (arrow,) = axes.texts
        tip, tail = complex(*arrow.xy), complex(*arrow.get_position())
        near = int(np.argmin(np.abs(orbit - tip)))
        ahead = orbit[(near + 5) % 720] - orbit[near]
        assert ((tip - tail) * ahead.conjugate()).real > 0


@pytest.mark.slow
def test_a_model_that_takes_measured_currents_has_no_line_between_the_runs(diagram, recording):
    chosen = replace(diagram, free=tuple(item for item in diagram.free if item.name != "force_current_factor"))
    compared = compare(identify(chosen, recording, given=["controller.current"]), recording)
    assert [signal.title for signal in compared.signals] == ["rotor.displacement"]
    axes = speed_curves_figure(compared).axes[0]
    models = [line for line in axes.lines if line.get_label().startswith("model")]
    assert [line.get_linestyle() for line in models] == ["None", "None"]
    points = np.concatenate([container.lines[0].get_ydata() for container in axes.containers])
    assert np.concatenate([line.get_ydata() for line in models]) == pytest.approx(points, rel=0.01)


@pytest.mark.slow
def test_one_run_has_no_curve_and_one_axis_no_orbit(diagram, recording, tmp_path):
    channels = {column: channel for column, channel in recording.channels.items() if column == "x"}
    run = replace(recording.runs[1], values={"x": recording.runs[1].values["x"]})
    single = replace(recording, channels=channels, runs=(run,))
    free = tuple(item for item in diagram.free if item.name == "crack_stiffness")
    found = identify(replace(diagram, free=free), single)
    compared = compare(found, single)
    runs, (signal,) = compared.runs, compared.signals
    assert (signal.title, signal.y, runs.orders(signal)[0]) == ("rotor.displacement, x", None, 0)
    c = runs.experiment.fits[0].values[:, 0]
    assert np.abs(runs.measured(0, signal).value) == pytest.approx(np.abs([c[0], *(2 * c[1:])]))
    made = spectra_figure(compared)
    assert (len(made.axes), made.axes[0].get_xlabel()) == (1, "order of running speed")
    assert made.axes[0].get_title(loc="left") == "rotor.displacement, x, 1500 rpm"
    names = [file.name for file in save_figures(found, single, tmp_path)]
    assert names == ["parameters.png", "correlation.png", "spectrum.png"]


def test_a_mean_that_is_not_measured_is_not_shown(diagram, recording):
    channels = {column: replace(channel, coupling="ac") for column, channel in recording.channels.items()}
    moved = tuple(replace(run, values={c: v + 1e-3 for c, v in run.values.items()}) for run in recording.runs[:2])
    alternating = replace(recording, channels=channels, runs=moved)
    compared = compare(identify(diagram, alternating), alternating)
    assert 0 not in compared.runs.orders(compared.signals[0])
    axes = orbits_figure(compared).axes[0]
    samples = next(line for line in axes.lines if line.get_label() == "samples")
    assert abs(samples.get_xdata().mean() + 1j * samples.get_ydata().mean()) < 1e-6
