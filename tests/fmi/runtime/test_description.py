"""Model descriptions: read into the same classes for both versions, every mistake with its place."""

from __future__ import annotations

import math

import pytest

from rotorsim.errors import RotorsimError
from rotorsim.fmi.description.model import ModelDescription
from rotorsim.fmi.description.reader import read_description
from rotorsim.fmi.description.xml_reader import XmlLimits, read_xml
from rotorsim.units import parse_unit
from tests.fmi.plant import description2, description3


def read(text: str) -> ModelDescription:
    return read_description(text.encode(), "x.xml")


def mistakes(text: str, **limits: int) -> list[str]:
    with pytest.raises(RotorsimError) as caught:
        read_description(text.encode("utf-8", "surrogatepass"), "x.xml", limits=XmlLimits(**limits))
    return [str(problem) for problem in caught.value.problems]


def test_fmi2() -> None:
    found = read(description2())
    assert (found.version, found.name, found.token) == ("2.0", "plant", "{plant2}")
    assert set(found.kinds) == {"cs", "me"}
    cs = found.kinds["cs"]
    assert cs.can_get_set_state
    assert cs.can_vary_step
    assert cs.can_interpolate_inputs
    assert cs.max_output_derivative_order == 1
    assert found.states == ("x", "v")
    assert found.derivatives == ("der(x)", "der(v)")
    assert found.outputs == ("y", "count")
    assert found.dependencies["der(v)"] == ("x", "v", "u")
    assert found.dependencies["count"] == ()
    assert found.n_events == 1
    u = found.variables["u"]
    assert (u.type, u.causality, u.variability, u.initial, u.start) == ("Float64", "input", "continuous", "exact", 0.0)
    unit = found.unit_of(u)
    assert unit is not None
    assert unit.unit == parse_unit("N")
    assert found.units["m"].display == {"mm": (1000.0, 0.0, False)}
    assert found.variables["enabled"].start is True
    assert found.variables["label"].start == "none"
    assert (found.experiment.start, found.experiment.stop, found.experiment.step) == (0.0, 2.0, 0.01)


def test_fmi3_arrays_are_seen_as_their_entries() -> None:
    found = read(description3())
    assert found.version == "3.0"
    assert found.states == ("x[1]", "x[2]", "v[1]", "v[2]")
    assert found.derivatives == ("der(x)[1]", "der(x)[2]", "der(v)[1]", "der(v)[2]")
    assert found.n_events == 2
    assert found.variables["x"].start == (1.0, 0.0)
    assert found.variables["velocity"].alias
    assert found.variables["velocity"].reference == found.variables["v"].reference
    assert [entry.index for entry in found.resolve(["u[2]", "u"])] == [1, 0, 1]
    assert [name for v in found.by_causality("input") for name in v.names()] == ["u[1]", "u[2]", "enabled"]


def test_matrices_run_by_rows() -> None:
    matrix = '<Float64 name="A" valueReference="90"><Dimension start="2"/><Dimension valueReference="91"/></Float64>'
    size = '<UInt64 name="n" valueReference="91" causality="structuralParameter" start="3"/>'
    found = read(description3().replace("</ModelVariables>", size + matrix + "</ModelVariables>"))
    assert found.variables["A"].dimensions == (2, 3)
    assert found.variables["A"].names() == ["A[1,1]", "A[1,2]", "A[1,3]", "A[2,1]", "A[2,2]", "A[2,3]"]
    assert found.entries("A[2,1]")[0].index == 3
    assert found.entries("A[3,1]") == found.entries("A[1]") == found.entries("A[0,1]") == []


def test_an_unknown_name_has_a_near_miss() -> None:
    with pytest.raises(RotorsimError) as caught:
        read(description3()).resolve(["stifness", "u[3]"], "input")
    assert [(p.what, p.hint) for p in caught.value.problems] == [
        ("no input 'stifness'", "did you mean 'stiffness'?"),
        ("no input 'u[3]'", "its shape is [2]"),
    ]


def test_numbers_as_xml_writes_them() -> None:
    wall = read(description2().replace('start="1e9"', 'start="INF"')).variables["wall"]
    assert wall.start == math.inf
    assert mistakes(description2().replace('start="1e9"', 'start="1_000"')) == [
        'x.xml:20:91: error: wall: start="1_000" is not of type Float64'
    ]


