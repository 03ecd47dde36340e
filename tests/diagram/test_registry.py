"""Finding block types: files of their name, folders that the user trusts, broken files reported by name."""

import subprocess
import sys
from pathlib import Path

import pytest

from rotorsim.block import Block
from rotorsim.diagram.resolve.registry import Registry, all_types, find
from rotorsim.model.load import load
from tests.diagram.helpers import diagram, mistakes

GOOD = '''
from rotorsim.block import Block, Equations, In, Out, Param, vec

class Steady(Block):
    """Give a number."""
    output = Out()
    level = Param(2.0)
    def equations(self, p, u, x, t):
        return Equations(outputs={"output": p.level})

class Sized(Block):
    """Pass a vector of any size."""
    input = In(shape=("n",), unit=None)
    output = Out(shape=("n",), unit=None)
    def equations(self, p, u, x, t):
        return Equations(outputs={"output": u.input})
'''
WRONG = """
from rotorsim.block import Block, Equations, Out, vec

class Misshapen(Block):
    output = Out(shape=2)
    def equations(self, p, u, x, t):
        return Equations(outputs={"output": vec(1, 2, 3)})

class Silent(Block):
    output = Out()
    def equations(self, p, u, x, t):
        return Equations()

class Raising(Block):
    output = Out()
    def equations(self, p, u, x, t):
        return Equations(outputs={"output": 1 / 0})

class Unchecked(Block):
    output = Out()
    def check(self, values):
        raise KeyError("k")
    def equations(self, p, u, x, t):
        return Equations(outputs={"output": 1})
"""


@pytest.fixture
def folder(empty_folder: Path) -> Path:
    made = empty_folder / "my_blocks"
    made.mkdir()
    (made / "good.py").write_text(GOOD)
    (made / "wrong.py").write_text(WRONG)
    return made


def test_a_type_is_the_name_of_its_file() -> None:
    found = find("gain")
    assert found is not None
    assert found.__module__ == "rotorsim.blocks.signals.operations.gain"
    assert find("no_such_type") is None
    for name in ("__init__", "os.path", "Gain", "../gain", "", "_beam"):
        assert find(name) is None


