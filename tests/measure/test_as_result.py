"""Runs of recordings as results, and harmonics of their two-axis signals by every method."""

from dataclasses import replace

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.measure import record as measuring
from rotorsim.measure.as_result import as_result, has_angle
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load as load_diagram
from rotorsim.signals.spectrum import harmonics
from rotorsim.signals.two_axis import SPECTRUM_METHODS, two_axis_harmonics, two_axis_names, whole_turns
from rotorsim.simulation.result import Result
from rotorsim.simulation.run import simulate
from tests.recordings import made

RATE = 5000.0
SPEED = 2 * np.pi * 25.3
RNG = np.random.default_rng(7)


def channel(axis: str | None = None, node: int | None = None, signal: str = "rotor.displacement", **more):
    entry = {"signal": signal, "axis": axis, "node": node, "unit": "um", **more}
    return {key: value for key, value in entry.items() if value is not None}


def recording(tmp_path, channels, tables, **changes):
    entry = made.run(**({"set": None} | changes))
    return made.load(tmp_path / "made", made.document(entry, channels=channels), {entry["file"]: tables})


def one(tmp_path, channels, tables, **changes) -> Result:
    found = recording(tmp_path, channels, tables, **changes)
    return as_result(found, found.runs[0])


def complaint(call) -> str:
    with pytest.raises(RotorsimError) as error:
        call()
    [problem] = error.value.problems
    return f"{problem.subject}: {problem.what} | {problem.hint}"


# --- a run as a result ---------------------------------------------------------------------------------------------


def test_channels_are_stacked_as_a_simulation_records_them(tmp_path) -> None:
    names = {"y3": ("y", 3), "x3": ("x", 3), "x1": ("x", 1), "y1": ("y", 1), "x5": ("x", 5)}
    tables = {name: RNG.normal(size=100) for name in [*names, "u"]}
    channels = {name: channel(*place) for name, place in names.items()}
    channels["u"] = channel(signal="drive.output", unit="mV")
    result = one(tmp_path, channels, tables)
    displacement = result["rotor.displacement"]
    assert displacement.shape == (100, 5, 2)
    for name, (axis, node) in names.items():
        np.testing.assert_allclose(displacement[:, node - 1, "xy".index(axis)], tables[name] * 1e-6, rtol=1e-15)
    assert np.isnan(displacement[:, [1, 3]]).all()
    assert np.isnan(displacement[:, 4, 1]).all()
    np.testing.assert_allclose(result["drive.output"], tables["u"] * 1e-3, rtol=1e-15)
    assert (result.unit("rotor.displacement[3]"), result.unit("drive.output")) == ("m", "V")
    assert two_axis_names(result) == ["rotor.displacement[1]", "rotor.displacement[3]"]


@pytest.mark.parametrize(
    ("unit", "si"),
    [("um", "m"), ("mil", "m"), ("mA", "A"), ("mm/s", "m/s"), ("%", "1"), ("N s/m", "N s/m"), ("kN/A", "m kg/s^2/A")],
)
def test_units_are_those_of_the_numbers(tmp_path, unit: str, si: str) -> None:
    result = one(tmp_path, {"u": channel(signal="drive.output", unit=unit)}, {"u": np.arange(9.0)})
    assert result.unit("drive.output") == si


def test_a_place_along_the_shaft_stays_in_the_name(tmp_path) -> None:
    channels = {"a": channel("x", position="0.25 m"), "b": channel("y", position="0.25 m"), "c": channel("x", 1)}
    channels["c"]["signal"] = "rotor.velocity"
    channels["c"]["unit"] = "mm/s"
    tables = {name: RNG.normal(size=250) for name in channels}
    result = one(tmp_path, channels, tables)
    np.testing.assert_allclose(result["rotor.displacement[0.25 m]"][:, 1], tables["b"] * 1e-6)
    np.testing.assert_allclose(result.column("rotor.displacement[0.25 m,2]"), tables["b"] * 1e-6)
    assert result["rotor.velocity"].shape == (250, 1, 2)
    assert two_axis_names(result) == ["rotor.displacement[0.25 m]"]
    assert two_axis_harmonics(result, "rotor.displacement[0.25 m]", window=None).turns < 2


