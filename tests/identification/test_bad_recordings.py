"""Recordings as they should not be: an error or a warning that names it, and never a wrong number said to be sure."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.identification.harmonic.estimate import Search, estimate
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.identification.identification import identify
from rotorsim.identification.result import Identification
from rotorsim.recordings.loading import load_recording
from rotorsim.recordings.recording import Recording
from tests.identification import changed, errors, made, recorded, shipped
from tests.identification.test_likelihood import likelihood_of, two_gains
from tests.reference.recordings import LOWER, RecordedRun, write_recording

SPEEDS = LOWER["jeffcott"][::8]
RUNS = two_gains("jeffcott", SPEEDS, level=0.005, duration=0.5)  # two speeds with two sets of gains
Edit = Callable[[dict[str, Any]], Any]
Change = Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]
SLOW = pytest.mark.slow
BOTH = pytest.mark.parametrize("method", ["likelihood", "regression"])


def on_disk(
    folder: Path,
    edit: Edit | None = None,
    change: Change | None = None,
    *,
    runs: list[RecordedRun] = RUNS,
    angle: str = "tacho",
    use: str = "identify",
) -> Recording:
    """Write the runs, edit recording.json and the tables, and load them."""
    path = write_recording(folder, runs, "made", use, angle=angle)
    document = json.loads(path.read_text())
    if edit is not None:
        edit(document)
    path.write_text(json.dumps(document, indent=1))
    for entry in json.loads(path.read_text())["runs"] if change is not None else ():
        with np.load(folder / entry["file"]) as table:
            np.savez(folder / entry["file"], **change(dict(table)))  # type: ignore[misc]
    return load_recording(folder)


def each(edit: Callable[[dict[str, Any]], Any]) -> Edit:
    """Return an edit of every run."""
    return lambda document: [edit(run) for run in document["runs"]]


def found(recording: Recording, method: str = "likelihood", diagram: Diagram | None = None, **named) -> Identification:
    return identify(diagram or shipped("jeffcott"), recording, method=method, profile=False, **named)


def refusal(folder: Path, edit: Edit | None = None, change: Change | None = None, **named: Any) -> list[str]:
    """Return the problems, the folder left out of the text; both methods have the same."""
    said = []
    opened = cache(lambda: on_disk(folder, edit, change, **named))
    for method in ("likelihood", "regression"):
        with pytest.raises(RotorsimError) as error:
            found(opened(), method)
        said.append([f"{p.subject}: {p.what}" for p in error.value.problems if p.severity == "error"])
        assert error.value.exit_code in (1, 2)  # the data are at fault, or what is said about them
    assert said[0] == said[1]
    return said[0]


def nothing_wrong_is_sure(item: Identification, off: float = 0.1) -> None:
    """Adequate: then nothing identified is off by more than 10 %; or not adequate."""
    wrong = {
        name: error
        for name, error in errors(item).items()
        if error > off and item.parameters[name].verdict.identifiable
    }
    assert not item.adequate or not wrong


# --- refused ----------------------------------------------------------------------------------------------------------

NO_PHASE = "no phase reference: nothing says where shaft angle zero is"


def cut(n: int) -> Change:
    return lambda table: {column: values[:n] for column, values in table.items()}


def first_tacho(n: int) -> Edit:
    return each(lambda run: run.update(tacho=run["tacho"][:n]))


@pytest.mark.parametrize(
    ("edit", "change", "expected"),
    [
        (None, cut(0), ["run00: empty run: 0 samples"]),
        (None, cut(1), ["run00: empty run: 1 sample"]),
        (each(lambda run: run.pop("tacho")), None, [f"run run00: {NO_PHASE}", f"run run01: {NO_PHASE}"]),
        (first_tacho(0), None, [f"run run00: {NO_PHASE}"]),
        (
            each(lambda run: (run.pop("tacho"), run.pop("speed"))),
            None,
            ["run run00: no shaft angle: no tacho, no angle channel, no speed"],
        ),
        (
            each(lambda run: run.update(tacho=[t + 1234.5 for t in run["tacho"]])),
            None,
            ["run00: tacho: 10 of 10 pulses are outside the run (0 to 0.4995 s)"],
        ),
        (
            each(lambda run: run.update(sample_rate="4000 Hz")),
            None,
            ["run00: tacho: 3 of 10 pulses are outside the run (0 to 0.24975 s)"],
        ),
        (
            each(
                lambda run: run.update(
                    tacho=sorted({t / 2 + s / 2 for t in run["tacho"] for s in run["tacho"] if abs(t - s) < 0.06})
                )
            ),
            None,
            ["run00: tacho: the tacho says 2280 rpm, the stated speed is 1140 rpm"],
        ),
        (each(lambda run: run.update(tacho=run["tacho"][::-1])), None, ["run00: tacho: pulse 2 at 0.42"]),
        (
            each(lambda run: run.update(tacho=run["tacho"][:4] + run["tacho"][5:])),
            None,
            ["run00: tacho: 1 missing, the first after 0."],
        ),
        (
            each(lambda run: run.update(speed=0)),
            None,
            ["run00: tacho: the tacho says 1140 rpm, the stated speed is 0 rpm"],
        ),
        (
            each(lambda run: (run.update(speed=0), run.pop("tacho"))),
            None,
            ["run run00: only 0 turns of the shaft were recorded"],
        ),
        (each(lambda run: run["set"].update({"controller.Kp": 3})), None, ["run run00: set controller.Kp: no such"]),
        (each(lambda run: run["set"].update({"motor.KP": 3})), None, ["run run00: set motor.KP: no such parameter"]),
        (
            each(lambda run: run["set"].update({"controller.KP": "3 kg"})),
            None,
            ["run run00: set controller.KP: unit 'kg' does not fit 'A/m'"],
        ),
        (
            each(lambda run: run["set"].update({"controller.KP": [3, 4]})),
            None,
            ["run run00: set controller.KP: 2 values given, 1 expected"],
        ),
        (
            each(lambda run: run["set"].update({"controller.KP": True})),
            None,
            ["run run00: set controller.KP: must be a number, not true"],
        ),
        (
            lambda document: document["channels"]["x"].update(signal="shaft.displacement"),
            None,
            ["channel x: the diagram has no signal 'shaft.displacement'"],
        ),
        (
            lambda document: document["channels"]["x"].pop("axis"),
            None,
            ["channel x: 'rotor.displacement' is not one entry of 'rotor.displacement', which is 2"],
        ),
        (
            lambda document: document["channels"]["x"].update(axis="y"),
            None,
            ["channel y: measures rotor.displacement[2], and so does 'x'"],
        ),
        (each(lambda run: run.update(use="hold_out")), None, ["made: no run to identify from"]),
        (each(lambda run: run.update(file="run00.npz")), None, [": two runs alike: the data of run00 and run01"]),
    ],
)
def test_refused_with_the_reason(tmp_path, edit, change, expected):
    said = refusal(tmp_path, edit, change)
    for text in expected:
        assert any(text in line for line in said), said


def test_every_run_is_named_at_once(tmp_path):
    said = refusal(tmp_path, each(lambda run: run["set"].update({"controller.Kp": 3})))
    assert said == [f"run run0{k}: set controller.Kp: no such parameter" for k in range(4)]


@BOTH
def test_a_node_that_does_not_exist(tmp_path, method):
    with pytest.raises(RotorsimError) as error:
        found(on_disk(tmp_path, lambda document: document["channels"]["x"].update(node=7)), method)
    assert "rotor.displacement[7,1]" in str(error.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_samples_that_are_not_finite(tmp_path, bad):
    def change(table):
        return {**table, "x": np.where(np.arange(len(table["x"])) == 7, bad, table["x"])}

    said = refusal(tmp_path, None, change)
    assert len(said) == 4
    assert all("column x: " in line and "not finite" in line for line in said)


def test_files_without_data(tmp_path):
    write_recording(tmp_path, RUNS, "made", file_format="csv")
    text = (tmp_path / "run01.csv").read_text()
    for content in ("", "\n", text.splitlines()[0], "a,b\n1,2\n", "x,y,ix,iy\n1,2,3,four\n", "\x00\x01"):
        (tmp_path / "run01.csv").write_text(content)
        with pytest.raises(RotorsimError) as error:
            found(load_recording(tmp_path))
        assert "run01" in str(error.value)


def test_a_rate_that_the_angle_contradicts(tmp_path):
    def edit(document):
        for run in document["runs"]:
            run["sample_rate"] = "4000 Hz"

    with pytest.raises(RotorsimError, match="the angle says 2280 rpm, the stated speed is 1140 rpm"):
        found(on_disk(tmp_path, edit, angle="theta"))


@BOTH
def test_a_unit_of_something_else(tmp_path, method):
    """FAULT: a displacement in kg or A is taken as if it were in m."""
    recording = on_disk(tmp_path, lambda document: document["channels"]["x"].update(unit="kg"))
    with pytest.raises(RotorsimError, match="kg"):
        found(recording, method)


@BOTH
@pytest.mark.parametrize("name", ["viscous_damping", "speed"])
def test_a_setting_that_is_not_heard(tmp_path, method, name):
    """FAULT: a run sets what is to be identified, or another speed than was measured: silently overruled.

    An error, or a warning that names it.
    """
    value = {"viscous_damping": 10, "speed": "1000 rpm"}[name]
    recording = on_disk(tmp_path, each(lambda run: run["set"].update({name: value})))
    try:
        warnings = found(recording, method).warnings
    except RotorsimError as error:
        warnings = error.problems
    assert any(name in f"{problem.subject} {problem.what}" for problem in warnings)


def test_the_nominal_speed_as_a_setting(tmp_path):
    """The shaft turns 0.5 % faster than it is set to, and says so by its tacho. FAULT: forces at the nominal speed
    are sampled over a turn at the measured one, and the model is said not to explain the data.
    """
    runs = two_gains("jeffcott", [speed * 1.005 for speed in SPEEDS], level=0.005, duration=0.5)
    nominal = iter([*SPEEDS, *SPEEDS])
    recording = on_disk(tmp_path, each(lambda run: run["set"].update(speed=next(nominal))), runs=runs)
    item = found(recording)
    assert item.adequate
    assert max(errors(item).values()) < 0.05


@BOTH
@pytest.mark.parametrize("which", ["speed", "unused"])
def test_free_parameters_that_no_data_can_tell(tmp_path, method, which):
    """FAULT: the speed is measured and still searched for; a parameter that nothing uses is a ValueError, or, beside
    others, left out without a word.
    """

    def change(document):
        document["parameters"]["unused"] = 3
        document["identify"] = {which: {}}

    recording = on_disk(tmp_path)
    with pytest.raises(RotorsimError, match=which):
        found(recording, method, changed("jeffcott", change))


def test_a_free_parameter_that_nothing_uses_is_not_left_out_silently(tmp_path):
    """FAULT: see above."""

    def change(document):
        document["parameters"]["unused"] = 3
        document["identify"]["unused"] = {}

    try:
        item = found(on_disk(tmp_path), diagram=changed("jeffcott", change))
    except RotorsimError as error:
        assert "unused" in str(error)  # noqa: PT017
        return
    assert "unused" in item.parameters or any("unused" in str(problem) for problem in item.warnings)


# --- warned about -----------------------------------------------------------------------------------------------------


def scaled(columns: tuple[str, ...], factor: float) -> Change:
    return lambda table: {c: v * factor if c in columns else v for c, v in table.items()}


def clip(table: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    limit = 0.6 * np.abs(table["x"]).max()
    return {**table, "x": np.clip(table["x"], -limit, limit)}


def exchange(document: dict[str, Any]) -> None:
    document["channels"]["x"]["axis"], document["channels"]["y"]["axis"] = "y", "x"


@pytest.mark.parametrize(
    ("edit", "change", "warning"),
    [
        (None, scaled(("x", "y"), 1e6), "wrong unit? rms 1."),
        (
            lambda document: [document["channels"][c].update(unit="um") for c in ("x", "y")],
            None,
            "with unit 'um' is less than 1 nm",
        ),
        (exchange, None, "swapped axes? y follows iy and x follows ix in 4 of 4 runs"),
        (None, lambda table: {**table, "y": 0 * table["y"]}, "constant signal: all samples are 0 m"),
        (
            None,
            lambda table: {**table, "ix": 0 * table["ix"] + 2.5, "iy": 0 * table["iy"] + 2.5},
            "constant signal: all samples are 2.5 A",
        ),
        (None, clip, "clipped signal: "),
        (
            lambda document: document["channels"].pop("y"),
            None,
            "missing channel: rotor.displacement[1] is measured, its y axis is not",
        ),
    ],
)
def test_warned_about_by_name(tmp_path, edit, change, warning):
    item = found(on_disk(tmp_path, edit, change), "regression")
    assert any(warning in problem.what for problem in item.warnings)
    assert all(problem.severity == "warning" for problem in item.warnings)


def test_two_runs_at_one_speed():
    runs = [*made("jeffcott", SPEEDS, level=0.005, duration=0.5), *made("jeffcott", SPEEDS, level=0.005, seed=1)]
    item = found(recorded(runs))
    assert [problem.what for problem in item.warnings] == [
        "two runs alike: run0 and run2 have the same speed and set",
        "two runs alike: run1 and run3 have the same speed and set",
    ]
    nothing_wrong_is_sure(item)


# --- not adequate -----------------------------------------------------------------------------------------------------


def backwards(document: dict[str, Any]) -> None:
    for run in document["runs"]:
        run["speed"] = "-" + run["speed"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edit", "change"),
    [
        (each(lambda run: run.update(tacho=[t + 0.0137 for t in run["tacho"]])), None),
        pytest.param(each(lambda run: run.update(tacho=[t * 1.008 for t in run["tacho"]])), None, marks=SLOW),
        pytest.param(each(lambda run: run.update(sample_rate="1000 Hz")), None, marks=SLOW),
        (each(lambda run: run.pop("set")), None),
        pytest.param(backwards, None, marks=SLOW),
        pytest.param(None, scaled(("y",), -1), marks=SLOW),
        (None, scaled(("ix", "iy"), 1.05)),
        pytest.param(None, scaled(("ix", "iy"), 1e3), marks=SLOW),
        pytest.param(
            None, lambda table: {**table, "ix": np.roll(table["ix"], 2), "iy": np.roll(table["iy"], 2)}, marks=SLOW
        ),
        (None, lambda table: {**table, "y": table["x"]}),
    ],
    ids=[
        "tacho of another clock",
        "tacho clock too fast",
        "half the rate",
        "gains not said",
        "turning back",
        "y inverted",
        "current 5 % too large",
        "mA as A",
        "current late by two samples",
        "y is a copy of x",
    ],
)
def test_not_adequate(tmp_path, edit, change):
    """The likelihood at its best is far below what noise leaves."""
    recording = on_disk(tmp_path, edit, change)
    likelihood = opened(recording)
    best = estimate(Search(likelihood))
    assert best.goodness < 1e-3


def opened(recording: Recording) -> Likelihood:
    return likelihood_of("jeffcott", recording)


@pytest.mark.slow
def test_an_angle_does_not_run_away():
    """With x and y exchanged in all signals a search may take the crack to 1e6 rad, where rounding makes every
    force take 4096 samples a turn from then on: thirty seconds instead of one.
    """
    other = {"x": "y", "y": "x", "ix": "iy", "iy": "ix"}
    runs = two_gains("jeffcott", LOWER["jeffcott"][::4], level=0.005)
    runs = [replace(run, columns={other[c]: v for c, v in run.columns.items()}) for run in runs]
    likelihood = opened(recorded(runs))
    best = estimate(Search(likelihood))
    assert best.goodness < 1e-3
    assert likelihood.experiment.motion.equations.whole.samples <= 64


# --- degenerate noise -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@BOTH
def test_a_current_that_was_computed_from_the_displacement(method):
    """Signals in exact proportion have a singular covariance."""
    runs = [
        replace(run, columns={**run.columns, "ix": 12200 * run.columns["x"], "iy": 12200 * run.columns["y"]})
        for run in RUNS
    ]
    try:
        nothing_wrong_is_sure(found(recorded(runs), method))
    except RotorsimError:
        return


@pytest.mark.slow
@BOTH
def test_a_channel_under_two_names(method):
    """Two nodes with the data of one. FAULT: LinAlgError in `advice._excitation`."""
    runs = [
        run.select(("x3", "y3", "x4", "y4", "ix", "iy"))
        for run in made("fe_rigid", LOWER["fe_rigid"][::8], level=0.01, duration=0.25)
    ]
    runs = [replace(run, columns={**run.columns, "x4": run.columns["x3"], "y4": run.columns["y3"]}) for run in runs]
    try:
        item = found(recorded(runs), method, shipped("fe_rigid"))
    except RotorsimError:
        return
    assert not item.adequate


@BOTH
@pytest.mark.parametrize("scale", [1e200, 1e-200])
def test_numbers_of_no_size(method, scale):
    """FAULT: squares overflow or vanish in the checks of the signals, with a RuntimeWarning of NumPy."""
    runs = [replace(run, columns={c: scale * v for c, v in run.columns.items()}) for run in RUNS[:2]]
    try:
        item = found(recorded(runs), method)
    except RotorsimError:
        return
    assert item.warnings