@pytest.mark.slow
def test_only_the_files_in_use_are_imported() -> None:
    code = (
        "import sys, rotorsim; rotorsim.load('jeffcott');"
        "print(sorted(m.split('.')[-1] for m in sys.modules if m.startswith('rotorsim.blocks.')))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "'pid'" in out
    assert "'rotor_fe'" not in out


def test_all_types_are_listed_and_none_is_broken() -> None:
    registry = Registry()
    known = registry.all_types()
    assert registry.problems == []
    assert list(known) == sorted(known)
    assert {"gain", "pid", "rotor_fe"} <= set(known)
    assert all(issubclass(kind, Block) and kind.type_name == name for name, kind in known.items())
    assert all_types() == known


def test_user_folders_are_run_only_when_trusted(folder: Path) -> None:
    document = diagram({"a": "steady"}, block_folders=["my_blocks"])
    assert mistakes(document) == [
        ": my_blocks: block files are programs; they are not run unless you say so "
        "| read them, then add --trust-blocks (trust_blocks=True)",
        ": a: unknown block type 'steady' | did you mean 'step'? If it is in \"block_folders\", add --trust-blocks",
    ]
    loaded = load(document, folder=folder.parent, trust_blocks=True)
    assert loaded.nodes["a"].values["level"] == 2.0


@pytest.mark.parametrize("name", ["../other", "/etc", "my_blocks/../..", "nowhere"])
def test_folders_must_be_inside_the_folder_of_the_diagram(folder: Path, name: str) -> None:
    found = mistakes(diagram({"c": "constant"}, block_folders=[name]), trust_blocks=True)
    what = "folder does not exist" if name == "nowhere" else "folder is outside the folder of the diagram"
    assert found == [f": {name}: {what} | name a folder inside the folder of the diagram"]


def test_a_broken_file_is_named_and_breaks_nothing_else(folder: Path) -> None:
    (folder / "broken.py").write_text("import nothing_here\n")
    (folder / "leaves.py").write_text("raise SystemExit(3)\n")
    (folder / "syntax.py").write_text("def (:\n")
    (folder / "_private.py").write_text("raise RuntimeError\n")
    registry = Registry([folder])
    assert registry.find("steady") is not None
    assert [(Path(str(p.place)).name, p.severity, p.what) for p in registry.problems] == [
        ("broken.py", "warning", "block file cannot be used: ModuleNotFoundError: No module named 'nothing_here'"),
        ("leaves.py", "warning", "block file cannot be used: SystemExit: 3"),
        ("syntax.py", "warning", "block file cannot be used: SyntaxError: invalid syntax (syntax.py, line 1)"),
    ]
    assert registry.hint("broken") == "its block file cannot be used; see the warning"
    assert registry.hint("Steady") == "did you mean 'steady'?"
    document = diagram({"a": "steady", "b": "broken"}, block_folders=["my_blocks"])
    found = mistakes(document, trust_blocks=True)
    assert ": b: unknown block type 'broken' | its block file cannot be used; see the warning" in found
    assert sum("warning: " in text and "block file cannot be used" in text for text in found) == 3


def test_a_type_that_is_defined_twice_is_reported(folder: Path) -> None:
    (folder / "other.py").write_text(GOOD)
    registry = Registry([folder])
    registry.all_types()
    assert [problem.what.split(";")[0] for problem in registry.problems] == [
        "type 'steady' is defined again",
        "type 'sized' is defined again",
    ]


def test_blocks_whose_code_contradicts_itself_are_reported_by_name(folder: Path) -> None:
    blocks = {"m": "misshapen", "s": "silent", "r": "raising"}
    assert mistakes(diagram(blocks, block_folders=["my_blocks"]), trust_blocks=True) == [
        ": m: block type 'misshapen': output 'output' has shape (3, 1), declared (2, 1) | correct the block file",
        ": s: block type 'silent': equations give no output 'output' | correct the block file",
        ": r: equations of block type 'raising' fail: ZeroDivisionError: division by zero "
        "| check options and shapes, or the block file",
    ]
    assert mistakes(diagram({"u": "unchecked"}, block_folders=["my_blocks"]), trust_blocks=True) == [
        ": u: check of block type 'unchecked' fails: KeyError: 'k' | see `rotorsim blocks unchecked`"
    ]


def test_a_size_that_nothing_tells_is_a_mistake(folder: Path) -> None:
    document = diagram(
        {"w": "sized", "i": "integrator"}, ("i.output", "w.input"), ("w.output", "i.input"), block_folders=["my_blocks"]
    )
    assert mistakes(document, trust_blocks=True) == [
        ": w: size 'n' of input, output is not known | wire it, or give a parameter that has this size"
    ]


def test_a_state_that_begins_where_it_cannot_is_reported(folder: Path) -> None:
    """FAULT: of another shape, a diagnosis of a diagram with the block ended with a traceback."""
    head = "from rotorsim.block import Block, Equations, In, Out, State, vec\n"
    body = """
class {name}(Block):
    input = In()
    output = Out()
    value = State({declared})
    def equations(self, p, u, x, t):
        return Equations(outputs={{"output": u.input}}, derivatives={{"value": 0 * x.value}})
"""
    (folder / "begins.py").write_text(
        head
        + body.format(name="Lost", declared='begins="nothing"')
        + body.format(name="Wide", declared='shape=2, begins="input"')
    )
    wires = [("c.output", "l.input"), ("c.output", "w.input")]
    document = diagram({"c": "constant", "l": "lost", "w": "wide"}, *wires, block_folders=["my_blocks"])
    assert [line for line in mistakes(document, trust_blocks=True) if "unit" not in line] == [
        ": l: block type 'lost': state 'value' begins at 'nothing', which is no input | correct the block file",
        ": w: block type 'wide': state 'value' has shape (2,), input 'input' that it begins at () "
        "| correct the block file",
    ]