def test_all_mistakes_at_once() -> None:
    text = (
        description2()
        .replace('causality="input"', 'causality="inptu"', 1)
        .replace('valueReference="7"', 'valueReference="-7"')
        .replace('derivative="3"', 'derivative="99"')
        .replace('index="15"', 'index="150"')
        .replace('modelIdentifier="plant"', 'modelIdentifier="../../plant"', 1)
    )
    found = mistakes(text)
    assert [line.splitlines()[0].partition(" error: ")[2] for line in found] == [
        "ModelExchange: modelIdentifier '../../plant' is not an identifier",
        "u: causality=\"inptu\" is unknown: did you mean 'input'?",
        'stiffness: valueReference="-7" is not a whole number between 0 and 4294967295',
        'der(v): derivative="99" is not a variable',
        'ModelStructure: index="150" is not a variable',
        'ModelStructure: index="150" is not a variable',
    ]


@pytest.mark.parametrize("identifier", ["", "a/b", "a\\b", "../a", "1a", "a b", "a.so", "ä", "a" * 300])
def test_a_model_identifier_is_never_a_path(identifier: str) -> None:
    for text in (description2(identifier=identifier), description3(identifier=identifier)):
        assert "modelIdentifier" in mistakes(text)[0]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "x.xml:1:1: error: not XML: no element found"),
        ("<a>", "x.xml:1:4: error: not XML: no element found"),
        ("<a></b>", "x.xml:1:6: error: not XML: mismatched tag"),
        ("<a/>", "x.xml:1:1: error: the document is <a>, not <fmiModelDescription>"),
        (
            '<?xml version="1.0" encoding="UTF-16"?><a/>',
            "x.xml:1:1: error: the encoding is said to be UTF-16, but its first bytes are not",
        ),
        (
            '<fmiModelDescription fmiVersion="4.0"/>',
            "x.xml:1:1: error: FMI 4.0 is not supported\n\nhint: FMI 1.0, 2.0 and 3.0 are",
        ),
    ],
)
def test_what_is_no_model_description(text: str, what: str) -> None:
    assert mistakes(text) == [what]


def test_document_types_are_refused_before_any_entity_grows() -> None:
    laughs = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10 if k else "ha" * 10}">' for k in range(10))
    for doctype in (f"<!DOCTYPE x [{laughs}]>", '<!DOCTYPE x SYSTEM "file:///etc/passwd">', "<!DOCTYPE x>"):
        assert "a document type (<!DOCTYPE ...>) is not allowed" in mistakes(doctype + "<x>&a9;</x>")[0]


@pytest.mark.parametrize(
    ("text", "limits", "what"),
    [
        ("<a>" * 40 + "</a>" * 40, {}, "elements are nested deeper than 32"),
        ("<a>" + "<b/>" * 50 + "</a>", {"elements": 20}, "more than 20 elements"),
        ("<a " + " ".join(f'b{k}=""' for k in range(65)) + "/>", {}, "<a> has more than 64 attributes"),
        (f'<a b="{"x" * 200}"/>', {"characters": 100}, "an attribute of <a> has more than 100 characters"),
        (f"<a>{'x' * 200}</a>", {"characters": 100}, "more than 100 characters of text"),
        (f"<a>{' ' * 200}</a>", {"bytes": 100}, "207 bytes of XML; 100 are allowed"),
    ],
)
def test_limits_of_xml(text: str, limits: dict[str, int], what: str) -> None:
    assert what in mistakes(text, **limits)[0]


def test_what_tools_annotate_is_skipped() -> None:
    annotation = "<VendorAnnotations><Tool name='x'><a><b/></a></Tool></VendorAnnotations>"
    root = read_xml(f"<x>{annotation}<y/></x>".encode(), "x", skip=frozenset({"VendorAnnotations"}))
    assert [child.tag for child in root.children] == ["y"]


def test_arrays_of_absurd_size_are_refused_at_once() -> None:
    huge = '<Float64 name="A" valueReference="90">' + 2 * '<Dimension start="4000000000"/>' + "</Float64>"
    text = description3().replace("</ModelVariables>", huge + "</ModelVariables>")
    assert "more than 1000000 entries in all" in mistakes(text)[0]