def test_parts_that_make_no_signal(tmp_path) -> None:
    channels = {"x": channel("x"), "x3": channel("x", 3)}
    tables = {"x": np.arange(50.0), "x3": np.arange(50.0)}
    assert complaint(lambda: one(tmp_path, channels, tables)) == (
        "rotor.displacement: columns x, x3 cannot be parts of one signal: some say node or axis, others do not | "
        "give all of them axis, and node where there are several"
    )
    channels = {"x": channel("x", 1), "x3": channel("x", 1_000_000)}
    tables = {"x": np.arange(5000.0), "x3": np.arange(5000.0)}
    assert complaint(lambda: one(tmp_path, channels, tables)) == (
        "rotor.displacement: 1000000 x 2 entries of 5000 samples would take 80 GB | "
        "number the nodes from 1 without large gaps"
    )


def test_the_angle_is_the_measured_one(tmp_path) -> None:
    table = made.samples()
    by_pulses = one(tmp_path, made.CHANNELS, table)
    theta = SPEED * by_pulses.time + 0.3 - 2 * np.pi  # zero at the first pulse
    np.testing.assert_allclose(by_pulses["clock.theta"], theta, atol=1e-9)
    channels = made.CHANNELS | {"angle": {"signal": "clock.theta", "unit": "deg"}}
    wrapped = np.degrees(theta) % 360.0
    measured = one(tmp_path, channels, table | {"angle": wrapped}, tacho=None, speed=None)
    np.testing.assert_allclose(np.exp(1j * measured["clock.theta"]), np.exp(1j * theta), atol=1e-9)
    assert np.all(np.diff(measured["clock.theta"]) > 0)


@pytest.mark.parametrize("changes", [{"tacho": None, "speed": None}, {"tacho": [], "speed": 0.0}])
def test_without_an_angle_there_is_none(tmp_path, changes) -> None:
    found = recording(tmp_path, made.CHANNELS, made.samples(), **changes)
    assert not has_angle(found, found.runs[0])
    assert "clock.theta" not in as_result(found, found.runs[0])


def test_time_in_few_digits_is_made_even(tmp_path) -> None:
    n = 3000
    time = np.arange(n) / 5120.0  # 0.1953125 ms
    table = {"x": np.sin(time), "y": np.cos(time), "t": np.round(time, 6)}
    channels = {key: made.CHANNELS[key] for key in "xy"}
    result = one(tmp_path, channels, table, sample_rate=None, time="t")
    assert np.ptp(np.diff(result.time)) < 1e-12
    np.testing.assert_allclose(result.time, time, atol=1e-6)
    table["t"] = time + 1e-4 * RNG.uniform(size=n)
    uneven = one(tmp_path, channels, table, sample_rate=None, time="t")
    np.testing.assert_array_equal(uneven.time, table["t"])


# --- harmonics -----------------------------------------------------------------------------------------------------

PARTS = {-5: 0.3e-6 * np.exp(2j), -1: 0.8e-6 * np.exp(-0.7j), 0: 1e-6 + 0.2e-6j, 1: 3e-6 * np.exp(0.14j), 3: 1e-6j}


def whirl(speed: float = SPEED, n: int = 5000, noise: float = 0.0, seed: int = 0, parts=PARTS, start: float = 0.0):
    time = start + np.arange(n) / RATE
    theta = speed * (time - start) + 0.4
    r = sum(value * np.exp(1j * k * theta) for k, value in parts.items())
    random = np.random.default_rng(seed)
    r = r + noise * (random.normal(size=n) + 1j * random.normal(size=n))
    units = {"rotor.displacement": "m", "clock.theta": "rad"}
    return Result(time, {"rotor.displacement": np.stack([r.real, r.imag], -1), "clock.theta": theta}, units)


@pytest.mark.parametrize("method", SPECTRUM_METHODS)
@pytest.mark.parametrize("speed", [2 * np.pi * 25.0, -2 * np.pi * 25.0])
@pytest.mark.parametrize("start", [0.0, -0.4])
def test_every_method_finds_a_whirl_of_whole_turns(method: str, speed: float, start: float) -> None:
    found = two_axis_harmonics(whirl(speed, start=start), "rotor.displacement", method)
    assert list(found.harmonics.orders) == sorted(found.harmonics.orders)
    for k, value in zip(found.harmonics.orders, found.harmonics.values, strict=True):
        assert value == pytest.approx(PARTS.get(k, 0.0), abs=1e-15)
    assert found.turns == pytest.approx(25)
    assert np.all(found.error < 1e-8)
    assert found.lines == ()


