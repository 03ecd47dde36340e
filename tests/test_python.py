"""What a person who works in Python or in a notebook meets: names, signatures, units, results that can be seen."""

from __future__ import annotations

import inspect
import pickle

import numpy as np
import pytest

import rotorsim
from rotorsim import RotorsimError, load

PARAMETERS = (
    ("speed", "1800", "'1800' has no unit\n\nhint: write '1800 rad/s', or a number without quotes (SI)"),
    (
        "speed",
        "3 um",
        "unit 'um' does not fit 'rad/s'\n\nhint: give an angular speed in rad/s, rpm or Hz (revolutions per second)",
    ),
    ("speed", float("nan"), "must be a finite number"),
    ("speed", [1.0, 2.0], "2 values given, 1 expected"),
    ("rotor.mass", -1, "-1 kg must be greater than 0 kg"),
    ("rotor.mass", "2 lbs", "unknown unit 'lbs'\n\nhint: did you mean 'lb' or 'lbf'?"),
)


@pytest.fixture(scope="module")
def jeffcott():
    return load("jeffcott")


def test_texts_with_units_are_parameters(jeffcott) -> None:
    run = rotorsim.simulate(jeffcott, parameters={"speed": "1800 rpm", "controller.KP": "12 A/mm"}, stop=0.01)
    assert run.provenance["parameters"]["speed"] == pytest.approx(1800 * np.pi / 30, rel=1e-15)
    assert run.provenance["parameters_changed"]["controller.KP"] == 12000.0


@pytest.mark.parametrize(("name", "value", "text"), PARAMETERS)
@pytest.mark.parametrize("verb", ["simulate", "modes", "periodic", "linearise"])
def test_parameters_that_cannot_be_are_refused(jeffcott, verb: str, name: str, value, text: str) -> None:
    with pytest.raises(RotorsimError) as caught:
        getattr(rotorsim, verb)(jeffcott, parameters={name: value})
    assert str(caught.value) == f"error: {name}: {text}"


def test_values_of_a_diagram_cannot_be_changed(jeffcott) -> None:
    refused = (
        "error: the values of a diagram cannot be changed\n\nhint: give them to the analysis: simulate(diagram, "
        'parameters={"speed": "1800 rpm"}), or load the diagram with them: load("jeffcott", set={"speed": "1800 rpm"})'
    )
    for values in (jeffcott.parameters, jeffcott.nodes["rotor"].values):
        for change in (lambda v: v.__setitem__("speed", 300), lambda v: v.update(speed=300), lambda v: v.pop("speed")):
            with pytest.raises(RotorsimError) as caught:
                change(values)
            assert str(caught.value) == refused
        with pytest.raises(ValueError, match="read-only"):
            next(iter(values.values()))[...] = 300
        again = pickle.loads(pickle.dumps(values))
        assert type(again) is type(values)
        assert str(again) == str(values)


@pytest.mark.parametrize("name", ["simulate", "periodic", "modes", "campbell", "linearise", "margins"])
def test_analyses_are_called_alike(name: str) -> None:
    """The diagram first, what it is analysed for by keyword: `parameters` among it."""
    parameters = inspect.signature(getattr(rotorsim, name)).parameters.values()
    positional = [one.name for one in parameters if one.kind is one.POSITIONAL_OR_KEYWORD]
    assert positional in (["diagram"], ["diagram", "ports"])
    assert "parameters" in {one.name for one in parameters if one.kind is one.KEYWORD_ONLY}


def test_results_have_a_short_text_a_table_and_a_figure(jeffcott) -> None:
    speeds = np.array([100.0, 200.0])
    beam = load("fe_rigid", without=["crack"])
    one = rotorsim.frequency_response(jeffcott, "amb.force", "rotor.displacement", frequencies=[1.0, 9.0])
    found = {
        "Result(jeffcott: finished, 0..0.5 s, rotor.displacement, controller.current, clock.theta)": rotorsim.simulate(
            jeffcott, stop=0.5
        ),
        "Periodic(jeffcott: 2 speeds, 954.93..1909.86 rpm, rotor.displacement)": rotorsim.periodic(
            jeffcott, speeds=speeds, signals=["rotor.displacement"]
        ),
        "Modes(jeffcott: stable, 2 modes: 121.38 Hz, 121.38 Hz)": rotorsim.modes(jeffcott),
        "Campbell(fe_rigid: 20 modes, 954.93..1909.86 rpm, no critical speed)": rotorsim.campbell(
            beam, speeds=speeds, orders=(1,)
        ),
        "FrequencyResponse(rotor.displacement[1], rotor.displacement[2] / amb.force[1], amb.force[2]: 1..9 Hz)": one,
    }
    for text, result in found.items():
        assert repr(result) == text
        assert text.partition(":")[0] in result._repr_html_()
        assert len(result.plot().axes) >= 1
    assert repr(jeffcott) == f"Diagram(jeffcott: 8 blocks, 14 wires, {jeffcott.file})"
    assert jeffcott._repr_html_().startswith("<svg")


@pytest.mark.slow
def test_results_over_speed_are_datasets(jeffcott) -> None:
    pytest.importorskip("xarray")
    speeds = np.array([100.0, 200.0])
    settled = rotorsim.periodic(jeffcott, speeds=speeds).to_xarray()
    assert dict(settled.sizes) == {"speed": 2, "order": 23}
    assert settled["rotor.displacement"].attrs == {"units": "m"}
    modes = rotorsim.campbell(load("fe_rigid"), speeds=speeds).to_xarray()
    assert dict(modes["frequency_hz"].sizes) == {"speed": 2, "mode": 20}
    response = rotorsim.frequency_response(jeffcott, "amb.force", "rotor.displacement", frequencies=[5.0])
    assert response.to_xarray().sel(output="rotor.displacement[1]", input="amb.force[2]").shape == (1,)
