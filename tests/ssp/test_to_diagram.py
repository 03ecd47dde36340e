"""Systems of FMUs (SSP) in: made by hand, and hostile archives."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import pytest

from rotorsim.errors import RotorsimError
from rotorsim.fmi.description.archive import Limits
from rotorsim.ssp.to_diagram import import_ssp
from tests.fmi.plant import make_fmu
from tests.ssp.systems import (
    MM,
    component,
    document,
    fmu_bytes,
    fmu_text,
    imported,
    refusal,
    system,
    values,
    wire,
    written,
)


def test_components_wires_and_solver(tmp_path: Path) -> None:
    pair = component("a") + component("b.c")
    joined = wire("a.y[1]", "b.c.u[1]") + wire("a.y[2]", "b.c.u[2]") + wire("b.c.s", "a.q") + wire("b.c.y[2]", "a.u[1]")
    found = document(imported(tmp_path, system(pair, joined)))
    assert found["blocks"] == {
        "a": {"type": "fmu", "file": "resources/m.fmu", "parameters": {}},
        "b_c": {"type": "fmu", "file": "resources/m.fmu", "parameters": {}},
    }
    # whole ports where every entry goes to its own; start and end say nothing of the direction
    assert sorted(found["wires"]) == [["a.q", "b_c.s"], ["a.y", "b_c.u"], ["b_c.y[2]", "a.u[1]"]]
    assert found["solver"]["stop"] == 2.0
    assert (tmp_path / "out" / "resources" / "m.fmu").is_file()
    assert not (tmp_path / "out" / "resources" / "mm.fmu").exists()  # nothing refers to it


def test_connections_of_other_units_are_wires(tmp_path: Path) -> None:
    """Ports of FMUs are in SI units."""
    pair = component("a") + component("b", source="resources/mm.fmu", unit="mm")
    joined = wire("a.y[1]", "b.u[1]") + wire("a.y[2]", "b.u[2]") + wire("b.y[1]", "a.u[2]")
    found = document(imported(tmp_path, system(pair, joined, units=MM)))
    assert {name: block["type"] for name, block in found["blocks"].items()} == {"a": "fmu", "b": "fmu"}
    assert sorted(found["wires"]) == [["a.y", "b.u"], ["b.y[1]", "a.u[2]"]]


def test_angles_may_be_left_out_of_definitions(tmp_path: Path) -> None:
    """The system defines rad/s with and the FMU without rad, or both without it."""
    text = fmu_text("spin", "rad/s").replace('m="1" factor="1.0"', 's="-1"')
    for more in ("", 'rad="1"'):
        units = f'<ssc:Unit name="rad/s"><ssc:BaseUnit s="-1" {more}/></ssc:Unit>'
        pair = component("a", source="resources/w.fmu", unit="rad/s") + component("b", source="resources/w.fmu")
        made = tmp_path / f"system{len(more)}"
        made.mkdir()
        done = imported(made, system(pair, wire("a.y[1]", "b.u[1]"), units=units), w__fmu=fmu_bytes(made, text))
        assert document(done)["wires"] == [["a.y[1]", "b.u[1]"]]
        assert done.diagram.nodes["b"].inputs["u"].unit == "rad/s"


@pytest.mark.parametrize(
    ("suppress", "factor", "gain"),
    [("false", "2", 2.0), ("true", "1", 1e-3), ("true", "2000", 2.0), ("false", "0.001", 1e-3)],
)
def test_factors_come_after_units(tmp_path: Path, suppress: str, factor: str, gain: float) -> None:
    """Not converted, 1 m is handed over as the number 1, which is 1 mm."""
    pair = component("a") + component("b", source="resources/mm.fmu")
    linear = f'<ssc:LinearTransformation factor="{factor}"/>'
    joined = wire("a.y[1]", "b.u[1]", linear, suppressUnitConversion=suppress)
    found = document(imported(tmp_path, system(pair, joined)))
    assert found["blocks"]["b_u_gain"]["parameters"]["gain"] == pytest.approx(gain, rel=1e-15)


def test_nested_systems_are_flattened_and_outer_values_win(tmp_path: Path) -> None:
    ports = (
        '<ssd:Connectors><ssd:Connector name="in" kind="input"><ssc:Real/></ssd:Connector>'
        '<ssd:Connector name="out" kind="output"/><ssd:Connector name="gain" kind="parameter"/></ssd:Connectors>'
    )
    own = '<ssd:Connectors><ssd:Connector name="s" kind="input"/><ssd:Connector name="q" kind="output"/>'
    own += '<ssd:Connector name="c" kind="parameter"/></ssd:Connectors>'
    deep = f'<ssd:Component name="a" source="resources/m.fmu">{own}{values(("k[2]", 7), ("k[1]", 8))}</ssd:Component>'
    joined = wire("in", "a.s") + wire("a.q", "out") + wire("gain", "a.c")
    sub = (
        f'<ssd:System name="left">{ports}{values(("a.k[1]", 9))}<ssd:Elements>{deep}</ssd:Elements>'
        f"<ssd:Connections>{joined}</ssd:Connections></ssd:System>"
    )
    top = '<ssd:Connectors><ssd:Connector name="result" kind="output"/><ssd:Connector name="free" kind="input"/>'
    top += "</ssd:Connectors>" + values(("left.gain", 3), ("nobody", 1))
    outer = wire("left.out", "b.s") + wire("b.q", "left.in") + wire("left.out", "result") + wire("free", "b.u[1]")
    done = imported(tmp_path, system(sub + component("b"), outer, before=top))
    found = document(done)
    assert found["blocks"]["left_a"]["parameters"] == {"c": 3.0, "k": [9.0, 7.0]}
    assert sorted(found["wires"]) == [["b.q", "left_a.s"], ["left_a.q", "b.s"]]
    assert found["record"] == ["left_a.q"]  # what leaves the system
    said = "\n".join(str(warning) for warning in done.warnings)
    assert "nobody" in said
    assert "inputs of the whole system, which nothing feeds: free" in said


def test_values_are_in_the_units_that_they_state(tmp_path: Path) -> None:
    given = values(("k[2]", 4000), unit="mm", units=f"<ssv:Units>{MM}</ssv:Units>")
    done = imported(tmp_path, system(component("a", given) + component("b", values(("u[2]", 3)))))
    blocks = document(done)["blocks"]
    assert blocks["a"]["parameters"] == {"k": [1.0, 4.0]}
    assert blocks["b"]["parameters"] == {"u": [0.0, 3.0]}  # nothing feeds it: its start value


def test_arrays_of_ssp_2(tmp_path: Path) -> None:
    """Connectors of FMI 3.0 are arrays: whole, or entry by entry."""
    make_fmu(tmp_path / "plant.fmu", "3.0", library_bytes=b"none")
    plant = (tmp_path / "plant.fmu").read_bytes()
    (tmp_path / "plant.fmu").unlink()
    ports = "".join(
        f'<ssd:Connector name="{n}" kind="{k}"><ssc:Float64/><ssc:Dimension size="2"/></ssd:Connector>'
        for n, k in (("u", "input"), ("y", "output"))
    )
    both = "".join(
        f'<ssd:Component name="{n}" source="resources/p.fmu"><ssd:Connectors>{ports}</ssd:Connectors></ssd:Component>'
        for n in "ab"
    )
    plain = wire("a.y", "b.u", suppressUnitConversion="true")
    crossed = wire("b.y", "a.u", suppressUnitConversion="true", startIndices="2", endIndices="1")
    with pytest.raises(RotorsimError, match=re.escape("units do not fit: m into N")):
        imported(tmp_path, system(both, wire("a.y", "b.u"), version="2.0"), p__fmu=plant)
    linear = '<ssc:LinearTransformation factor="3"/>'
    joined = plain.replace("></ssd", f">{linear}</ssd") + crossed.replace("></ssd", f">{linear}</ssd")
    found = document(imported(tmp_path, system(both, joined, version="2.0"), p__fmu=plant))
    assert ["a.y", "b_u_gain.input"] in found["wires"]
    assert ["b.y[2]", "a_u_gain.input"] in found["wires"]
    assert ["a_u_gain.output", "a.u[1]"] in found["wires"]


@pytest.mark.parametrize(
    ("elements", "joined", "what"),
    [
        (
            component("a"),
            wire("a.y[1]", "a.y[11]"),
            "element 'a' has no connector 'y[11]'\n\nhint: did you mean 'y[1]'",
        ),
        (component("a"), wire("a.y[1]", "b.s"), "element 'b' has no connector 's'"),
        (component("a"), wire("a.y[1]", "a.s") + wire("a.q", "a.s"), "is fed by two connections"),
        (component("a"), wire("a.y[1]", "a.q"), "two sources are connected"),
        (component("a", source="../m.fmu"), "", "the name leaves its folder"),
        (component("a", source="file:///etc/passwd"), "", "it is not relative"),
        (component("a", source="http://x/m.fmu"), "", "it is not relative"),
        (component("a", source="resources/%2e%2e/%2e%2e/m.fmu"), "", "the name leaves its folder"),
        (component("a", source="resources/none.fmu"), "", "there is no such file"),
        (component("a", source="#other"), "", "a part of a document is not supported"),
        (component("a") + component("a"), "", "is the name of two elements"),
        ('<ssd:SignalDictionaryReference name="d" dictionary="x"/>', "", "SignalDictionaryReference is not supported"),
        (component("a", values(("c", "five"))), "", "is not of type Real"),
        (component("a", values(("q", 1))), "", "cannot be set"),
        (component("a", unit="mm"), "", "the connector is in mm, the variable of the FMU in m"),
        (component("a").replace('source="', 'type="application/x-ssp-package" source="'), "", "only FMUs"),
        (component("a").replace('source="', 'implementation="ScheduledExecution" source="'), "", "not supported"),
        (component("a").replace('name="q" kind="output"', 'name="q" kind="input"'), "", "is of kind input"),
        (component("a").replace('name="q"', 'name="zz"'), "", "the FMU has no variable of this name"),
    ],
)
def test_what_is_wrong_or_not_supported_is_named(tmp_path: Path, elements: str, joined: str, what: str) -> None:
    assert what in refusal(tmp_path, system(elements, joined))


def test_systems_that_feed_themselves(tmp_path: Path) -> None:
    ports = '<ssd:Connectors><ssd:Connector name="i" kind="input"/><ssd:Connector name="o" kind="output"/>'
    ports += "</ssd:Connectors>"
    sub = f'<ssd:System name="s">{ports}<ssd:Connections>{wire("i", "o")}</ssd:Connections></ssd:System>'
    joined = wire("s.o", "s.i") + wire("s.o", "a.s")
    assert "in a circle" in refusal(tmp_path, system(sub + component("a"), joined))


# ---- hostile archives ----


def test_a_document_type_is_refused(tmp_path: Path) -> None:
    text = '<!DOCTYPE x [<!ENTITY a "b">]>' + system(component("a"))
    assert "a document type" in refusal(tmp_path, text)


@pytest.mark.parametrize("name", ["../evil", "/evil", "a/../../evil", "C:/evil", "..\\evil"])
def test_names_that_leave_the_folder_are_refused(tmp_path: Path, name: str) -> None:
    file = written(tmp_path, system(component("a")))
    with zipfile.ZipFile(file, "a") as archive:
        entry = zipfile.ZipInfo("x")
        entry.filename = entry.orig_filename = name
        archive.writestr(entry, b"evil")
    with pytest.raises(RotorsimError, match="the name"):
        import_ssp(file, tmp_path / "out")
    assert not list(tmp_path.rglob("evil"))
    assert not (tmp_path / "out").exists()


def test_a_bomb_is_refused(tmp_path: Path) -> None:
    file = written(tmp_path, system(component("a")), zeros__bin=bytes(1 << 20))
    with pytest.raises(RotorsimError, match="bomb"):
        import_ssp(file, tmp_path / "out", limits=Limits(ratio=2.0, free=1 << 16))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "text", ["", "<x/>", "<ssd:SystemStructureDescription/>", "<a>" * 40, system("", version="3.0"), system("")]
)
def test_what_is_no_system_is_refused(tmp_path: Path, text: str) -> None:
    assert refusal(tmp_path, text)


def test_a_folder_in_use_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("kept")
    with pytest.raises(RotorsimError, match="not empty"):
        import_ssp(written(tmp_path, system(component("a"))), tmp_path / "out")
    assert (tmp_path / "out" / "mine").read_text() == "kept"
