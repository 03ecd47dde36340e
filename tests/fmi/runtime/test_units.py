"""Units of FMUs: their definitions decide, names where there is none; ports are in SI units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.cosim.cut import open_coupling
from rotorsim.errors import RotorsimError
from rotorsim.fmi.block import block_class
from rotorsim.fmi.description.info import information, information_text
from rotorsim.fmi.description.reader import read_description
from rotorsim.fmi.export.export import export_fmu
from rotorsim.fmi.runtime.slave import describe_fmu
from rotorsim.model.load import load
from rotorsim.units import UnitError, parse_foreign_unit
from tests.fmi.gauge import description, gauge_fmu, with_gauge
from tests.fmi.plant import description2, make_fmu

MYUM = '<Unit name="myum"><BaseUnit m="1" factor="1e-6"/></Unit>'
CELSIUS = '<Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>'


@pytest.mark.parametrize(
    ("units", "y", "unit", "value"),
    [
        (MYUM, 'unit="myum"', "m", 5e-6),
        ("", 'unit="r/min"', "rad/s", 0.52359877559829887),
        ("", 'unit="degC"', "K", 278.15),
        (CELSIUS, 'unit="degC"', "K", 278.15),
        (CELSIUS, 'unit="degC" relativeQuantity="true"', "K", 5.0),
        ("", 'unit="m/s2"', "m/s^2", 5.0),
        ("", 'unit="kg.m2"', "kg.m^2", 5.0),
        ("", 'unit="min-1"', "1/s", 0.083333333333333333),
        ("", 'unit="N.m/rad"', "N.m/rad", 5.0),
        ("", 'unit="mm"', "m", 0.005),
        ('<Unit name="m"><BaseUnit m="1" factor="0.001"/></Unit>', 'unit="m"', "m", 0.005),
        ('<Unit name="Hz"><BaseUnit s="-1"/></Unit>', 'unit="Hz"', "1/s", 5.0),
        ('<Unit name="Hz"><BaseUnit s="-1" rad="1" factor="6.25"/></Unit>', 'unit="Hz"', "rad/s", 31.25),
        ('<Unit name="rad/s"><BaseUnit s="-1"/></Unit>', 'unit="rad/s"', "rad/s", 5.0),
        ('<Unit name="x"><BaseUnit kg="1" m="1" s="-2" factor="1000"/></Unit>', 'unit="x"', "N", 5000.0),
        ('<Unit name="x"><BaseUnit mol="1" m="-3"/></Unit>', 'unit="x"', "mol/m^3", 5.0),
        ('<Unit name="mm"/>', 'unit="mm"', "m", 0.005),
        ("", "", None, 5.0),
    ],
)
def test_outputs_are_in_si_units(tmp_path: Path, units: str, y: str, unit: str | None, value: float) -> None:
    file = gauge_fmu(tmp_path, description(units, y=y))
    assert block_class(file).outputs["y"].unit == unit
    found = cosimulate_diagram(with_gauge(file, more={"value": 5.0}), step=0.5)
    assert found["it.y"].tolist() == pytest.approx([value] * 3, rel=1e-15)


def test_inputs_and_parameters_are_in_si_units(tmp_path: Path) -> None:
    """5 K is -268.15 degC; 3 mm is handed over as 3."""
    file = gauge_fmu(tmp_path, description(CELSIUS, 'unit="degC"', "", 'unit="mm"'))
    found = cosimulate_diagram(with_gauge(file, more={"value": 5.0}, scale="3 mm"), step=0.5)
    assert found["it.y"][-1] == pytest.approx(3 * -268.15, rel=1e-15)
    unwired = with_gauge(file, wires=[], blocks={}, scale=0.004, u="20 K")
    other = with_gauge(file, scale=0.003)
    both = load(
        {**unwired.document, "blocks": {**unwired.document["blocks"], "in": {"type": "constant"}}},
        folder=tmp_path,
        trust_blocks=True,
    )
    assert cosimulate_diagram(both, step=0.5)["it.y"][-1] == pytest.approx(4 * -253.15, rel=1e-15)
    assert other.nodes["it"].values["scale"] == 0.003


def two(folder: Path, y: str, u: str, units: str = MYUM) -> dict[str, object]:
    gauge_fmu(folder, description(units, y=y, real=True), "a.fmu")
    gauge_fmu(folder, description(units, u=u, y=u, real=True), "b.fmu")
    blocks = {n: {"type": "fmu", "file": f"{n}.fmu", "parameters": {"in_process": True}} for n in "ab"}
    return {
        "blocks": {**blocks, "in": {"type": "constant", "parameters": {"value": 5.0}}},
        "wires": [["in.output", "a.u"], ["a.y", "b.u"]],
        "solver": {"step": 0.1, "stop": 1.0},
        "record": ["b.y"],
    }


@pytest.mark.parametrize("fast", [False, True])
def test_a_wire_between_units_converts(tmp_path: Path, fast: bool) -> None:
    found = cosimulate_diagram(
        load(two(tmp_path, 'unit="myum"', 'unit="m"'), folder=tmp_path, trust_blocks=True), step=0.1, fast=fast
    )
    assert found["b.y"][-1] == pytest.approx(5e-6, rel=1e-14)
    assert found.units["b.y"] == "m"


@pytest.mark.parametrize("fast", [False, True])
def test_a_wire_between_offsets_converts(tmp_path: Path, fast: bool) -> None:
    diagram = load(two(tmp_path, 'unit="degC"', 'unit="degF"'), folder=tmp_path, trust_blocks=True)
    found = cosimulate_diagram(diagram, step=0.1, fast=fast)
    assert found["b.y"][-1] == pytest.approx(278.15, rel=1e-14)  # 5 degC are 41 degF


def test_other_dimensions_are_refused(tmp_path: Path) -> None:
    """Exponents decide, not names."""
    units = MYUM + '<Unit name="mym"><BaseUnit A="1"/></Unit>'
    with pytest.raises(RotorsimError) as caught:
        load(two(tmp_path, 'unit="myum"', 'unit="mym"', units), folder=tmp_path, trust_blocks=True)
    assert [problem.what for problem in caught.value.problems] == ["units differ: a.y [m], but b.u [A]"]


def test_units_that_nobody_knows_are_said(tmp_path: Path) -> None:
    diagram = with_gauge(gauge_fmu(tmp_path, description(y='unit="furlong"')))
    assert [(problem.severity, problem.subject, problem.what) for problem in diagram.warnings] == [
        (
            "warning",
            "it",
            "gauge.fmu: y: the unit 'furlong' is neither defined in the FMU nor known: it is taken as it "
            "is and fits all",
        )
    ]
    assert not with_gauge(gauge_fmu(tmp_path, description(MYUM, y='unit="myum"'))).warnings


def test_derivatives_are_in_si_units(tmp_path: Path) -> None:
    """x' = v, v' = u - 100 x - v / 2 with u in kN and y = x in mm."""
    text = description2().replace('unit="N"', 'unit="kN"').replace('unit="m" displayUnit="mm"', 'unit="mm"')
    make_fmu(tmp_path / "plant.fmu", description=text)
    document = {
        "blocks": {
            "it": {"type": "fmu", "file": "plant.fmu", "parameters": {"interface": "me", "in_process": True}},
            "in": {"type": "constant"},
        },
        "wires": [["in.output", "it.u"]],
        "solver": {"step": 0.01, "stop": 0.1},
        "record": ["it.y"],
    }
    coupling = open_coupling(load(document, folder=tmp_path, trust_blocks=True))
    it = next(p for p in coupling.participants if p.name == "it")
    for participant, part in zip(coupling.participants, coupling.u_parts, strict=True):
        participant.initialise(0.0, np.ones(len(coupling.u0))[part])
        participant.start(0.0, np.ones(len(coupling.u0))[part])
    made = it.linear(np.array([True, False]))  # type: ignore[attr-defined]
    why = it.linear(np.array([True, True]))  # type: ignore[attr-defined]
    assert why == "gives others whole numbers or flags (count), which have no derivatives"
    assert it.output(0.0, np.array([2000.0])).tolist() == [0.001, 0.0]
    assert it.output_rate(0.0, np.array([0.0]), np.array([1.0]))[0] == pytest.approx(0.0, abs=1e-6)
    coupling.close()
    assert made.B.tolist() == [[0.0], [0.001]]
    assert made.C.tolist() == [[0.001, 0.0], [0.0, 0.0]]


def test_display_units(tmp_path: Path) -> None:
    """FMI 2.0: shown = factor * value + offset; FMI 3.0 inverse: factor / value."""
    shown = '<DisplayUnit name="rpm" factor="9.5493" offset="1"/>'
    unit = f'<Unit name="rad/s"><BaseUnit s="-1" rad="1"/>{shown}</Unit>'
    text = description(unit, scale='unit="rad/s" displayUnit="rpm"').replace('start="1" unit', 'start="100" unit')
    data = information(read_description(text.encode(), "x"))
    assert next(v["display"] for v in data["variables"]["parameters"] if v["name"] == "scale") == "955.93 rpm"
    assert "100 (955.93 rpm)" in information_text(data)
    three = (
        '<fmiModelDescription fmiVersion="3.0" modelName="n" instantiationToken="t"><CoSimulation modelIdentifier="n"/>'
        '<UnitDefinitions><Unit name="km/l"><BaseUnit m="-2" factor="1e6"/>'
        '<DisplayUnit name="l/(100 km)" inverse="true" factor="100"/></Unit></UnitDefinitions><ModelVariables>'
        '<Float64 name="use" valueReference="1" causality="parameter" variability="fixed" start="20" unit="km/l" '
        'displayUnit="l/(100 km)"/></ModelVariables><ModelStructure/></fmiModelDescription>'
    )
    data = information(read_description(three.encode(), "x"))
    assert data["variables"]["parameters"][0]["display"] == "5 l/(100 km)"
    assert data["variables"]["parameters"][0]["si_factor"] == 1e6


def test_display_units_of_our_own_fmus(tmp_path: Path) -> None:
    """One rad/s is 9.5493 rpm and 0.159155 Hz; one metre is 1000 mm and 1e6 um."""
    export_fmu(load("jeffcott"), tmp_path / "a.fmu", platforms=[])
    units = describe_fmu(tmp_path / "a.fmu").units
    shown = {f"{unit}: {name}": display[0] for unit in ("rad/s", "m") for name, display in units[unit].display.items()}
    assert shown == {
        "rad/s: rpm": pytest.approx(9.549296585513721, rel=1e-12),
        "rad/s: Hz": pytest.approx(0.15915494309189535, rel=1e-12),
        "m: mm": pytest.approx(1e3, rel=1e-12),
        "m: um": pytest.approx(1e6, rel=1e-12),
    }


def test_a_factor_of_zero_is_refused() -> None:
    text = description('<Unit name="x"><BaseUnit m="1" factor="0"/></Unit>')
    with pytest.raises(RotorsimError, match='unit x: factor="0" is no factor'):
        read_description(text.encode(), "x")


@pytest.mark.parametrize(
    ("text", "factor", "dimension"),
    [
        ("W/(m2.K)", 1.0, (0, 1, -3, 0, -1, 0, 0, 0)),
        ("kg.m2.s-2", 1.0, (2, 1, -2, 0, 0, 0, 0, 0)),
        ("J/(kg.degC)", 1.0, (2, 0, -2, 0, -1, 0, 0, 0)),
        ("Nm", 1.0, (2, 1, -2, 0, 0, 0, 0, 0)),
        ("l/min", 1e-3 / 60, (3, 0, -1, 0, 0, 0, 0, 0)),
        ("1/min", 1 / 60, (0, 0, -1, 0, 0, 0, 0, 0)),
        ("mm2", 1e-6, (2, 0, 0, 0, 0, 0, 0, 0)),
        ("rev/min", 0.10471975511965977, (0, 0, -1, 0, 0, 1, 0, 0)),
        ("mmol/m3", 1e-3, (-3, 0, 0, 0, 0, 0, 1, 0)),
        ("S", 1.0, (-2, -1, 3, 2, 0, 0, 0, 0)),
    ],
)
def test_spellings_of_other_tools(text: str, factor: float, dimension: tuple[int, ...]) -> None:
    unit, offset, _ = parse_foreign_unit(text)
    assert unit.factor == pytest.approx(factor, rel=1e-15)
    assert (unit.dimension, offset) == (dimension, 0.0)


def test_what_is_no_unit_stays_none() -> None:
    for text in ("furlong", "m/", "2m", "m2.5", "{count}"):
        with pytest.raises(UnitError):
            parse_foreign_unit(text)