def test_least_squares_need_no_whole_turns() -> None:
    result = whirl(2 * np.pi * 25.37, n=4321)
    found = two_axis_harmonics(result, "rotor.displacement")
    for k, value in zip(found.harmonics.orders, found.harmonics.values, strict=True):
        assert value == pytest.approx(PARTS.get(k, 0.0), abs=1e-14)
    by_fft = two_axis_harmonics(result, "rotor.displacement", "fft")
    assert abs(by_fft.harmonics[1] - PARTS[1]) < 2e-3 * abs(PARTS[1])


@pytest.mark.parametrize("runs", [30, pytest.param(200, marks=pytest.mark.slow)])
def test_intervals_hold_what_they_promise(runs: int) -> None:
    """90 % of the intervals of amplitude and phase hold the truth, within 3 standard deviations."""
    hits, zeros = np.zeros(4), 0
    for seed in range(runs):
        result = whirl(2 * np.pi * 25.37, n=900, noise=1e-7, seed=seed)
        found = two_axis_harmonics(result, "rotor.displacement")
        at = {k: j for j, k in enumerate(found.harmonics.orders)}
        for j, k in enumerate((1, -1)):
            value, truth = found.harmonics[k], PARTS[k]
            hits[2 * j] += abs(abs(value) - abs(truth)) <= found.amplitude90[at[k]]
            hits[2 * j + 1] += abs(np.angle(value / truth)) <= found.phase90[at[k]]
        zeros += found.significant[at[7]]
        assert found.significant[[at[k] for k in PARTS]].all()
    assert np.all(np.abs(hits / runs - 0.9) < 3 * np.sqrt(0.9 * 0.1 / runs)), hits
    assert zeros <= 3 * runs / 200  # 0.2 expected of 200


def test_a_line_that_does_not_follow_the_shaft_is_found_with_both_whirls() -> None:
    result = whirl(noise=1e-8)
    t = result.time
    r = 4e-7 * np.exp(2j * np.pi * 61.7 * t + 1j) + 1e-7 * np.exp(-2j * np.pi * 61.7 * t)
    values = result["rotor.displacement"] + np.stack([r.real, r.imag], -1)
    found = two_axis_harmonics(
        replace(result, signals={**result.signals, "rotor.displacement": values}), "rotor.displacement"
    )
    [line] = found.lines
    assert line.frequency == pytest.approx(61.7, abs=0.02)
    assert line.order == pytest.approx(61.7 / 25.3, abs=1e-3)
    assert (line.forward, line.backward) == (pytest.approx(4e-7, rel=0.02), pytest.approx(1e-7, rel=0.05))
    assert abs(found.harmonics[1] - PARTS[1]) < 1e-9


def test_a_mean_that_means_nothing_is_left_out() -> None:
    for method in SPECTRUM_METHODS:
        found = two_axis_harmonics(whirl(2 * np.pi * 25.0), "rotor.displacement", method, use_mean=False)
        assert 0 not in found.harmonics.orders
        assert found.harmonics[1] == pytest.approx(PARTS[1], abs=1e-14)
        assert np.all(found.error < 1e-8)


def test_reconstruction_error_is_what_noise_leaves() -> None:
    noise = 2e-7
    result = whirl(noise=noise)
    rms = np.sqrt(np.mean(result["rotor.displacement"] ** 2, axis=0))
    for method in ("least-squares", "regression"):
        found = two_axis_harmonics(result, "rotor.displacement", method)
        np.testing.assert_allclose(found.error, noise / rms, rtol=0.05)  # 5000 samples: 1 % is one std


