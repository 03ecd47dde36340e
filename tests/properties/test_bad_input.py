"""Damaged diagrams: never anything but a RotorsimError that says where, what, and how to cure it.

Every shipped diagram is damaged in its JSON tree or in its text, and loaded from a file as a user would.
"""

import copy
import json
import math
import tempfile
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.cli.app import rotorsim
from rotorsim.diagram.resolve.registry import all_types
from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.errors import RotorsimError
from rotorsim.model.load import load

DOCUMENTS = {name: json.loads(file.read_text(encoding="utf-8")) for name, file in shipped_diagrams().items()}
ODD: list[Any] = [
    None,
    True,
    False,
    0,
    -1,
    1,
    3.5,
    1e308,
    -1e-320,
    10**30,
    "",
    " ",
    "x",
    "1500",
    "3 furlongs",
    "24 kg",
    "-5 um",
    "1e400 m",
    "nan",
    "$speed",
    "$nothing",
    "$",
    "clock.theta",
    "rotor.force[7]",
    "rotor.displacement[0]",
    [],
    [[]],
    [1, 2, 3],
    [[1, 2], [3]],
    ["2 kg", "x"],
    {},
    {"type": "pid"},
    {"a": {"b": []}},
    "\u0000",
    "ä" * 100,
    math.nan,
    -math.inf,
    10**400,
    [[[[[[[[[[1.0]]]]]]]]]],
    "\ud800",
    ["a", "a"],
    [1.0, math.nan],
    "+" * 300,
    10**9,
]


