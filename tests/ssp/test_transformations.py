"""Systems of FMUs (SSP) in: mappings, factors and offsets, connectors of systems, units; numbers by the standard."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.errors import RotorsimError
from rotorsim.model.emit.toolchain import find_compiler
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from rotorsim.ssp.to_diagram import import_ssp
from tests.fmi.plant import make_fmu
from tests.ssp.systems import (
    MM,
    SPACES,
    component,
    document,
    entry,
    fmu_bytes,
    fmu_text,
    imported,
    linear,
    mapping,
    parameter_set,
    ports,
    refusal,
    system,
    table,
    typed_fmu,
    values,
    wire,
    written,
)

UNITS = f"<ssv:Units>{MM}</ssv:Units>"


def parameters(folder: Path, text: str, block: str = "a", **more: bytes) -> dict[str, Any]:
    found: dict[str, Any] = document(imported(folder, text, **more))["blocks"][block]["parameters"]
    return found


def said(folder: Path, text: str, **more: bytes) -> list[str]:
    """Return what is said of a system: place in its file, severity, subject, what."""
    done = imported(folder, text, **more)
    return [str(w).partition("made.ssp/")[2].partition("\n")[0] for w in done.warnings if "made.ssp/" in str(w)]


# ---- mappings ----


@pytest.mark.parametrize(("suppress", "value"), [("false", 2 * 4.0 + 1), ("true", 2 * 4000.0 + 1)])
def test_a_mapping_transforms_after_units_or_instead(tmp_path: Path, suppress: str, value: float) -> None:
    """4000 mm for a parameter in m: SSP 2.0, "MappingEntry"."""
    one = entry("length", "k[2]", linear(2, 1), suppressUnitConversion=suppress)
    given = values(("length", 4000), unit="mm", units=UNITS, map=mapping(one))
    assert parameters(tmp_path, system(component("a", given))) == {"k": [1.0, value]}


def test_only_what_is_mapped_counts_under_its_new_names(tmp_path: Path) -> None:
    """k[1] is not mapped, c is mapped away; one parameter may have two targets."""
    both = mapping(entry("c", "k[2]"), entry("c", "s"))
    assert parameters(tmp_path, system(component("a", values(("k[1]", 7), ("c", 9), map=both)))) == {
        "k": [1.0, 9.0],
        "s": 9.0,
    }


def test_prefixes_come_before_a_mapping_and_outer_values_win(tmp_path: Path) -> None:
    inner = component("a", values(("c", 1), ("k[1]", 2), ("k[2]", 3)))
    sub = f'<ssd:System name="left">{values(("gain", 20), map=mapping(entry("gain", "a.k[1]")))}'
    sub += f"<ssd:Elements>{inner}</ssd:Elements></ssd:System>"
    one = values(("gain", 30), prefix="set.", map=mapping(entry("set.gain", "left.a.c", linear(10, 5))))
    two = values(("gain", 400), prefix="set.", map=mapping(entry("gain", "left.a.k[2]")))
    before = (one + two).replace("</ssd:ParameterBindings><ssd:ParameterBindings>", "")
    done = imported(tmp_path, system(sub, before=before))
    assert document(done)["blocks"]["left_a"]["parameters"] == {"c": 10 * 30.0 + 5, "k": [20.0, 3.0]}
    assert "root: 1 of 1 entries map what is not among the parameters: 'gain'" in str(done.warnings[0])


def test_files_of_values_and_of_a_mapping(tmp_path: Path) -> None:
    spaces = "".join(
        f' xmlns:{short}="http://ssp-standard.org/SSP1/SystemStructure{SPACES[short]}"'
        for short in ("ssc", "ssv", "ssm")
    )
    binding = '<ssd:ParameterBindings><ssd:ParameterBinding source="resources/p.ssv"><ssd:ParameterMapping'
    binding += ' source="resources/p.ssm"/></ssd:ParameterBinding></ssd:ParameterBindings>'
    files = {
        "p__ssv": parameter_set(("stiffness", 3), more=spaces).encode(),
        "p__ssm": mapping(entry("stiffness", "c", linear(4, 5)), more=spaces).encode(),
    }
    blocks = document(imported(tmp_path, system(component("a", binding) + component("b", binding)), **files))["blocks"]
    assert [blocks[name]["parameters"] for name in "ab"] == [{"c": 17.0}, {"c": 17.0}]


@pytest.mark.parametrize(
    ("kind", "given", "change", "target", "found"),
    [
        ("Boolean", "false", table("Boolean", ("false", "true")), "flag", {"flag": True}),
        ("Boolean", "true", table("Boolean", ("false", "true")), "flag", {"flag": True}),  # kept: not in the table
        ("Integer", "3", table("Integer", ("3", "5"), ("4", "6")), "count", {"count": 5}),
        ("Integer", "7", table("Integer", ("3", "5")), "count", {"count": 7}),
        ("Enumeration", "rapid", table("Enumeration", ("rapid", "fast")), "mode", {"mode": "fast"}),
        ("Enumeration", "fast", "", "mode", {"mode": "fast"}),
        ("Enumeration", "slow", "", "mode", {}),  # as the FMU has it
        ("String", "a b", "", "word", {"word": "a b"}),
        ("Boolean", "1", "", "on", {"on": True}),
        ("Boolean", "false", "", "on", {}),
    ],
)
def test_values_that_are_no_numbers(
    tmp_path: Path, kind: str, given: str, change: str, target: str, found: dict[str, Any]
) -> None:
    binding = values(("x", given), kind=kind, map=mapping(entry("x", target, change)))
    text = system(component("a", binding, source="resources/t.fmu"))
    assert parameters(tmp_path, text, t__fmu=typed_fmu(tmp_path)) == found


# ---- connections ----


@pytest.mark.parametrize(
    ("suppress", "factor", "offset", "gain", "constant"),
    [
        ("false", 2.0, 5.0, 2.0, 5e-3),  # 5 mm
        ("false", 1.0, 5.0, None, 5e-3),
        ("true", 1.0, 5.0, 1e-3, 5e-3),  # the number of metres plus 5, as millimetres
        ("true", 1000.0, 0.0, None, None),
    ],
)
def test_offsets_are_in_the_unit_of_the_target(
    tmp_path: Path, suppress: str, factor: float, offset: float, gain: float | None, constant: float | None
) -> None:
    pair = component("a") + component("b", source="resources/mm.fmu")
    joined = "".join(
        wire(f"a.y[{k}]", f"b.u[{k}]", linear(factor, offset), suppressUnitConversion=suppress) for k in (1, 2)
    )
    found = document(imported(tmp_path, system(pair, joined)))
    blocks = {name: block.get("parameters") for name, block in found["blocks"].items() if name not in "ab"}
    start, wires = "a.y", []
    if gain is not None:
        assert blocks.pop("b_u_gain") == {"gain": pytest.approx(gain, rel=1e-15)}
        wires += [[start, "b_u_gain.input"]]
        start = "b_u_gain.output"
    if constant is not None:
        assert blocks.pop("b_u_offset") == {"value": pytest.approx([constant, constant], rel=1e-15)}
        assert blocks.pop("b_u_sum") is None
        wires += [[start, "b_u_sum.input1"], ["b_u_offset.output", "b_u_sum.input2"]]
        start = "b_u_sum.output"
    assert found["wires"] == [*wires, [start, "b.u"]]
    assert not blocks


def test_offsets_of_units_and_of_connections_add(tmp_path: Path) -> None:
    """2 theta + 1 in degC is 2 (T - 273.15) + 1 + 273.15 in K, in which both ports are."""
    text = fmu_text("room", "degC").replace('m="1" factor="1.0"', 'K="1" offset="273.15"')
    pair = component("a", source="resources/t.fmu") + component("b", source="resources/t.fmu")
    found = document(
        imported(tmp_path, system(pair, wire("a.y[1]", "b.u[1]", linear(2, 1))), t__fmu=fmu_bytes(tmp_path, text))
    )
    assert found["blocks"]["b_u_gain"]["parameters"] == {"gain": 2.0}
    assert found["blocks"]["b_u_offset"]["parameters"] == {"value": pytest.approx(1 - 273.15, rel=1e-14)}


@pytest.mark.parametrize(
    ("pairs", "gain", "constant"),
    [((("true", "false"), ("false", "true")), -1.0, 1.0), ((("true", "false"),), 0.0, None)],
)
def test_a_flag_is_mapped_as_the_numbers_0_and_1(
    tmp_path: Path, pairs: tuple[tuple[str, str], ...], gain: float, constant: float | None
) -> None:
    own = '<ssd:Connectors><ssd:Connector name="on" kind="input"><ssc:Boolean/></ssd:Connector>'
    own += '<ssd:Connector name="lit" kind="output"><ssc:Boolean/></ssd:Connector></ssd:Connectors>'
    both = "".join(f'<ssd:Component name="{n}" source="resources/t.fmu">{own}</ssd:Component>' for n in "ab")
    text = system(both, wire("a.lit", "b.on", table("Boolean", *pairs)))
    blocks = document(imported(tmp_path, text, t__fmu=typed_fmu(tmp_path)))["blocks"]
    assert blocks["b_on_gain"]["parameters"] == {"gain": gain}
    assert blocks.get("b_on_offset", {"parameters": {"value": None}})["parameters"] == {"value": constant}


def gears(folder: Path, name: str, items: dict[str, int]) -> bytes:
    """Return an FMU with a whole number and an item in and out."""
    rows = [
        ("n", "input", 'Integer start="0"'),
        ("m", "output", "Integer"),
        ("gear", "input", 'Enumeration declaredType="Gear" start="1"'),
        ("now", "output", 'Enumeration declaredType="Gear"'),
    ]
    more = "".join(
        f'<ScalarVariable name="{n}" valueReference="{k}" causality="{c}" variability="discrete">'
        f"<{t}/></ScalarVariable>"
        for k, (n, c, t) in enumerate(rows)
    )
    shown = "".join(f'<Item name="{item}" value="{value}"/>' for item, value in items.items())
    return fmu_bytes(
        folder,
        f'<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{name}">'
        f'<CoSimulation modelIdentifier="{name}"/>'
        f'<TypeDefinitions><SimpleType name="Gear"><Enumeration>{shown}</Enumeration></SimpleType></TypeDefinitions>'
        f"<ModelVariables>{more}</ModelVariables>"
        '<ModelStructure><Outputs><Unknown index="2"/><Unknown index="4"/></Outputs></ModelStructure>'
        "</fmiModelDescription>",
    )


def geared(folder: Path, connections: str) -> dict[str, Any]:
    """Return the diagram of two such FMUs, whose items have other numbers."""
    kinds = {"n": "input", "gear": "input", "m": "output", "now": "output"}
    types = {"n": "Integer", "m": "Integer", "gear": 'Enumeration name="Gear"', "now": 'Enumeration name="Gear"'}
    own = "".join(f'<ssd:Connector name="{n}" kind="{k}"><ssc:{types[n]}/></ssd:Connector>' for n, k in kinds.items())
    own = f"<ssd:Connectors>{own}</ssd:Connectors>"
    both = "".join(f'<ssd:Component name="{n}" source="resources/{n}.fmu">{own}</ssd:Component>' for n in "ab")
    files = {"a__fmu": gears(folder, "a", {"low": 1, "high": 2}), "b__fmu": gears(folder, "b", {"high": 7, "slow": 9})}
    return document(imported(folder, system(both, connections), **files))


def test_whole_numbers_are_mapped_and_others_stay(tmp_path: Path) -> None:
    """3 becomes 5, 4 becomes 0, all others are what they were, also outside the table."""
    found = geared(tmp_path, wire("a.m", "b.n", table("Integer", ("3", "5"), ("4", "0"))))
    assert found["wires"] == [["a.m", "b_n_map.input"], ["b_n_map.output", "b.n"]]
    block = found["blocks"]["b_n_map"]
    assert block["type"] == "lookup_table"
    diagram = load(
        {
            "name": "map",
            "blocks": {"ramp": {"type": "ramp", "parameters": {"slope": 1.0}}, "map": block},
            "wires": [["ramp.output", "map.input"]],
            "solver": {"step": 1.0, "stop": 9.0},
            "record": ["map.output"],
        }
    )
    assert list(simulate(diagram)["map.output"]) == [0.0, 1.0, 2.0, 5.0, 0.0, 5.0, 6.0, 7.0, 8.0, 9.0]


def test_items_are_mapped_by_their_names_to_the_numbers_of_the_other(tmp_path: Path) -> None:
    found = geared(tmp_path, wire("a.now", "b.gear", table("Enumeration", ("low", "slow"))))
    given = found["blocks"]["b_gear_map"]["parameters"]
    known = dict(zip(given["breakpoints"], given["values"], strict=True))
    assert (known[1.0], known[2.0]) == (9.0, 7.0)  # low is slow, high is high


def test_mappings_that_have_no_meaning_are_refused(tmp_path: Path) -> None:
    """Items that the target has not; numbers that are not whole; a way out of the system; a factor on the way."""
    with pytest.raises(RotorsimError, match=r"b\.gear: item 'low' comes as 'fast', which is none of its items"):
        geared(tmp_path, wire("a.now", "b.gear", table("Enumeration", ("low", "fast"))))
    one = table("Integer", ("1", "2"))
    bare = "".join(
        f'<ssd:Component name="{n}" source="resources/m.fmu"><ssd:Connectors><ssd:Connector name="q" kind="output"/>'
        '<ssd:Connector name="s" kind="input"/></ssd:Connectors></ssd:Component>'
        for n in "ab"
    )
    sub = '<ssd:System name="s"><ssd:Connectors><ssd:Connector name="way" kind="input"/></ssd:Connectors>'
    sub += f"<ssd:Elements>{bare}</ssd:Elements><ssd:Connections>{wire('way', 'b.s', linear(2))}</ssd:Connections>"
    out = '<ssd:Connectors><ssd:Connector name="out" kind="output"/></ssd:Connectors>'
    cases = {
        "real": (system(bare, wire("a.q", "b.s", one)), "b.s: whole numbers are mapped, and q is of type Float64"),
        "out": (
            system(bare, wire("a.q", "out", one), before=out),
            "out: values are mapped on their way out of the whole system, which is not supported",
        ),
        "factor": (
            system(bare.replace('"a"', '"c"') + f"{sub}</ssd:System>", wire("c.q", "s.way", one)),
            "c.q -> s.b.s: a mapping of values and a factor or offset are on one way, which is not supported",
        ),
    }
    for name, (text, what) in cases.items():
        (tmp_path / name).mkdir()
        assert what in refusal(tmp_path / name, text)


# ---- connectors of systems ----


def test_a_value_of_the_whole_system_goes_through_nested_systems(tmp_path: Path) -> None:
    """0.5 m, 2 (.) + 1 in mm, the unit of what the inner connector feeds, then 3 (.) in mm."""
    inner = component("a", source="resources/mm.fmu")
    deep = f'<ssd:System name="deep">{ports(way="input")}<ssd:Elements>{inner}</ssd:Elements>'
    deep += f"<ssd:Connections>{wire('way', 'a.u[2]', linear(3))}</ssd:Connections></ssd:System>"
    sub = f'<ssd:System name="sub">{ports(into="input")}<ssd:Elements>{deep}</ssd:Elements>'
    sub += f"<ssd:Connections>{wire('into', 'deep.way', linear(2, 1))}</ssd:Connections></ssd:System>"
    metre = '<ssc:Unit name="m"><ssc:BaseUnit m="1"/></ssc:Unit>'
    given = ports(free="input m") + values(("free", 0.5), unit="m")
    outer = wire("free", "sub.into").replace("<ssd:Connection ", '<ssd:Connection startElement="" ')
    found = parameters(tmp_path, system(sub, outer, before=given, units=metre), "sub_deep_a")
    assert found == {"u": [0.0, pytest.approx(1e-3 * 3 * (2 * 500 + 1), rel=1e-15)]}


def test_a_mapping_onto_a_connector_of_a_system(tmp_path: Path) -> None:
    """The mapping gives 4 (7) + 5, the connection 10 (.)."""
    given = ports(gain="parameter") + values(("p", 7), map=mapping(entry("p", "gain", linear(4, 5))))
    own = '<ssd:Connectors><ssd:Connector name="c" kind="parameter"/></ssd:Connectors>'
    only = f'<ssd:Component name="a" source="resources/m.fmu">{own}{values(("c", 1))}</ssd:Component>'
    assert parameters(tmp_path, system(only, wire("gain", "a.c", linear(10)), before=given)) == {"c": 330.0}


def test_outputs_of_the_whole_system_are_recorded_as_it_gives_them(tmp_path: Path) -> None:
    """In SI units: 2 (.) + 3 in mm is 2 y + 3e-3 in m."""
    top = ports(plain="output", shown="output mm", silent="output", free="input", unused="input")
    joined = (
        wire("a.y[1]", "plain") + wire("a.y[2]", "shown", linear(2, 3)) + wire("free", "a.u[1]") + wire("free", "a.s")
    )
    done = imported(tmp_path, system(component("a"), joined, before=top, units=MM))
    found = document(done)
    assert found["record"] == ["a.y[1]", "shown_sum.output"]
    assert found["wires"] == [
        ["a.y[2]", "shown_gain.input"],
        ["shown_gain.output", "shown_sum.input1"],
        ["shown_offset.output", "shown_sum.input2"],
    ]
    assert found["blocks"]["shown_gain"]["parameters"] == {"gain": 2.0}
    assert found["blocks"]["shown_offset"]["parameters"] == {"value": pytest.approx(3e-3, rel=1e-15)}
    assert [str(warning) for warning in done.warnings] == [
        "warning: made: outputs of the whole system that no component feeds, or whose size is not said: silent"
        "\n\nhint: they are not recorded; record what feeds them in the diagram",
        "warning: made: inputs of the whole system, which nothing feeds: free (a.u[1], a.s)"
        "\n\nhint: what they feed keeps its start value; wire a source in the diagram",
    ]


def test_the_value_of_a_connector_that_is_fed_only_stands_in(tmp_path: Path) -> None:
    sub = f'<ssd:System name="s">{ports(way="input")}{values(("way", 8))}<ssd:Elements>{component("b")}</ssd:Elements>'
    sub += f"<ssd:Connections>{wire('way', 'b.s')}</ssd:Connections></ssd:System>"
    done = imported(tmp_path, system(component("a") + sub, wire("a.q", "s.way")))
    found = document(done)
    assert found["wires"] == [["a.q", "s_b.s"]]
    assert found["blocks"]["s_b"]["parameters"] == {}
    assert not done.warnings


# ---- units that are not declared ----


def test_a_unit_that_is_not_declared_means_what_its_name_says(tmp_path: Path) -> None:
    given = values(("k[2]", 4000), ("k[1]", 3000), unit="mm")
    text = system(component("a", given))
    assert parameters(tmp_path, text) == {"k": [3.0, 4.0]}
    column = text.index("<ssv:Real") + 1
    (tmp_path / "again").mkdir()
    assert said(tmp_path / "again", text) == [
        f"SystemStructure.ssd:1:{column}: warning: the unit 'mm' is not among the Units of the file: "
        "it is taken by its name"
    ]


def test_a_unit_that_nobody_knows_fits_all(tmp_path: Path) -> None:
    text = system(component("a", values(("k[2]", 4), unit="[m]")))
    column = text.index("<ssv:Real") + 1
    assert said(tmp_path, text) == [
        f"SystemStructure.ssd:1:{column}: warning: the unit '[m]' is not among the Units of the file, nor known: "
        "it is taken as it is and fits all"
    ]
    assert (tmp_path / "out" / "diagram.json").read_text().count("4.0") == 1


def test_units_of_the_file_count_for_what_stands_in_it(tmp_path: Path) -> None:
    done = imported(tmp_path, system(component("a", values(("k[2]", 4000), unit="mm")), units=MM))
    assert document(done)["blocks"]["a"]["parameters"] == {"k": [1.0, 4.0]}
    assert not done.warnings


def test_a_unit_that_only_one_file_defines_has_one_meaning(tmp_path: Path) -> None:
    """The FMU has 'bar' as a name; what the values take for a bar is no pressure."""
    text = fmu_text("pump", "bar")
    text = text[: text.index("<UnitDefinitions>")] + text[text.index("<ModelVariables>") :]
    bar = '<ssv:Units><ssc:Unit name="bar"><ssc:BaseUnit kg="1" m="-2" factor="1e5"/></ssc:Unit></ssv:Units>'
    only = component("a", values(("k[1]", 3), unit="bar", units=bar), source="resources/p.fmu")
    assert parameters(tmp_path, system(only), p__fmu=fmu_bytes(tmp_path, text)) == {"k": [3e5, 2e5]}


# ---- runs ----


@pytest.mark.skipif(find_compiler() is None, reason="the FMU is built by a C compiler")
def test_an_imported_system_runs_as_its_equations_say(tmp_path: Path) -> None:
    """Two masses without springs: the first stays at 1 m, the second is pushed by 2 (1) + 5 N from 1 m.

    x'' = 7, y = x + 13 * 7 with gain = 4 * 2 + 5 = 13 by a mapping: y(t) = 92 + 3.5 t^2; shown is 10 y - 1.
    """
    make_fmu(tmp_path / "plant.fmu")
    plant = (tmp_path / "plant.fmu").read_bytes()
    own = ports(u="input", y="output")
    parts = "".join(
        f'<ssd:Component name="{n}" source="resources/p.fmu" implementation="CoSimulation">{own}</ssd:Component>'
        for n in "ab"
    )
    pairs = [("soft", 0), ("k", 2)]
    maps = [entry("soft", f"{n}.{name}") for n in "ab" for name in ("stiffness", "damping")]
    maps.append(entry("k", "b.gain", linear(4, 5)))
    top = ports(shown="output") + values(*pairs, map=mapping(*maps))
    joined = wire("a.y", "b.u", linear(2, 5), suppressUnitConversion="true") + wire("b.y", "shown", linear(10, -1))
    file = written(tmp_path, system(parts, joined, before=top), p__fmu=plant)
    done = import_ssp(file, tmp_path / "out", trust_blocks=True)
    assert document(done)["record"] == ["shown_sum.output"]
    run = cosimulate_diagram(done.diagram, step=0.1, stop=1.0)
    assert run.status == "finished"
    expected = 10 * (92 + 3.5 * np.asarray(run.time) ** 2) - 1
    np.testing.assert_allclose(run["shown_sum.output"], expected, rtol=1e-13)
