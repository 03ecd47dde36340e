"""Limits: what is too long, too deep or too much is refused in few words, in time that grows with its size."""

from pathlib import Path
from typing import Any

import pytest

from rotorsim.diagram.resolve.resolution import MAX_PROBLEMS
from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from tests.diagram.helpers import block, diagram, mistakes, written


@pytest.mark.parametrize("name", ["x" * 5000, "x" * 5000 + ".json", "a\0b", "a\0b.json"])
def test_names_that_no_file_can_have(name: str) -> None:
    with pytest.raises(RotorsimError) as error:
        load(name)
    assert error.value.problems[0].hint


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("x" * 5000, "folder does not exist"),
        ("x\0", "folder is outside the folder of the diagram"),
        ("link", "folder is outside the folder of the diagram"),
        ("circle", "folder is outside the folder of the diagram"),
    ],
)
def test_block_folders_that_no_folder_can_be(tmp_path: Path, name: str, what: str) -> None:
    (tmp_path / "inside").mkdir()
    (tmp_path / "outside").mkdir()
    (tmp_path / "inside" / "link").symlink_to(tmp_path / "outside")
    (tmp_path / "inside" / "circle").symlink_to(tmp_path / "inside" / "circle")
    document = diagram({"c": "constant"}, block_folders=[name])
    assert mistakes(document, trust_blocks=True, folder=tmp_path / "inside") in (
        [f": {name}: {what} | name a folder inside the folder of the diagram"],
        [f": {name}: folder does not exist | name a folder inside the folder of the diagram"],
    )


def test_what_is_made_in_memory_has_the_limits_of_a_file() -> None:
    deep: Any = 1.0
    for _ in range(5000):
        deep = [deep]
    circle: list[Any] = []
    circle.append(circle)
    for value in (deep, circle):
        assert mistakes(diagram({"c": block("constant", value=value)})) == [
            ": : the document is nested deeper than 64 levels | a diagram needs no more than ten; use sub-diagrams"
        ]
        with pytest.raises(RotorsimError, match="settings are a mapping of names to values"):
            load("jeffcott", set={"controller.KP": value})
    with pytest.raises(RotorsimError, match="settings are a mapping of names to values"):
        load("jeffcott", set=["speed=3"])  # type: ignore[arg-type]
    with pytest.raises(RotorsimError, match="no diagram parameter '3'"):
        load("jeffcott", set={3: 4})  # type: ignore[dict-item]
    assert "amb" not in load("jeffcott", without="amb").nodes


def test_lists_have_few_dimensions() -> None:
    value: Any = 1.0
    for _ in range(60):
        value = [value]
    assert mistakes(written(diagram({"c": block("constant", value=value)}))) == [
        "1:71: c.value: the list is nested too deeply | write one number, [...] or [[...], ...]"
    ]


def test_a_file_that_is_nested_too_deeply_is_placed_at_the_first_bracket_too_many() -> None:
    text = '{"a": "[[[",\n "blocks": ' + "[" * 100_000 + "]" * 100_000 + "}"
    assert mistakes(text) == [
        "2:75: : JSON is nested deeper than 64 levels | a diagram needs no more than ten; use sub-diagrams"
    ]


def test_a_default_that_does_not_fit_is_one_mistake() -> None:
    document = diagram({"c": "constant", "f": block("transfer_function", order=2)}, ("c.output", "f.input"))
    assert mistakes(document) == [
        ": f: default of 'denominator' has shape (2,), but (3,) is needed here | give \"denominator\""
    ]


@pytest.mark.slow
def test_of_very_many_mistakes_the_first_are_shown_and_the_rest_counted() -> None:
    names = [f"b{k}" for k in range(3000)]
    blocks = ",\n".join(f'"{name}": {{"type": "gian"}}' for name in names)
    found = mistakes('{"blocks": {\n' + blocks + "}}")
    assert len(found) == MAX_PROBLEMS + 1
    assert found[0] == "2:16: b0: unknown block type 'gian' | did you mean 'gain'?"
    assert found[-1] == f"{MAX_PROBLEMS + 2}:19: : and {3000 - MAX_PROBLEMS} more problems | correct these first"


@pytest.mark.slow
def test_the_middle_of_a_long_loop_is_left_out() -> None:
    n = 1000
    document = diagram(
        {f"g{k}": "gain" for k in range(n)}, *((f"g{k}.output", f"g{(k + 1) % n}.input") for k in range(n))
    )
    (loop,) = mistakes(document)
    assert "g19.output -> g20.input, ... 960 more hops ..., g980.output -> g981.input" in loop
    assert loop.count(" -> ") == 40


@pytest.mark.slow
def test_options_with_very_many_ports_take_linear_time() -> None:
    """100 000 ports: a comparison of each with each would take minutes."""
    many = block("sum", signs="+" * 100_000)
    assert len(mistakes(diagram({"s": many}))) == MAX_PROBLEMS + 1
    assert (
        "widths: 1000000000 must be at most 10000"
        in mistakes(
            diagram({"c": "constant", "s": block("bus_selector", names=["a"], widths=[10**9])}, ("c.output", "s.input"))
        )[0]
    )
