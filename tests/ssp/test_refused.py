"""Systems of FMUs (SSP) in: what is wrong or not supported is said with its place, and how to cure it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.ssp.systems import (
    SPACES,
    component,
    entry,
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
)

MAPPED = {
    "no target": (mapping('<ssm:MappingEntry source="p"/>'), "p -> : the attribute target is missing"),
    "two to one": (
        mapping(entry("p", "c"), entry("r", "c")),
        "r -> c: 'c' is the target of 'p', too\n\nhint: a name can be mapped to once",
    ),
    "of another type": (
        mapping(entry("p", "c", table("Boolean", ("true", "false")))),
        "p -> c: BooleanMappingTransformation of a parameter of type Float64\n\nhint: it is for Boolean",
    ),
    "two at once": (
        mapping(entry("p", "c", linear(2) + linear(3))),
        "p -> c: a second transformation: LinearTransformation\n\nhint: one is allowed",
    ),
    "no number": (
        mapping(entry("p", "c", '<ssc:LinearTransformation factor="two"/>')),
        'p -> c: factor="two" is not a number',
    ),
    "not finite": (
        mapping(entry("p", "c", '<ssc:LinearTransformation offset="INF"/>')),
        'p -> c: offset="INF" is not finite',
    ),
    "two of one": (
        mapping(entry("i", "c", table("Integer", ("1", "2"), ("1", "3")))),
        'i -> c: source="1" has a second entry\n\nhint: one is allowed',
    ),
    "no whole number": (
        mapping(entry("i", "c", table("Integer", ("1.5", "2")))),
        'i -> c: source="1.5" is not of type Int64',
    ),
}


@pytest.mark.parametrize("case", MAPPED)
def test_mappings_that_are_wrong(tmp_path: Path, case: str) -> None:
    """Said with the place of the entry, of its transformation or of its part."""
    given, what = MAPPED[case]
    found = refusal(tmp_path, system(component("a", values(("p", 1), ("r", 2), ("i", 3), map=given))))
    assert f"error: {what}" in found
    assert found.startswith(f"{tmp_path}/made.ssp/SystemStructure.ssd:1:")


def test_all_mistakes_are_said_at_once(tmp_path: Path) -> None:
    bad = mapping(entry("p", "c"), entry("p", "c"), '<ssm:MappingEntry source="p"/>')
    found = refusal(tmp_path, system(component("a", values(("p", "x"), map=bad)) + component("a")))
    for what in ("is not of type Real", "the attribute target is missing", "is the name of two elements"):
        assert what in found


def test_two_connections_into_one_input(tmp_path: Path) -> None:
    text = system(component("a"), wire("a.q", "a.s") + wire("a.y[1]", "a.s"))
    place = f"{tmp_path}/made.ssp/SystemStructure.ssd:1:{text.rindex('<ssd:Connection ') + 1}"
    hint = "hint: one is allowed; a component that adds up can take both"
    assert refusal(tmp_path, text) == f"{place}: error: a.s: is fed by two connections\n\n{hint}"


def test_units_that_do_not_fit_on_the_way(tmp_path: Path) -> None:
    """The way into the inner system is in N, both ends are in m."""
    newton = '<ssc:Unit name="N"><ssc:BaseUnit kg="1" m="1" s="-2"/></ssc:Unit>'
    sub = f'<ssd:System name="s">{ports(way="input N")}<ssd:Elements>{component("b")}</ssd:Elements>'
    sub += f"<ssd:Connections>{wire('way', 'b.u[1]')}</ssd:Connections></ssd:System>"
    text = system(component("a") + sub, wire("a.y[1]", "s.way"), units=newton)
    columns = [match.start() + 1 for match in re.finditer("<ssd:Connection ", text)]
    hint = 'hint: suppressUnitConversion="true" hands the number over as it is'
    file = f"{tmp_path}/made.ssp/SystemStructure.ssd"
    assert refusal(tmp_path, text) == "\n".join(
        f"{file}:1:{column}: error: a.y[1] -> {end}: units do not fit: {units}\n\n{hint}"
        for end, units, column in zip(("s.way", "s.b.u[1]"), ("m into N", "N into m"), columns[::-1], strict=True)
    )


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (
            table("Integer", ("1", "2")),
            "a.y[1] -> a.s: a transformation of whole numbers, and 'y[1]' is of type Float64",
        ),
        (table("Enumeration", ("a", "b")), "a.y[1] -> a.s: a transformation of Enumeration, and 'y[1]' is of type"),
        (table("Boolean"), "a.y[1] -> a.s: a transformation of Boolean, and 'y[1]' is of type Float64"),
    ],
)
def test_transformations_that_connections_cannot_have(tmp_path: Path, change: str, what: str) -> None:
    assert f"error: {what}" in refusal(tmp_path, system(component("a"), wire("a.y[1]", "a.s", change)))


@pytest.mark.parametrize(
    ("attributes", "what"),
    [
        (
            'type="text/csv"',
            "a: parameters of type text/csv are not supported\n\nhint: application/x-ssp-parameter-set is",
        ),
        (
            'sourceBase="component" source="p.ssv"',
            "a: parameters inside a component are not supported\n\nhint: write them to a file of the archive",
        ),
        ('source="resources/none.ssv"', "a: source 'resources/none.ssv': there is no such file in the archive"),
    ],
)
def test_bindings_that_are_not_supported(tmp_path: Path, attributes: str, what: str) -> None:
    given = f"<ssd:ParameterBindings><ssd:ParameterBinding {attributes}/></ssd:ParameterBindings>"
    assert f"error: {what}" in refusal(tmp_path, system(component("a", given)))
    given = (
        f'<ssd:ParameterBindings><ssd:ParameterBinding source="resources/p.ssv"><ssd:ParameterMapping {attributes}/>'
    )
    given += "</ssd:ParameterBinding></ssd:ParameterBindings>"
    (tmp_path / "again").mkdir()
    spaces = f' xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructure{SPACES["ssv"]}"'
    found = refusal(tmp_path / "again", system(component("a", given)), p__ssv=parameter_set(more=spaces).encode())
    assert f"error: {what}".replace("parameter-set", "parameter-mapping") in found


@pytest.mark.parametrize(
    ("kind", "name", "value", "what"),
    [
        ("Enumeration", "mode", "fst", "a.mode: 'fst' is none of its items\n\nhint: did you mean 'fast'?"),
        ("String", "c", "one", "a.c: is a number; 'one' is given"),
        ("Real", "word", "1", "a.word: is of type String; '1.0' is given"),
        ("Real", "flag", "2", "a.flag: is of type Boolean; '2.0' is given"),
        ("Real", "q", "2", "a.q: cannot be set: it is no parameter with a start value, and no input"),
    ],
)
def test_values_that_do_not_fit(tmp_path: Path, kind: str, name: str, value: str, what: str) -> None:
    text = system(component("a", values((name, value), kind=kind), source="resources/t.fmu"))
    place = f"SystemStructure.ssd:1:{text.index('<ssd:Component') + 1}"
    assert refusal(tmp_path, text, t__fmu=typed_fmu(tmp_path)).endswith(f"{place}: error: {what}")
