"""Whatever the document holds, loading ends with a diagram or a `RotorsimError`, never with a traceback."""

import copy
import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rotorsim.diagram.parse.source import parse_document
from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.errors import Problem, RotorsimError
from rotorsim.model.load import load

SHIPPED = {name: json.loads(file.read_text()) for name, file in shipped_diagrams().items() if "runup" not in name}
ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.floats(),
    st.just(10**400),
    st.text(max_size=5),
    st.sampled_from(["$speed", "$nothing", "1 m", "1500 rpm", "rotor.force", "a.b[0]", "rotor.tilt[9,9]", "x" * 500]),
    st.lists(st.one_of(st.integers(-1, 1), st.text(max_size=3), st.lists(st.floats(), max_size=2)), max_size=3),
    st.dictionaries(st.text(max_size=5), st.integers(), max_size=2),
)
NAMES = st.sampled_from(["speed", "rotor.mass", "crack.terms", "crack.opening", "solver.step", "x.y", "rotor"])


def problems(function: Callable[..., Any], *arguments: Any, **named: Any) -> list[Problem]:
    """Return the problems of the error that a call ends with, none if it succeeds."""
    try:
        function(*arguments, **named)
    except RotorsimError as error:
        return list(error.problems)
    return []


def spots(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the path of every value inside a document."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(spot for key, item in items for spot in spots(item, (*path, key)))]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_a_damaged_document_gives_an_error_and_no_traceback(data: st.DataObject) -> None:
    document: Any = copy.deepcopy(SHIPPED[data.draw(st.sampled_from(["jeffcott", "fe_rigid", "offset_disc"]))])
    for _ in range(data.draw(st.integers(1, 4))):
        path = data.draw(st.sampled_from(spots(document)[1:]))
        parent = document
        for step in path[:-1]:
            parent = parent[step]
        kind = data.draw(st.sampled_from(["replace", "delete", "double"]))
        if kind == "replace":
            parent[path[-1]] = data.draw(ODD)
        elif kind == "delete":
            del parent[path[-1]]
        elif isinstance(parent, list):
            parent.append(copy.deepcopy(parent[path[-1]]))
        else:
            parent[f"{path[-1]}2"] = copy.deepcopy(parent[path[-1]])
        if not spots(document)[1:]:
            break
    assert all(problem.what for problem in problems(load, document))


@settings(max_examples=120, deadline=None)
@given(st.text(alphabet="{}[]\",:\\ \n1e-.truefalsn/#'x", max_size=40))
def test_any_text_is_parsed_as_json_or_refused_with_a_place(text: str) -> None:
    try:
        expected = json.loads(text)
    except ValueError:
        expected = None
    found = problems(parse_document, text, "f.json")
    lines = text.split("\n")
    assert all(problem.place.file == "f.json" and problem.place.line >= 1 for problem in found)
    assert all(problem.place.column <= len(lines[problem.place.line - 1]) + 1 for problem in found)
    if not found:
        assert parse_document(text).data == expected


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(st.dictionaries(NAMES, ODD, max_size=3))
def test_any_setting_is_taken_or_refused(values: dict[str, Any]) -> None:
    found = problems(load, "jeffcott", set=values)
    assert all(str(problem) for problem in found)