def places(data: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the path of every value inside a document."""
    found = [path] if path else []
    if isinstance(data, dict):
        for key, value in data.items():
            found += places(value, (*path, key))
    elif isinstance(data, list):
        for k, value in enumerate(data):
            found += places(value, (*path, k))
    return found


PLACES = {name: places(document) for name, document in DOCUMENTS.items()}


def damage_tree(draw: Any, data: Any, path: tuple[Any, ...]) -> None:
    """Damage one value: replace, remove, rename, double, or move it."""
    holder = data
    for step in path[:-1]:
        holder = holder[step]
    last = path[-1]
    kind = draw(st.sampled_from(["replace", "replace", "remove", "rename", "copy", "wrap", "nest", "wire"]))
    if kind == "replace":
        holder[last] = copy.deepcopy(draw(st.sampled_from(ODD)))
    elif kind == "remove":
        del holder[last]
    elif kind == "rename" and isinstance(holder, dict):
        text = str(last)
        at = draw(st.integers(0, max(len(text) - 1, 0)))
        holder[text[:at] + draw(st.sampled_from(["", "x", "_", " ", "."])) + text[at + 1 :]] = holder.pop(last)
    elif kind == "copy" and isinstance(holder, list):
        holder.append(copy.deepcopy(holder[last]))
    elif kind == "wrap":
        holder[last] = [holder[last]] if draw(st.booleans()) else {"value": holder[last]}
    elif kind == "nest":
        for _ in range(draw(st.sampled_from([9, 33, 70]))):
            holder[last] = [holder[last]]
    elif kind == "wire":  # doubled inputs, misfits, and circles
        ends = sorted({end for wire in data["wires"] for end in wire})
        data["wires"].append([draw(st.sampled_from(ends)), draw(st.sampled_from(ends))])


def damage_text(draw: Any, text: str) -> str:
    """Damage the text: cut it, drop or insert a character, double a key, insert what is no JSON."""
    at = draw(st.integers(0, len(text) - 1))
    kind = draw(st.sampled_from(["cut", "drop", "insert", "double"]))
    if kind == "cut":
        return text[:at]
    if kind == "drop":
        return text[:at] + text[at + 1 :]
    if kind == "double":
        return text.replace('"wires":', '"blocks": {}, "wires":', 1)
    return (
        text[:at]
        + draw(st.sampled_from([",", "}", "]", '"', "NaN", "// x", "'", "1e999", "\t", "\x00", "{"]))
        + text[at:]
    )


@st.composite
def damaged(draw: Any) -> str:
    name = draw(st.sampled_from(sorted(DOCUMENTS)))
    data = copy.deepcopy(DOCUMENTS[name])
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(PLACES[name]))
        try:
            damage_tree(draw, data, path)
        except (KeyError, IndexError, TypeError, AttributeError):  # an earlier damage removed that place
            continue
    text = json.dumps(data, indent=draw(st.sampled_from([None, 1])))
    return damage_text(draw, text) if draw(st.integers(0, 4)) == 0 else text


def check(error: RotorsimError, file: str) -> None:
    """Every error has a place with line and column, words, and a hint."""
    assert error.exit_code == 2
    errors = [problem for problem in error.problems if problem.severity == "error"]
    assert errors
    for problem in errors:
        assert problem.place.file.endswith(file), problem
        assert problem.place.line > 0, problem
        assert problem.place.column > 0, problem
        assert problem.what, problem
        assert problem.hint, problem


@pytest.mark.slow
@settings(max_examples=100, deadline=None, derandomize=True)
@given(damaged())
def test_damaged_diagrams_are_loaded_or_refused_with_place_and_hint(text):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.json"
        path.write_text(text, encoding="utf-8")
        try:
            load(path)
        except RotorsimError as error:
            check(error, "damaged.json")


@st.composite
def odd_block(draw: Any) -> str:
    """One block of any type, its inputs wired to constants, with odd values of parameters and options."""
    kind = all_types()[draw(st.sampled_from(sorted(all_types())))]
    names = [*kind.parameters, *kind.options]
    chosen = draw(st.lists(st.sampled_from(names), max_size=3, unique=True)) if names else []
    values = {name: draw(st.sampled_from([*ODD, 2, 3, [0.5], [2, 1], [[1.0, 0.0], [0.0, 1.0]]])) for name in chosen}
    ports = [port for declared in kind.inputs.values() for port in kind().port_names(declared)]
    value = draw(st.sampled_from([1.0, [1.0, 2.0], [[1.0, 2.0], [3.0, 4.0]]]))
    blocks: dict[str, Any] = {f"c{k}": {"type": "constant", "parameters": {"value": value}} for k in range(len(ports))}
    blocks["b"] = {"type": kind.type_name, "parameters": values}
    wires = [[f"c{k}.output", f"b.{port}"] for k, port in enumerate(ports)]
    return json.dumps({"blocks": blocks, "wires": wires}, indent=1)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, derandomize=True)
@given(odd_block())
def test_odd_values_of_any_block_are_taken_or_refused_with_place_and_hint(text):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "odd.json"
        path.write_text(text, encoding="utf-8")
        try:
            load(path)
        except RotorsimError as error:
            check(error, "odd.json")
            for problem in error.problems:
                assert "Error: " not in problem.what, problem  # of Python, from the code of the block


@settings(max_examples=25, deadline=None, derandomize=True)
@given(damaged())
def test_the_command_line_ends_with_two_and_without_a_traceback(text):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.json"
        path.write_text(text, encoding="utf-8")
        done = CliRunner().invoke(rotorsim, ["check", str(path)])
        assert done.exit_code in (0, 2), done.output
        assert "Traceback" not in done.output
        assert "internal error" not in done.output


CYCLE = {
    "blocks": {"a": {"type": "gain"}, "b": {"type": "gain"}},
    "wires": [["a.output", "b.input"], ["b.output", "a.input"]],
}


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "file is empty"),
        (b"\x00\x01\x02", None),
        ("{}".encode("utf-16"), None),
        (b'{"blocks": {"a": {"type": "gain", "parameters": {"gain": NaN}}}}', "NaN is not allowed"),
        (b'{"blocks": {"a": {"type": "gain", "parameters": {"gain": 1e999}}}}', "1e999"),
        (b'{"blocks": ' + b"[" * 100_000 + b"]" * 100_000 + b"}", "nested deeper than 64"),
        (b'{"blocks": {"a": {"type": "gain"}, "a": {"type": "sum"}}}', "a"),
        (b'{"blocks": {"a": {"type": "gain"},}}', None),
        (b"{'blocks': {}}", None),
        (json.dumps(CYCLE).encode(), "algebraic loop: "),
    ],
)
def test_files_that_are_no_diagrams_are_refused_at_their_place(tmp_path, content, says):
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(RotorsimError) as caught:
        load(path)
    problem = caught.value.problems[0]
    assert problem.place.file.endswith("bad.json")
    assert problem.hint
    assert (problem.place.line, problem.place.column) >= (1, 1)
    if says:
        assert says in problem.what


def test_a_file_of_100_megabytes_is_refused_by_its_size_without_being_parsed(tmp_path):
    path = tmp_path / "huge.json"
    with path.open("wb") as file:
        file.truncate(100_000_000)
    with pytest.raises(RotorsimError) as caught:
        load(path)
    assert str(caught.value.problems[0]).startswith(f"{path}: error: file is larger than 20 MB")


@pytest.mark.parametrize("name", ["missing.json", "."])
def test_what_is_no_file_is_refused(tmp_path, name):
    with pytest.raises(RotorsimError) as caught:
        load(tmp_path / name)
    assert caught.value.problems[0].hint


@pytest.mark.parametrize(
    "file", ["../secret.json", "/etc/passwd", "..\\secret.json", "link.json", "a/../../secret.json"]
)
def test_diagrams_read_nothing_outside_their_folder(tmp_path, file):
    folder = tmp_path / "inside"
    folder.mkdir()
    secret = tmp_path / "secret.json"
    secret.write_text('{"blocks": {"a": {"type": "constant"}}}')
    (folder / "link.json").symlink_to(secret)
    path = folder / "main.json"
    path.write_text(json.dumps({"blocks": {"s": {"type": "diagram", "file": file}}}))
    with pytest.raises(RotorsimError) as caught:
        load(path)
    expected = f"file {file!r} is not inside the folder of the diagram".replace("\\\\", "\\")
    assert caught.value.problems[0].what == expected


def test_diagrams_run_no_code_unless_trusted(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "evil.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w').close()")
    path = tmp_path / "main.json"
    path.write_text(
        json.dumps({"block_folders": ["mine"], "blocks": {"e": {"type": "evil"}, "c": {"type": "constant"}}})
    )
    with pytest.raises(RotorsimError) as caught:
        load(path)
    assert not (tmp_path / "ran").exists()
    assert any("--trust-blocks" in problem.hint for problem in caught.value.problems)
    for kind in ("__import__('os')", "os.system", "../evil", "evil.py", "rotorsim.cli"):
        path.write_text(json.dumps({"blocks": {"e": {"type": kind}}}))
        with pytest.raises(RotorsimError):
            load(path)
