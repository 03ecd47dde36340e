"""FMUs of FMI 1.0: described and run in both places, against formulas and against FMPy as a client.

Their events: test_events.py; their equations: tests/fmi/test_equations.py.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.errors import RotorsimError
from rotorsim.fmi.description.info import information
from rotorsim.fmi.description.model import ModelDescription
from rotorsim.fmi.description.reader import read_description
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.slave import describe_fmu, open_fmu
from rotorsim.fmi.validate import validate_fmu
from tests.cli.conftest import Run
from tests.fmi.events import MODELS, alone, events_fmu
from tests.fmi.lag import lag_description, lag_fmu, with_lag
from tests.fmi.plant import library, make_fmu

H, T = 0.1, 0.5
HERE = [True, False]


def read(text: str) -> ModelDescription:
    return read_description(text.encode("iso-8859-1"), "x.xml")


def mistakes(text: str) -> list[str]:
    with pytest.raises(RotorsimError) as caught:
        read(text)
    return [str(problem) for problem in caught.value.problems]


def response(t: np.ndarray, goal: float) -> np.ndarray:
    """Return the response [m] of the lag to a step of its input, its output being in mm."""
    return np.asarray(1e-3 * goal * (1 - np.exp(-t / T)))


# -- description -------------------------------------------------------------------------------------------------------


def test_a_description_in_the_terms_of_fmi_2() -> None:
    found = read(lag_description())
    told = {
        name: (v.type, v.causality, v.variability, v.initial, v.start, v.unit) for name, v in found.variables.items()
    }
    assert told == {
        "u": ("Float64", "input", "continuous", "exact", 0.0, ""),
        "y": ("Float64", "output", "continuous", "calculated", None, "mm"),
        "minus": ("Float64", "output", "continuous", "calculated", None, "mm"),
        "T": ("Float64", "parameter", "fixed", "exact", 0.5, "s"),
        "k": ("Float64", "parameter", "fixed", "exact", 1.0, ""),
        "y0": ("Float64", "parameter", "fixed", "exact", 0.0, "mm"),
        "half": ("Float64", "calculatedParameter", "fixed", "calculated", None, ""),
        "steps": ("Int32", "output", "discrete", "calculated", None, ""),
        "fault": ("Enumeration", "parameter", "fixed", "exact", 1, ""),
        "first": ("Int32", "output", "discrete", "calculated", None, ""),
        "open": ("Boolean", "parameter", "fixed", "exact", False, ""),
        "opposite": ("Float64", "parameter", "fixed", "exact", -1.0, ""),
        "shut": ("Boolean", "parameter", "fixed", "exact", True, ""),
        "closed": ("Boolean", "output", "discrete", "calculated", None, ""),
        "mime": ("String", "output", "discrete", "calculated", None, ""),
    }
    assert [name for name, v in found.variables.items() if v.negated] == ["minus", "opposite", "shut", "closed"]
    assert found.version == "1.0"
    assert list(found.kinds) == ["cs"]
    assert found.kinds["cs"].can_vary_step
    assert len(found.states) == 1
    assert not found.follows("y", "u")  # <DirectDependency/> is there and empty
    assert found.follows("mime", "u")  # nothing is said
    assert found.items["Fault"]["fail"] == 4
    assert found.experiment.tolerance == 1e-4
    units = {name: found.unit_of(found.variables[name]) for name in ("y", "u")}
    assert units["y"] is not None
    assert (units["y"].factor, units["u"]) == (1e-3, None)
    assert found.units["mm"].display == {"um": (1000.0, 0.0, False)}


def test_what_other_variables_become() -> None:
    rows = [
        ("guess", 'variability="parameter"', '<Real start="1" fixed="0"/>', ("calculatedParameter", "fixed", "approx")),
        ("constant", 'variability="constant"', '<Real start="1"/>', ("local", "constant", "exact")),
        ("told", 'causality="output" variability="parameter"', "<Real/>", ("output", "discrete", "calculated")),
        ("state", "", '<Real start="1"/>', ("local", "continuous", "exact")),
        ("guessed", 'causality="internal"', '<Real start="1" fixed="false"/>', ("local", "continuous", "approx")),
        ("whole", 'causality="none"', "<Integer/>", ("local", "discrete", "calculated")),
        ("flag", 'causality="input"', '<Boolean start="1"/>', ("input", "discrete", "exact")),
    ]  # fmt: skip
    text = "".join(
        f'<ScalarVariable name="{name}" valueReference="9" {how}>{inner}</ScalarVariable>'
        for name, how, inner, _ in rows
    )
    found = read(lag_description(text)).variables
    for name, _, _, expected in rows:
        v = found[name]
        assert (v.causality, v.variability, v.initial) == expected, name


def test_mistakes_are_placed_and_in_the_words_of_fmi_1() -> None:
    more = (
        '<ScalarVariable name="a" valueReference="9" causality="local"><Real/></ScalarVariable>\n'
        '<ScalarVariable name="b" valueReference="9" variability="fixed"><Real/></ScalarVariable>\n'
        '<ScalarVariable name="c" valueReference="9" alias="no"><Real start="1" fixed="maybe"/></ScalarVariable>\n'
        '<ScalarVariable name="d" valueReference="9"/>\n'
        '<ScalarVariable name="e" valueReference="9" causality="output"><Real/><DirectDependency><Name>f</Name>'
        "</DirectDependency></ScalarVariable>\n"
        '<ScalarVariable name="g" valueReference="x"><Real/></ScalarVariable>\n'
    )
    text = lag_description(more).replace('numberOfContinuousStates="1"', 'numberOfContinuousStates="-1"')
    assert mistakes(text) == [
        "x.xml:27:89: error: e: depends on 'f', which is not a variable",
        'x.xml:23:1: error: a: causality="local" is unknown: known: input, internal, none, output',
        'x.xml:24:1: error: b: variability="fixed" is unknown: known: constant, continuous, discrete, parameter',
        'x.xml:25:1: error: c: alias="no" is unknown: known: alias, negatedAlias, noAlias',
        'x.xml:25:56: error: c: fixed="maybe" is neither true nor false',
        "x.xml:26:1: error: d: has no type: one of Real, Integer, Boolean, String, Enumeration",
        'x.xml:28:1: error: g: valueReference="x" is not a whole number between 0 and 4294967295',
        'x.xml:2:1: error: numberOfContinuousStates="-1" is not a whole number between 0 and 100000',
    ]


def test_what_offers_nothing() -> None:
    assert mistakes(lag_description(implementation="<CoSimulation/>")) == [
        "x.xml:24:1: error: holds neither <CoSimulation_StandAlone> nor <CoSimulation_Tool>"
    ]
    assert mistakes(lag_description().replace(' modelIdentifier="plant"', "")) == [
        "x.xml:24:42: error: CoSimulation: the attribute modelIdentifier is missing"
    ]
    assert mistakes(lag_description().replace('"plant"', '"../plant"')) == [
        "x.xml:24:42: error: CoSimulation: modelIdentifier '../plant' is not an identifier"
        "\n\nhint: it names a file: letters, digits and _ only, not starting with a digit"
    ]
    doctype = lag_description().replace("?>\n", '?><!DOCTYPE a [<!ENTITY b "c">]>\n')
    assert "a document type (<!DOCTYPE ...>) is not allowed" in mistakes(doctype)[0]


@pytest.mark.slow
def test_info_and_validate(tmp_path: Path, run: Run) -> None:
    file = lag_fmu(tmp_path)
    told = information(describe_fmu(file))
    assert (told["fmi"], told["states"], told["runs_here"]) == ("1.0", 1, True)
    shown = run("fmu", "info", str(file))
    assert shown.exit_code == 0
    assert "lag: FMI 1.0, Co-Simulation" in shown.stdout
    assert [str(problem) for problem in validate_fmu(file, load=True)] == []


# -- Co-Simulation -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("here", HERE)
@pytest.mark.parametrize("fast", [False, True])
def test_co_simulation_against_the_formula(tmp_path: Path, here: bool, fast: bool) -> None:
    """The lag is exact for a held input; its output is in m. fast: called from C, here or in its process."""
    diagram = with_lag(lag_fmu(tmp_path, lag_description(real=fast)), in_process=here, k=3.0)
    found = cosimulate_diagram(diagram, step=H, master="jacobi", fast=fast)
    assert found.status == "finished"
    assert found.units["it.y"] == "m"
    assert found["it.y"] == pytest.approx(response(found.time, 6.0), abs=1e-17)


@pytest.mark.parametrize("here", HERE)
def test_negated_aliases_have_the_other_sign(tmp_path: Path, here: bool) -> None:
    file, record = lag_fmu(tmp_path), ["it.y", "it.minus", "it.closed"]
    found = cosimulate_diagram(with_lag(file, in_process=here, opposite=-3.0, record=record), step=H)
    assert found["it.y"] == pytest.approx(response(found.time, 6.0), abs=1e-17)
    assert np.array_equal(found["it.minus"], found["it.y"])  # the lag itself gives -y there
    assert (found["it.closed"] == 1.0).all()
    found = cosimulate_diagram(with_lag(file, in_process=here, shut=False, y0=1e-3, record=record), step=H)
    assert found["it.y"] == pytest.approx(1e-3 * np.exp(-found.time / T), abs=1e-17)
    assert (found["it.closed"] == 0.0).all()


@pytest.mark.slow
def test_both_places_agree_to_the_last_bit_and_so_does_the_command_line(tmp_path: Path, run: Run) -> None:
    file = lag_fmu(tmp_path)
    here, apart = (cosimulate_diagram(with_lag(file, in_process=one), step=H) for one in HERE)
    assert np.array_equal(here["it.y"], apart["it.y"])
    document = tmp_path / "lag.json"
    document.write_text(
        '{"name": "lag", "blocks": {"it": {"type": "fmu", "file": "lag.fmu", "parameters": {"u": 2.0}}}, "wires": [],'
        ' "solver": {"step": 0.01, "stop": 1.0}, "record": ["it.y"]}'
    )
    assert run("cosim", str(document), "--step", "0.1 s").exit_code == 2  # without consent to run what is inside
    done = run("cosim", str(document), "--step", "0.1 s", "--trust-blocks", "--out", str(tmp_path / "y.csv"))
    assert done.exit_code == 0
    assert "it: mime is 'application/x-fmu-sharedlibrary' at the end" in done.stdout
    rows = np.genfromtxt(tmp_path / "y.csv", delimiter=",", names=True)
    assert np.array_equal(rows["ity"], apart["it.y"])


@pytest.mark.parametrize("here", HERE)
def test_it_is_initialised_with_the_inputs_that_it_is_fed(tmp_path: Path, here: bool) -> None:
    """FMI 1.0 gives outputs after its initialisation only; inputs that are found by then are those of another one."""
    found = cosimulate_diagram(with_lag(lag_fmu(tmp_path), record=["it.first"], in_process=here), step=H)
    assert (found["it.first"] == 2000.0).all()


def test_an_instance_is_made_anew_where_it_is_reset(tmp_path: Path) -> None:
    with open_fmu(lag_fmu(tmp_path), in_process=True) as fmu:
        slave = fmu.instantiate("cs")
        runs = []
        for _ in range(2):
            slave.setup(0.0, 1.0, parameters={"y0": 1.0}, inputs=["u"], outputs=["y"])
            runs.append([slave.exchange(np.ones(1), k * H, H)[0] for k in range(5)])
            slave.terminate()
            slave.reset()
    assert runs[0] == runs[1] == pytest.approx([1.0] * 5)


def test_values_of_every_type(tmp_path: Path) -> None:
    with open_fmu(lag_fmu(tmp_path)) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(0.0, 1.0, parameters={"mime": "ä", "open": True, "fault": 6, "T": 0.25}, exit_initialisation=False)
        assert slave.get(["mime", "open", "fault", "T"]) == ["ä", True, 6, 0.25]
        slave.set(["k", "open"], [2.0, False])
        slave.exit_initialisation()
        assert slave.get(["k", "open", "steps"]) == [2.0, False, 0]
        with pytest.raises(FmuError, match="its state cannot be saved"):
            slave.save_state()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "here", "message"),
    [
        (
            "segv",
            False,
            "its process was ended by SIGSEGV (it used memory that is not its own), in fmiDoStep (t = 0.5 s)",
        ),
        ("fail", False, "fmiDoStep returned fmiError (t = 0.5 s)\n  it said: Error: tired at 0.5 s"),
        ("fail", True, "fmiDoStep returned fmiError (t = 0.5 s)\n  it said: Error: tired at 0.5 s"),
        ("discard", False, "fmiDoStep refused the step, it came to t = 0.5 s (t = 0.5 s)"),
        ("pending", True, "fmiDoStep runs on after it has returned (fmiPending), which is not supported (t = 0.5 s)"),
    ],
)
def test_what_goes_wrong_in_a_step(tmp_path: Path, fault: str, here: bool, message: str) -> None:
    found = cosimulate_diagram(with_lag(lag_fmu(tmp_path), fault=fault, in_process=here), step=H)
    assert found.status == "stopped"
    assert found.message == f"it: {message}"
    assert found.time[-1] == pytest.approx(0.5)
    assert found["it.y"] == pytest.approx(response(found.time, 2.0), abs=1e-17)


def test_a_hang_and_warnings(tmp_path: Path) -> None:
    with open_fmu(lag_fmu(tmp_path), timeout=0.3) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(parameters={"fault": 3}, outputs=["y"])
        slave.exchange(None, 0.0, 0.5)
        with pytest.raises(FmuError) as caught:
            slave.exchange(None, 0.5, H)
    assert caught.value.problems[0].what == "does not answer within 0.3 s, in fmiDoStep (t = 0.5 s)"
    found = cosimulate_diagram(with_lag(lag_fmu(tmp_path), fault="warn", in_process=True), step=H)
    assert found.provenance["fmus"]["it"]["warnings"] == 5


# -- refused -----------------------------------------------------------------------------------------------------------


def instantiated(file: Path, kind: str = "cs", **options: Any) -> str:
    """Return why an FMU cannot be instantiated."""
    with pytest.raises(RotorsimError) as caught, open_fmu(file, **options) as fmu:
        fmu.instantiate(kind)
    return str(caught.value.problems[0])


@pytest.mark.parametrize("here", HERE)
def test_what_cannot_be_instantiated(tmp_path: Path, here: bool) -> None:
    where = os.getcwd()
    tool = lag_fmu(tmp_path, lag_description(implementation="<CoSimulation_Tool><Capabilities/></CoSimulation_Tool>"))
    what = "leaves its work to a tool (CoSimulation_Tool), which is not supported"
    assert instantiated(tool, in_process=here).endswith(f"error: lag: {what}")
    assert information(describe_fmu(tool))["not_supported"] == ["work that is left to a tool (CoSimulation_Tool)"]
    file = lag_fmu(tmp_path, lag_description().replace('guid="{lag}"', 'guid="other"'))
    what = "fmiInstantiateSlave returned no instance\n  it said: Error: wrong guid other, or no place: file:/// (7)"
    assert instantiated(file, in_process=here).endswith(f"error: lag: {what}")
    file = make_fmu(tmp_path / "a.fmu", "1.0", description=lag_description(), library_bytes=library("2.0"))
    what = "its library cannot be loaded: plant.so: undefined symbol: plant_fmi"
    assert what in instantiated(file, in_process=here)
    file = make_fmu(tmp_path / "b.fmu", "1.0", description=lag_description(), library_bytes=b"no library")
    assert "its library cannot be loaded: plant.so: " in instantiated(file, in_process=here)
    file = lag_fmu(tmp_path)
    assert instantiated(file, "me", in_process=here).endswith(
        "error: lag: does not offer Model Exchange; it offers Co-Simulation"
    )
    assert os.getcwd() == where


# -- FMPy as a client --------------------------------------------------------------------------------------------------


def test_fmpy_agrees_on_co_simulation(tmp_path: Path) -> None:
    file = lag_fmu(tmp_path)
    rows = fmpy.simulate_fmu(str(file), stop_time=1.0, output_interval=H, start_values={"u": 2.0}, output=["y"])
    found = cosimulate_diagram(with_lag(file), step=H)
    assert found.time == pytest.approx(rows["time"], abs=1e-12)
    assert found["it.y"] == pytest.approx(1e-3 * rows["y"], abs=1e-15)


def test_fmpy_agrees_on_events(tmp_path: Path) -> None:
    """CVODE of FMPy locates bounces to its tolerance, here 1e-9: ours by Brent's method are exact to rounding."""
    file = events_fmu(tmp_path, "1.0")
    start = {"model": MODELS.index("ball")}
    rows = fmpy.simulate_fmu(
        str(file),
        stop_time=1.0,
        output_interval=0.05,
        start_values=start,
        output=["x", "count"],
        relative_tolerance=1e-9,
    )
    found = cosimulate_diagram(alone(file, "ball", step=0.05, stop=1.0), step=0.05)
    last = np.searchsorted(rows["time"], found.time + 1e-9) - 1  # of an instant that is there twice
    assert np.array_equal(found["it.count"], rows["count"][last])
    assert found["it.x"] == pytest.approx(rows["x"][last], abs=1e-6)