def test_whole_turns_take_whole_samples() -> None:
    """At 25.37 Hz and 5 kHz, 10 turns of 15 are the nearest to whole samples: 1970.83 ... by brute force."""
    result = whirl(2 * np.pi * 25.37, n=3000)
    start, stop = whole_turns(result)
    count = int(np.sum((result.time >= start) & (result.time < stop)))
    per_turn = RATE / 25.37
    best = min(range(8, 16), key=lambda turns: (round(abs(turns * per_turn - round(turns * per_turn)), 6), -turns))
    assert count == round(best * per_turn)
    assert stop == pytest.approx(3000 / RATE, abs=1 / RATE)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (
            lambda r: two_axis_harmonics(r, "rotor.displacement", "dft"),
            "rotor.displacement: unknown method 'dft' | one of least-squares, fft, regression",
        ),
        (
            lambda r: two_axis_harmonics(r, "rotor.displacement", window=(3.0, 4.0)),
            ": window 3..4 s holds 0 samples | the run covers 0..0.9998 s",
        ),
        (
            lambda r: two_axis_harmonics(r, "rotor.displacement", "fft", window=(0.0, 0.01)),
            ": only 0.253 turns of the shaft in 0..0.0098 s | harmonics need at least one turn",
        ),
        (
            lambda r: two_axis_harmonics(r, "rotor.displacement", window=(0.0, 0.01)),
            "run : only 0.248 turns of the shaft were recorded | harmonics need at least one turn",
        ),
        (
            lambda r: two_axis_harmonics(r, "clock.theta"),
            "clock.theta: not a two-axis signal | its last dimension must be [x, y]",
        ),
    ],
)
def test_mistakes(call, text: str) -> None:
    assert complaint(lambda: call(whirl())) == text


# --- simulated measurements ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def jeffcott():
    return compile_diagram(load_diagram("jeffcott"))


@pytest.mark.parametrize(
    ("name", "rates"), [("jeffcott", (1e4, 2e4)), pytest.param("fe_flexible", (2e4, 4e4), marks=pytest.mark.slow)]
)
def test_a_settled_start_returns_after_one_turn(name: str, rates) -> None:
    """What a turn changes is the error of RK4 alone: half the step, a sixteenth of it."""
    model = compile_diagram(load_diagram(name))
    speed = 2 * np.pi * 25.0
    changes = []
    for rate in rates:
        step = min(1 / rate, model.diagram.solver.step)
        signals = ["rotor.displacement"]
        result = measuring.measure(
            model, signals, "clock.theta", window=(0.0, 0.08), rate=rate, speed=speed, settle=True
        )
        turn = round(0.04 * rate)
        first, then = result["rotor.displacement"][:turn], result["rotor.displacement"][turn : 2 * turn]
        changes.append(np.abs(then - first).max() / np.abs(first).max())
        assert changes[-1] < 1e-6
    if step == 1 / rate:
        assert changes[0] / changes[1] == pytest.approx(16, rel=0.05)
    unsettled = simulate(model, parameters={"speed": speed}, stop=0.08, record=["rotor.displacement"])
    assert np.abs(unsettled["rotor.displacement"][0] - first[0]).max() > 0.1 * np.abs(first).max()


@pytest.mark.parametrize(
    ("rate", "step", "every"),
    [(None, 1e-4, 1), (5000.0, 1e-4, 2), (1e4, 1e-4, 1), (3000.0, 1 / 12000, 4), (25600.0, 1 / 25600, 1)],
)
def test_the_step_divides_the_sampling_interval(jeffcott, rate, step, every) -> None:
    assert measuring.steps_of(jeffcott, rate) == (pytest.approx(step, rel=1e-14), every)
    assert step <= jeffcott.diagram.solver.step


def test_a_window_is_kept_with_its_angle(jeffcott) -> None:
    result = measuring.measure(jeffcott, ["rotor.displacement"], "clock.theta", window=(0.2, 0.3), rate=5000.0)
    assert (result.time[0], result.time[-1], len(result.time)) == (pytest.approx(0.2), pytest.approx(0.3), 501)
    np.testing.assert_allclose(result["clock.theta"], 50 * np.pi * result.time, rtol=1e-12)
    whole = simulate(jeffcott, stop=0.3)
    np.testing.assert_array_equal(result["rotor.displacement"], whole["rotor.displacement"][2000::2])
    half_open = measuring.measure(
        jeffcott, ["rotor.displacement"], "clock.theta", window=(0.2, 0.3), rate=5000.0, closed=False
    )
    np.testing.assert_array_equal(half_open.time, result.time[:-1])


@pytest.mark.parametrize("settle", [False, True])
def test_other_parameters_are_those_of_a_diagram_that_has_them(settle: bool) -> None:
    gains = {"controller.KP": 14000.0, "controller.KD": 4.0}
    options = {"window": (0.0, 0.05), "speed": 40 * np.pi, "settle": settle}
    results = [
        measuring.measure(
            compile_diagram(load_diagram("jeffcott", set=given)),
            ["controller.current"],
            "clock.theta",
            parameters=known,
            **options,
        )
        for given, known in ((gains, None), ({}, gains), ({}, None))
    ]
    has, told, other = (result["controller.current"] for result in results)
    np.testing.assert_array_equal(told, has)
    assert np.abs(other - has).max() > 0.01 * np.abs(has).max()


