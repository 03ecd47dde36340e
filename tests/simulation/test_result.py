"""Results: access by name, exact texts, nothing can be changed, provenance."""

import copy
import pickle
import subprocess
import sys
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from rotorsim.simulation.result import Result, flat_name
from rotorsim.simulation.run import simulate


def made(n: int = 7, seed: int = 0) -> Result:
    rng = np.random.default_rng(seed)
    signals = {"rotor.displacement": rng.normal(size=(n, 2)) * 1e-6, "clock.theta": rng.normal(size=n)}
    units = {"rotor.displacement": "m", "clock.theta": "rad"}
    return Result(np.arange(n) * 1e-4, signals, units, "finished", "", {"steps": n}, {"diagram": "test"})


def nodes() -> Result:
    values = np.arange(24.0).reshape(4, 3, 2)
    return Result(np.arange(4.0), {"rotor.displacement": values}, {"rotor.displacement": "m"})


def text_of(call) -> str:
    with pytest.raises(RotorsimError) as caught:
        call()
    return str(caught.value)


def test_flat_names_count_from_one_row_by_row():
    assert nodes().flat_names() == [f"rotor.displacement[{i},{j}]" for i in (1, 2, 3) for j in (1, 2)]
    assert np.array_equal(nodes()["rotor.displacement[3,1]"], nodes().signals["rotor.displacement"][:, 2, 0])
    assert nodes().complex("rotor.displacement[2]")[0] == 2 + 3j


@given(st.lists(st.integers(1, 4), max_size=3))
def test_every_flat_name_finds_its_own_column(shape):
    values = np.arange(2.0 * int(np.prod(shape))).reshape(2, *shape)
    result = Result(np.arange(2.0), {"a.b": values}, {})
    columns = np.column_stack([result.column(name) for name in result.flat_names()])
    assert np.array_equal(columns, values.reshape(2, -1))


def test_a_part_of_a_recorded_part_is_found():
    result = Result(np.arange(2.0), {"rotor.displacement[4]": np.array([[1.0, 2.0], [3.0, 4.0]])}, {})
    assert result["rotor.displacement[4,2]"].tolist() == [2.0, 4.0]
    assert flat_name("rotor.displacement[4]", (1,)) == "rotor.displacement[4,2]"


def test_units_of_parts_are_those_of_the_signal():
    assert (nodes().unit("rotor.displacement[2,1]"), nodes().unit("time")) == ("m", "s")
    assert Result(np.arange(2.0), {"a.b": np.zeros(2)}, {}).unit("a.b") == ""


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("rotor.displacemnt", "this signal was not recorded\n\nhint: did you mean 'rotor.displacement'?"),
        ("amb.force", "this signal was not recorded\n\nhint: recorded: clock.theta, rotor.displacement"),
        ("rotor.displacement[3]", "no such entry; 'rotor.displacement' has shape 2, counted from 1"),
        ("rotor.displacement[0]", "no such entry; 'rotor.displacement' has shape 2, counted from 1"),
        ("rotor.displacement[-1]", "no such entry; 'rotor.displacement' has shape 2, counted from 1"),
        ("rotor.displacement[x]", "no such entry; 'rotor.displacement' has shape 2, counted from 1"),
        ("rotor.displacement[1,1]", "no such entry; 'rotor.displacement' has shape 2, counted from 1"),
        ("rotor.displacement[]", "no such entry; 'rotor.displacement' has shape 2, counted from 1"),
        ("rotor.displacement[1", "this signal was not recorded\n\nhint: did you mean 'rotor.displacement'?"),
        ("clock.theta[1]", "no such entry; 'clock.theta' is a scalar"),
    ],
)
def test_wrong_names_are_explained(name, text):
    assert text_of(lambda: made()[name]) == f"error: {name}: {text}"


def test_a_column_is_one_entry():
    assert text_of(lambda: nodes().column("rotor.displacement")) == (
        "error: rotor.displacement: has 6 entries\n\n"
        "hint: name one of them: 'rotor.displacement[1,1]' .. 'rotor.displacement[3,2]'"
    )
    assert made().column("clock.theta").shape == (7,)


