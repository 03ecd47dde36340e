"""Variables of every type are set, wired and recorded; sizes of arrays; what the FMU is told, says and prints."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.errors import RotorsimError
from rotorsim.fmi.description.reader import read_description
from rotorsim.fmi.runtime.slave import open_fmu
from rotorsim.model.load import load
from tests.cli.conftest import Run
from tests.fmi.events import alone, events_fmu
from tests.fmi.gauge import description, gauge_fmu, with_gauge
from tests.fmi.plant import library, make_fmu

ALL = ["it.y", "it.nb", "it.i2", "it.mode_out", "it.flag_out", "it.told_stop", "it.told_tolerance", "it.told_start"]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return gauge_fmu(tmp_path)


def last(found: Any, *names: str) -> list[float]:
    return [float(found[f"it.{name}"][-1]) for name in names]


def test_values_of_every_type_are_set(file: Path) -> None:
    plain = cosimulate_diagram(with_gauge(file, record=ALL), step=0.5)
    assert last(plain, "nb", "i2", "mode_out", "flag_out") == [1.0, 0.0, 1.0, 0.0]
    assert plain.provenance["fmus"]["it"]["texts"] == {"said": "none"}
    values = {"b": True, "i": 3, "mode": "fast", "flag": True, "text": "rotor ä"}
    found = cosimulate_diagram(with_gauge(file, record=ALL, **values), step=0.5)
    assert last(found, "nb", "i2", "mode_out", "flag_out") == [0.0, 6.0, 4.0, 1.0]
    assert found.provenance["fmus"]["it"]["texts"] == {"said": "rotor ä"}
    assert last(cosimulate_diagram(with_gauge(file, record=ALL, mode=4), step=0.5), "mode_out") == [4.0]


def test_names_of_several_ranks_and_starts_that_are_not_finite(tmp_path: Path) -> None:
    text = description().replace('name="told_stop"', 'name="a[1]"').replace('name="told_start"', 'name="a[1,2]"')
    file = gauge_fmu(tmp_path, text.replace('start="1e9"', 'start="INF"'))
    found = cosimulate_diagram(with_gauge(file, record=["it.a", "it.y"]), step=0.5)
    assert found["it.a"].tolist() == [[1.0]] * 3  # the stop time: the first that has the name
    with pytest.raises(RotorsimError, match="unknown parameter 'end_at'"):
        with_gauge(file, end_at=0.5)


def test_values_named_as_options_of_the_block(tmp_path: Path) -> None:
    text = description().replace('name="text"', 'name="file"').replace('name="end_at"', 'name="interface"')
    file = gauge_fmu(tmp_path, text)
    found = cosimulate_diagram(with_gauge(file, file_="table.txt", interface_=0.5, interface="cs"), step=0.25)
    assert found.provenance["fmus"]["it"]["texts"] == {"said": "table.txt"}
    assert found.time[-1] == 0.5


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        ("mode", "fats", "it.mode: 'fats' is not a choice\n\nhint: did you mean 'fast'?"),
        ("mode", 2, "it.mode: '2' is not a choice\n\nhint: one of: slow, fast, 1, 4"),
        ("flag", 1, "it.flag: must be true or false, not the number 1"),
        ("text", 1, "it.text: must be a text, not the number 1"),
    ],
)
def test_values_of_another_type_are_refused(file: Path, name: str, value: Any, what: str) -> None:
    with pytest.raises(RotorsimError) as caught:
        with_gauge(file, **{name: value})
    assert what in str(caught.value)


def test_signals_of_every_type_are_wired(file: Path) -> None:
    """A step from 0 to 1 at 0.4 s into a Boolean and an Integer, then nb = not b into y = u of another."""
    blocks = {
        "in": {"type": "step", "parameters": {"final": 1.0, "time": 0.45}},
        "held": {"type": "sample_hold", "parameters": {"sample_time": "0.1 s"}},
        "other": {"type": "fmu", "file": file.name, "parameters": {"in_process": True}},
    }
    wires = [["in.output", "held.input"], ["held.output", "it.b"], ["held.output", "it.i"], ["it.nb", "other.u"]]
    diagram = with_gauge(file, wires=wires, blocks=blocks, record=["it.nb", "it.i2", "other.y"])
    found = cosimulate_diagram(diagram, step=0.1)
    assert found["it.nb"].tolist() == [1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0]
    assert found["it.i2"].tolist() == [0, 0, 0, 0, 0, 2, 2, 2, 2, 2, 2]
    assert found["other.y"][[0, -1]].tolist() == [1.0, 0.0]


def test_variables_inside_are_recorded_by_name(tmp_path: Path) -> None:
    """The ball has no output v: x' = v, v' = -9.81."""
    diagram = alone(events_fmu(tmp_path), "ball", step=0.01, stop=0.25)
    document = {**diagram.document, "record": ["it.x", "it.v", "it.gravity"]}
    found = cosimulate_diagram(load(document, folder=tmp_path, trust_blocks=True), [], step=0.05)
    assert found["it.v"].tolist() == pytest.approx((-9.81 * found.time).tolist(), rel=1e-12)
    assert set(found["it.gravity"].tolist()) == {9.81}
    with pytest.raises(RotorsimError, match="has no output 'vv'"):
        load({**document, "record": ["it.vv"]}, folder=tmp_path, trust_blocks=True)


def test_what_the_fmu_is_told_of_the_experiment(tmp_path: Path, file: Path) -> None:
    found = cosimulate_diagram(with_gauge(file, record=ALL, stop=0.7), step=0.1)
    assert last(found, "told_stop", "told_tolerance", "told_start") == [0.7, -1.0, 0.0]
    assert found["it.y"][-1] == 1.0
    proposed = gauge_fmu(tmp_path, description(more='<DefaultExperiment tolerance="1e-5"/>'), "other.fmu")
    assert last(cosimulate_diagram(with_gauge(proposed, record=ALL), step=0.1), "told_tolerance") == [1e-5]
    diagram = load(
        with_gauge(proposed, record=ALL).document, folder=tmp_path, set={"solver.rtol": 1e-7}, trust_blocks=True
    )
    assert last(cosimulate_diagram(diagram, step=0.1), "told_tolerance") == [1e-7]


def test_a_text_is_no_signal_and_told_at_the_end(tmp_path: Path, run: Run) -> None:
    file = gauge_fmu(tmp_path)
    with pytest.raises(RotorsimError) as caught:
        with_gauge(file, record=["it.said"])
    assert caught.value.problems[0].what == "'said' is a text, no signal: cosim tells its last value"
    document = with_gauge(file, text="rotor ä").document
    (tmp_path / "d.json").write_text(json.dumps(dict(document)))
    result = run("cosim", str(tmp_path / "d.json"), "--step", "0.5 s", "--trust-blocks")
    assert result.exit_code == 0
    assert "it: said is 'rotor ä' at the end\n" in result.stdout


def test_an_fmu_without_outputs_says_what_can_be_recorded(tmp_path: Path) -> None:
    text = description(real=True).replace('causality="output"', 'causality="local"')
    file = gauge_fmu(tmp_path, text[: text.index("<Outputs>")] + "</ModelStructure></fmiModelDescription>")
    warning = with_gauge(file, record=["in.output"]).warnings[0]
    assert warning.what == "gauge.fmu: it has no outputs, and none of the variables inside is recorded or wired"
    assert warning.hint == '"record": ["BLOCK.y"]; there are y, told_stop, told_tolerance, told_start, last'
    diagram = with_gauge(file, record=["it.y"])
    assert not diagram.warnings
    assert cosimulate_diagram(diagram, step=0.5)["it.y"][-1] == 1.0


# -- sizes of arrays ---------------------------------------------------------------------------------------------------

THREE = """<fmiModelDescription fmiVersion="3.0" modelName="n" instantiationToken="t">
<CoSimulation modelIdentifier="n"/><ModelVariables>
<UInt64 name="m.n" valueReference="1" causality="structuralParameter" start="2"/>
<Float64 name="m.u" valueReference="2" causality="input" start="1 2"><Dimension valueReference="1"/></Float64>
<Float64 name="m.y" valueReference="3" causality="output"><Dimension valueReference="1"/></Float64>
<Float64 name="m.k" valueReference="4" causality="parameter" variability="fixed" start="5">
<Dimension valueReference="1"/></Float64>
</ModelVariables><ModelStructure><Output valueReference="3"/></ModelStructure></fmiModelDescription>"""


def test_sizes_give_arrays_their_shapes() -> None:
    plain, wide = (read_description(THREE.encode(), "x", sizes=sizes) for sizes in ({}, {"m.n": 4}))
    assert (plain.variables["m.y"].dimensions, plain.variables["m.u"].start) == ((2,), (1.0, 2.0))
    assert wide.variables["m.y"].names() == ["m.y[1]", "m.y[2]", "m.y[3]", "m.y[4]"]
    assert (wide.variables["m.u"].start, wide.variables["m.k"].start) == (None, (5.0,) * 4)
    assert (dict(plain.sizes), dict(wide.sizes)) == ({}, {"m.n": 4})
    with pytest.raises(RotorsimError, match=r"m\.k: is no structural parameter"):
        read_description(THREE.encode(), "x", sizes={"m.k": 4})


def sized(folder: Path) -> Path:
    return make_fmu(
        folder / "sized.fmu",
        "3.0",
        description=THREE.replace('"n"/>', '"plant"/>', 1),
        library_bytes=library("3.0", "sized"),
    )


def test_an_fmu_of_another_size_at_work(tmp_path: Path) -> None:
    sized(tmp_path)
    document: dict[str, Any] = {
        "parameters": {"count": 4},
        "blocks": {
            "it": {"type": "fmu", "file": "sized.fmu", "parameters": {"in_process": True, "n": "$count"}},
            "in": {"type": "constant", "parameters": {"value": [1.0, 2.0, 3.0, 4.0]}},
        },
        "wires": [["in.output", "it.u"]],
        "solver": {"step": 0.1, "stop": 0.2},
        "record": ["it.y"],
    }
    found = cosimulate_diagram(load(document, folder=tmp_path, trust_blocks=True), step=0.1)
    assert found["it.y"].tolist() == [[5.0, 10.0, 15.0, 20.0]] * 3
    own = document["blocks"]["it"]["parameters"]
    own["k"] = [1.0, 1.0, 2.0, 2.0]
    found = cosimulate_diagram(load(document, folder=tmp_path, trust_blocks=True), step=0.1)
    assert found["it.y"].tolist() == [[1.0, 2.0, 6.0, 8.0]] * 3
    own["n"] = 3
    with pytest.raises(RotorsimError) as caught:
        load(document, folder=tmp_path, trust_blocks=True)
    assert "shape" in str(caught.value)
    own["n"] = -1
    with pytest.raises(RotorsimError, match=r"it\.n: -1 must be at least 0"):
        load(document, folder=tmp_path, trust_blocks=True)


def test_sizes_are_told_before_the_start(tmp_path: Path) -> None:
    with open_fmu(sized(tmp_path), sizes={"m.n": 3}) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(inputs=["m.u"], outputs=["m.y"])
        assert slave.exchange(np.array([1.0, 2.0, 3.0]), 0.0, 0.1).tolist() == [5.0, 10.0, 15.0]
    with open_fmu(sized(tmp_path)) as fmu:
        slave = fmu.instantiate("cs")
        with pytest.raises(RotorsimError) as caught:
            slave.setup(parameters={"m.n": 3})
        assert "is a structural parameter, which gives arrays their shapes" in str(caught.value)


# -- what it says ------------------------------------------------------------------------------------------------------


def written(folder: Path, file: Path, **values: Any) -> str:
    diagram = with_gauge(file, **values)
    (folder / "d.json").write_text(json.dumps(dict(diagram.document)))
    return str(folder / "d.json")


@pytest.mark.parametrize("fast", [False, True])
def test_warnings_are_counted_and_shown(tmp_path: Path, run: Run, fast: bool) -> None:
    file = gauge_fmu(tmp_path, description(real=True, talks=True))
    more = ["--fast"] if fast else []
    done = run("cosim", "--trust-blocks", written(tmp_path, file, talk=2), "--step", "0.1 s", "--json", *more)
    assert done.exit_code == 0
    about = json.loads(done.stdout)["coupling"]["fmus"]["it"]
    assert (about["warnings"], about["messages"]) == (10, {"Warning": 10})
    assert "it: 10 calls returned a warning; 10 messages of warnings or errors\n" in done.stderr
    assert "it said: Warning: step 10 is odd\n" in done.stderr
    assert "--log FILE keeps all that it says" in done.stderr
    quiet = run("cosim", "--trust-blocks", written(tmp_path, file, talk=0), "--step", "0.1 s", *more)
    assert "it" not in quiet.stderr.split()


@pytest.mark.parametrize("in_process", [True, False])
def test_the_log_is_kept(tmp_path: Path, run: Run, file: Path, in_process: bool) -> None:
    path = written(tmp_path, file, talk=6, in_process=in_process)
    assert run("cosim", "--trust-blocks", path, "--step", "0.1 s", "--log", "said.txt").exit_code == 0
    lines = (tmp_path / "said.txt").read_text().splitlines()
    assert len(lines) == 20
    assert lines[:2] == ["0\tit\tOK\tlogEvents\tstep 1", "0\tit\tWarning\tlogStatusWarning\tstep 1 is odd"]
    assert lines[-1] == "0.9\tit\tWarning\tlogStatusWarning\tstep 10 is odd"
    refused = run("cosim", "--trust-blocks", path, "--step", "0.1 s", "--log", "no/said.txt")
    assert refused.exit_code == 2
    assert "--log no/said.txt: cannot be written: no such file or directory" in refused.stderr


def test_messages_that_are_lost_are_counted(file: Path) -> None:
    heard: list[tuple[str, str]] = []
    diagram = with_gauge(file, talk=8)
    cosimulate_diagram(diagram, step=0.5, log=lambda block, t, status, category, text: heard.append((status, text)))
    assert heard.count(("OK", "flood")) == 2000
    assert heard[500] == heard[1501] == ("Warning", "200 more messages came at once and are lost")


@pytest.mark.slow
def test_what_it_prints_does_not_break_json(tmp_path: Path, file: Path) -> None:
    """In the process of the command it prints past Python, to the descriptor itself."""
    verb = ["cosim", "--trust-blocks", written(tmp_path, file, talk=1), "--step", "0.1 s", "--json"]
    command = [sys.executable, "-c", "from rotorsim.cli import main; main()", *map(str, verb)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True, timeout=120)
    assert json.loads(done.stdout)["status"] == "finished"
    assert done.stderr.count("what ") == 10


# -- the end -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fast", [False, True])
def test_an_end_that_the_fmu_asks_for_keeps_its_last_sample(tmp_path: Path, fast: bool) -> None:
    """y = u = t, held over steps of 0.1 s; the end is asked for at 0.55 s."""
    file = gauge_fmu(tmp_path, description(real=True))
    diagram = with_gauge(file, "ramp", more={"slope": 1.0}, record=["it.y", "it.last", "in.output"], end_at=0.55)
    found = cosimulate_diagram(diagram, step=0.1, fast=fast)
    assert found.status == "stopped"
    assert found.message.startswith("it: asks for the end of the simulation (t = 0.55 s)")
    assert found.time.tolist() == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.55], abs=1e-15)
    assert found["it.last"].tolist() == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.55], abs=1e-15)
    assert np.isfinite(found["in.output"]).all()


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_end_of_model_exchange_keeps_its_last_sample(tmp_path: Path, version: str) -> None:
    """The clock ticks every 0.25 s and asks for the end at its third tick."""
    diagram = alone(events_fmu(tmp_path, version), "clock", step=0.01, stop=2.0, stop_at=3)
    found = cosimulate_diagram(diagram, step=0.1)
    assert found.status == "stopped"
    assert found.time[-1] == pytest.approx(0.75)
    assert found["it.count"][-1] == 3.0


def test_clocks_are_named(tmp_path: Path) -> None:
    text = (
        '<fmiModelDescription fmiVersion="3.0" modelName="n" instantiationToken="t">'
        '<ScheduledExecution modelIdentifier="n"/><ModelVariables><Clock name="fast" valueReference="1" '
        'causality="input" intervalVariability="constant"/></ModelVariables><ModelStructure/></fmiModelDescription>'
    )
    file = make_fmu(tmp_path / "c.fmu", "3.0", description=text, library_bytes=b"none")
    diagram = load(
        {"blocks": {"it": {"type": "fmu", "file": "c.fmu"}, "in": {"type": "constant"}}},
        folder=tmp_path,
        trust_blocks=True,
    )
    with pytest.raises(RotorsimError) as caught:
        cosimulate_diagram(diagram, step=0.1)
    problem = caught.value.problems[0]
    assert problem.what == "the FMU offers Scheduled Execution only, which is driven by clocks: not supported"
    assert problem.hint == "its clocks are fast"
    with open_fmu(file) as fmu, pytest.raises(RotorsimError, match=r"not supported: it is driven by clocks \(fast\)"):
        fmu.instantiate("se")


def test_a_file_twice_in_the_archive_is_said(tmp_path: Path) -> None:
    file = gauge_fmu(tmp_path)
    with zipfile.ZipFile(file, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("resources/note.txt", "another")
    diagram = with_gauge(file)
    assert [problem.what for problem in diagram.warnings] == [
        "gauge.fmu: 'resources/note.txt': is in the archive twice: they differ, and the last is used; other tools may "
        "use the first"
    ]
    assert cosimulate_diagram(diagram, step=0.5)["it.y"][-1] == 1.0