def test_noise_is_what_it_is_called() -> None:
    clean = whirl(n=100_000)
    white = measuring.noisy(clean, measuring.Noise(0.05))
    added = white["rotor.displacement"] - clean["rotor.displacement"]
    scale = 0.05 * clean["rotor.displacement"].std(axis=0)
    np.testing.assert_allclose(added.std(axis=0), scale, rtol=0.01)  # 1 / sqrt(2 n) = 0.2 %
    assert np.all(np.abs(added.mean(axis=0)) < 4 * scale / np.sqrt(100_000))
    assert abs(np.corrcoef(added.T)[0, 1]) < 0.02
    np.testing.assert_array_equal(white["clock.theta"], clean["clock.theta"])
    thesis = measuring.noisy(clean, measuring.Noise(0.05, "thesis"))
    ratio = thesis["rotor.displacement"] / clean["rotor.displacement"]
    np.testing.assert_allclose(ratio.mean(axis=0), 1 - 0.025, atol=4 * 0.05 / np.sqrt(100_000))
    np.testing.assert_allclose(ratio.std(axis=0), 0.05, rtol=0.01)
    uniform = measuring.noisy(clean, measuring.Noise(0.05, "uniform"))
    ratio = uniform["rotor.displacement"] / clean["rotor.displacement"]
    np.testing.assert_allclose(ratio.mean(axis=0), 1, atol=4 * 0.05 / np.sqrt(12 * 100_000))
    np.testing.assert_allclose(ratio.std(axis=0), 0.05 / np.sqrt(12), rtol=0.01)
    assert np.abs(ratio - 1).max() <= 0.025 * (1 + 1e-12)


def test_noise_depends_on_seed_and_run_alone() -> None:
    clean = whirl(n=100)
    same = [
        measuring.noisy(clean, measuring.Noise(0.1, seed=seed), run) for seed, run in ((1, 0), (1, 0), (1, 1), (2, 0))
    ]
    arrays = [item["rotor.displacement"] for item in same]
    np.testing.assert_array_equal(arrays[0], arrays[1])
    for k, one_of in enumerate(arrays[1:]):
        for other in arrays[k + 2 :]:
            assert not np.array_equal(one_of, other)


@pytest.mark.parametrize(
    ("changes", "text", "code"),
    [
        (
            {"window": (0.0, 1e-5)},
            "jeffcott: window 0..1e-05 s holds 1 sample of 0.0001 s | a longer window, or a higher rate",
            2,
        ),
        ({"settle": True, "speed": 0.0}, "jeffcott at 0 rpm: a settled start needs a speed above zero | ", 2),
    ],
)
def test_measurements_that_cannot_be(jeffcott, changes, text: str, code: int) -> None:
    options = {"window": (0.0, 0.1)} | changes
    with pytest.raises(RotorsimError) as error:
        measuring.measure(jeffcott, ["rotor.displacement"], "clock.theta", **options)
    [problem] = error.value.problems
    assert (f"{problem.subject}: {problem.what} | {problem.hint}", error.value.exit_code) == (text, code)


def test_measured_harmonics_are_those_of_the_simulation(tmp_path, jeffcott) -> None:
    """The way through a file, pulses and a fit agrees with the fit of the simulation to its exact angle."""
    from rotorsim.recordings.loading import load_recording
    from rotorsim.recordings.writing import NewRun, save_recording

    result = measuring.measure(jeffcott, ["rotor.displacement"], "clock.theta", window=(0.0, 1.0), settle=True)
    path = save_recording(tmp_path / "r", [NewRun("a", result)], name="n", source="s", signals=["rotor.displacement"])
    found = load_recording(path)
    measured = two_axis_harmonics(as_result(found, found.runs[0]), "rotor.displacement")
    exact = harmonics(result, "rotor.displacement", range(-16, 17), window=(0.0, 1.0))
    for k in range(-9, 10):
        assert abs(measured.harmonics[k] - exact[k]) < 1e-6 * abs(exact[1])