def test_complex_needs_two_axes():
    assert text_of(lambda: made().complex("clock.theta")) == (
        "error: clock.theta: not a two-axis signal\n\nhint: its last dimension must be [x, y]"
    )


def test_all_signals_of_another_length_are_named():
    signals = {"a.b": np.zeros((3, 2)), "c.d": np.zeros(2), "e.f": np.zeros(5)}
    assert text_of(lambda: Result(np.arange(2.0), signals, {})) == (
        "error: a.b: 3 samples, but time has 2\nerror: e.f: 5 samples, but time has 2"
    )
    assert text_of(lambda: Result(np.zeros((2, 1)), {}, {})) == "error: time: must have shape (n,), got (2, 1)"


def test_results_cannot_be_changed():
    result = made()
    with pytest.raises(ValueError, match="read-only"):
        result["clock.theta"][0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        result["rotor.displacement[1]"][0] = 1.0
    with pytest.raises(TypeError):
        result.signals["clock.theta"] = np.zeros(7)
    with pytest.raises(TypeError):
        result.provenance["diagram"] = "other"
    with pytest.raises(FrozenInstanceError):
        result.status = "diverged"


def test_the_arrays_that_were_given_stay_writable():
    values = np.zeros(2)
    Result(np.arange(2.0), {"a.b": values}, {})
    values[0] = 1.0
    assert values[0] == 1.0


def test_equality_is_that_of_every_number_and_text():
    assert made() == made()
    assert made() != made(seed=1)
    assert made() != replace(made(), message="other")
    assert made() != replace(made(), counters={"steps": 8})
    lost = replace(made(), signals={"clock.theta": np.full(7, np.nan)})
    assert lost == replace(lost, message="")


def test_results_travel_between_processes():
    assert pickle.loads(pickle.dumps(made())) == made()
    assert copy.deepcopy(nodes()) == nodes()


def test_importing_results_takes_numpy_alone():
    code = (
        "import sys, rotorsim.simulation.result;"
        "print([m for m in ('scipy', 'casadi', 'networkx', 'matplotlib', 'h5py', 'fmpy') if m in sys.modules])"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


@pytest.mark.slow
def test_xarray_has_units_and_axes():
    data = made().to_xarray()
    assert data["rotor.displacement"].dims == ("time", "axis")
    assert data["rotor.displacement"].attrs["units"] == "m"
    assert data["rotor.displacement"].sel(axis="y").values.tolist() == made()["rotor.displacement[2]"].tolist()


def test_without_xarray_the_cure_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    assert text_of(made().to_xarray) == (
        "error: to_xarray: xarray is not installed\n\nhint: pip install 'rotorsim[xarray]'"
    )


def test_how_results_are_shown():
    assert repr(made()) == "Result(test: finished, 0..0.0006 s, rotor.displacement, clock.theta)"
    many = Result(np.empty(0), {f"a.b{k}": np.empty(0) for k in range(9)}, {}, "stopped")
    assert repr(many) == "Result(: stopped, empty, a.b0, a.b1, a.b2, a.b3, ... 9 signals)"
    html = replace(made(), message="a < b")._repr_html_()
    assert "<td>rotor.displacement</td><td>(2,)</td><td>m</td>" in html
    assert "a &lt; b" in html


def test_a_run_says_what_was_run_and_with_which_values():
    diagram = load("jeffcott", set={"speed": "1800 rpm"}, without=["unbalance"])
    result = simulate(diagram, stop=0.01, parameters={"controller.KP": 1e4})
    found = result.provenance
    assert (found["diagram"], found["method"], found["step"]) == ("jeffcott", "rk4", 1e-4)
    assert found["parameters"]["speed"] == pytest.approx(60 * np.pi, rel=1e-15)
    assert found["parameters_changed"] == {"controller.KP": 1e4}
    assert found["without"] == ["unbalance"]
    assert found["document_sha256"] == diagram.sha256
    assert result.counters["steps"] == 100
    changed = simulate(load("jeffcott"), stop=0.01, parameters={"speed": 100.0})
    assert changed.provenance["parameters"]["speed"] == 100.0
