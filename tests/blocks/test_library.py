"""What every block of the library must have: documents, units, a source, and equations that fit its declarations."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rotorsim.block
from rotorsim.block import Block
from rotorsim.diagram.resolve.registry import find
from rotorsim.fault import ENTRIES
from rotorsim.units import parse_unit
from tests.blocks.evaluation import prepare_class

ROOT = Path(rotorsim.block.__file__).parents[1]
FILES = sorted(file for file in (ROOT / "blocks").glob("*/**/[a-z]*.py") if file.parent.name != "common")
NAMES = [file.stem for file in FILES]
GUIDE = ROOT / "docs" / "writing-a-block.md"


def block_class(name: str) -> type[Block]:
    found = find(name)
    assert found is not None
    return found


def declarations(cls: type[Block]) -> list[tuple[str, Any]]:
    kinds: tuple[dict[str, Any], ...] = (cls.inputs, cls.outputs, cls.parameters, cls.options, cls.states, cls.randoms)
    return [item for kind in kinds for item in kind.items()]


@pytest.mark.parametrize("file", FILES, ids=NAMES)
def test_a_file_defines_the_one_block_of_its_name(file: Path) -> None:
    cls = block_class(file.stem)
    tree = ast.parse(file.read_text())
    assert [node.name for node in tree.body if isinstance(node, ast.ClassDef)] == [cls.__name__]
    assert cls.__name__.lower() == file.stem.replace("_", "")


@pytest.mark.parametrize("file", FILES, ids=NAMES)
def test_a_block_imports_nothing_else_of_ours(file: Path) -> None:
    tree = ast.parse(file.read_text())
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    modules |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    ours = {str(module) for module in modules if str(module).startswith("rotorsim")}
    assert "rotorsim.block" in ours
    # what several blocks share lies beside them in a file that is no block: blocks/common/beam.py
    assert all(m in ("rotorsim.block", "rotorsim.fault") or m.startswith("rotorsim.blocks") for m in ours)


@pytest.mark.parametrize("name", NAMES)
def test_everything_is_documented(name: str) -> None:
    cls = block_class(name)
    assert [key for key, declared in declarations(cls) if not declared.doc.strip()] == []
    assert cls.source.strip()
    assert re.fullmatch(r"[a-z_]+", cls.category)
    first, *others = (cls.__doc__ or "").splitlines()
    assert re.fullmatch(r"[A-Z][^\n]*\.", first), "one imperative line first"
    assert others
    assert others[0] == ""


@pytest.mark.parametrize("name", NAMES)
def test_units_are_known(name: str) -> None:
    for _, declared in declarations(block_class(name)):
        if declared.unit is not None:
            parse_unit(declared.unit)


@pytest.mark.parametrize("name", NAMES)
def test_names_do_not_hide_one_another(name: str) -> None:
    cls = block_class(name)
    for kinds in ((cls.inputs, cls.outputs), (cls.parameters, cls.options), (cls.parameters, cls.states, cls.randoms)):
        every = [key for kind in kinds for key in kind]
        assert len(every) == len(set(every))
    assert cls.sample_time is None or cls.sample_time in cls.parameters
    for state in cls.states.values():
        assert not isinstance(state.init, str) or state.init in cls.parameters
        assert state.unless_wired is None or cls.inputs[state.unless_wired].optional
    for draw in cls.randoms.values():
        assert draw.seed in cls.parameters


@pytest.mark.parametrize("name", NAMES)
def test_defaults_are_within_their_bounds(name: str) -> None:
    cls = block_class(name)
    for key, declared in cls.parameters.items():
        if declared.default is not None:
            value = np.asarray(declared.default, dtype=float)
            assert np.all(np.isfinite(value)), key
            assert declared.low is None or value.min() >= declared.low, key
            assert declared.high is None or value.max() <= declared.high, key
            assert declared.above is None or value.min() > declared.above, key
    for key, option in cls.options.items():
        assert option.choices is None or option.default in option.choices, key


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("optional", [False, True])
def test_equations_fit_the_declarations(name: str, optional: bool) -> None:
    cls = block_class(name)
    block = cls()
    if any(option.default is None and option.kind is not None for option in cls.options.values()):
        pytest.skip("an option must be given")
    dimensions: dict[str, int] = {}
    for declared in cls.parameters.values():
        shape = block.declared_shape(declared)
        if declared.default is not None and np.ndim(declared.default) and isinstance(shape, tuple):
            for entry, number in zip(shape, np.shape(declared.default), strict=True):
                if isinstance(entry, str):
                    dimensions.setdefault(entry, number)

    def some(shape: Any) -> tuple[int, ...]:
        if isinstance(shape, str):
            return (2,)
        return tuple(dimensions.get(entry, 2) if isinstance(entry, str) else entry for entry in shape)

    inputs = {
        port: some(block.declared_shape(declared, port))
        for declared in cls.inputs.values()
        for port in block.port_names(declared)
        if optional or not declared.optional
    }
    required = {
        key: np.ones(some(block.declared_shape(declared)))
        for key, declared in cls.parameters.items()
        if declared.default is None
    }
    result = prepare_class(cls, inputs, required).evaluate(dict.fromkeys(inputs, 1e-5), time=0.3)
    for kind in (result.outputs, result.derivatives, result.update, result.events):
        for key, value in kind.items():
            assert np.all(np.isfinite(value)), key


def test_a_parameter_called_sample_time_is_the_sample_time() -> None:
    class Sampled(Block):
        """Do nothing."""

        sample_time = rotorsim.block.Param(1.0, unit="s")

    class Named(Block):
        """Do nothing."""

        sample_time = "period"
        period = rotorsim.block.Param(1.0, unit="s")

    assert (Sampled.sample_time, Named.sample_time, Block.sample_time) == ("sample_time", "period", None)
    assert list(Sampled.parameters) == ["sample_time"]


def guide() -> type[Block]:
    """The block of the guide, with what it declares for the diagnosis."""
    [code], [faults] = (re.findall(rf"```{kind}\n(.*?)```", GUIDE.read_text(), re.DOTALL) for kind in ("python", "py"))
    first = next(line for line in code.splitlines() if line.startswith("    source ="))
    space: dict[str, Any] = {"__name__": "guide"}
    exec("from rotorsim.fault import Fault\n" + code.replace(first, f"{first}\n{faults}"), space)
    [cls] = [v for v in space.values() if isinstance(v, type) and issubclass(v, Block) and v is not Block]
    return cls


def test_the_block_of_the_guide_works() -> None:
    cls = guide()
    assert f'"type": "{cls.type_name}"' in GUIDE.read_text()
    displacement = np.array([3e-4, -4e-4])
    found = prepare_class(cls, {"displacement": (2,)}).evaluate({"displacement": displacement}).outputs["force"]
    np.testing.assert_allclose(found, -(1e5 + 1e13 * displacement @ displacement) * displacement, rtol=1e-14)


def test_the_block_of_the_guide_offers_itself_to_the_diagnosis() -> None:
    cls = guide()
    [fault] = cls.faults
    assert fault.physics == cls.type_name
    assert fault.free.keys() <= cls.parameters.keys()
    assert all(f'| `"{word}"` |' in GUIDE.read_text() for word in ENTRIES)
