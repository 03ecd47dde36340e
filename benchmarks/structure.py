"""python -m benchmarks.structure [REVISION ...]: size and structure of the code, side by side for several revisions.

Without a revision: the working tree. Counted is what is installed, blocks and rotorsim (fmt: skip: all Python files).
"""

from __future__ import annotations

import ast
import subprocess
import sys
import tarfile
from collections import Counter
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import networkx as nx

ROOT = Path(__file__).resolve().parent.parent
COUNTED = ("blocks", "rotorsim")


def measured(root: Path) -> dict[str, str]:
    """Return the figures of one tree as name -> text."""
    files = sorted(file for folder in COUNTED for file in (root / folder).rglob("*.py"))
    texts = {file: file.read_text(encoding="utf-8") for file in files}
    trees = {file: ast.parse(text) for file, text in texts.items()}
    modules = {_module(root, file): tree for file, tree in trees.items()}
    own = {n.name for tree in trees.values() for n in ast.walk(tree) if isinstance(n, ast.ClassDef)}
    lines = {file: text.count("\n") for file, text in texts.items()}
    largest = max(lines, key=lines.__getitem__)
    # what holds one sort of thing by name may be flat: verbs, and blocks of one category
    folders = Counter(f.parent.relative_to(root) for f in files if f.stem != "__init__")
    flat = {Path("rotorsim/cli"), *(folder for folder in folders if folder.parts[0] == "blocks")}
    fullest = max((folder for folder in folders if folder not in flat), key=folders.__getitem__)
    skips = sum(
        file.read_text(encoding="utf-8").count("# fmt: " + "skip")
        for folder in (*COUNTED, "tests", "benchmarks")
        for file in (root / folder).rglob("*.py")
    )
    circles = [sorted(group) for group in nx.strongly_connected_components(imports(modules)) if len(group) > 1]
    return {
        "modules": str(len(files)),
        "lines": str(sum(lines.values())),
        "statements (docstrings aside)": str(sum(map(statements, trees.values()))),
        "largest file": f"{lines[largest]} ({largest.relative_to(root)})",
        "modules in the largest folder (verbs and blocks aside)": f"{folders[fullest]} ({fullest})",
        "numbers as module-level constants": str(sum(map(numbers, trees.values()))),
        "cast()": str(sum(_calls(tree, "cast") for tree in trees.values())),
        "getattr() by a fixed name": str(sum(_fixed_getattr(tree) for tree in trees.values())),
        "isinstance() of our own classes": str(sum(_own_isinstance(tree, own) for tree in trees.values())),
        "private names of other modules": str(sum(_private(tree) for tree in trees.values())),
        "fmt: skip": str(skips),
        "circles of modules": str(len(circles)) + "".join(f"; {' '.join(circle)}" for circle in circles),
    }


def statements(tree: ast.AST) -> int:
    """Return the number of statements of a module, docstrings aside."""
    return sum(isinstance(node, ast.stmt) and not _is_text(node) for node in ast.walk(tree))


def numbers(tree: ast.Module) -> int:
    """Return how many names of a module stand for a number, or an expression of numbers."""
    held = [node.value for node in tree.body if isinstance(node, ast.Assign | ast.AnnAssign) and node.value]
    inside = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.operator, ast.unaryop, ast.Name, ast.Load)
    return sum(
        all(isinstance(part, inside) for part in ast.walk(value))
        and any(isinstance(part, ast.Constant) and isinstance(part.value, int | float) for part in ast.walk(value))
        and not any(isinstance(part, ast.Constant) and isinstance(part.value, str | bool) for part in ast.walk(value))
        for value in held
    )


def imports(modules: dict[str, ast.Module]) -> nx.DiGraph:
    """Return who imports whom, wherever the import stands (in functions and for type checking too)."""
    graph = nx.DiGraph()
    graph.add_nodes_from(modules)
    for name, tree in modules.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                wanted = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                wanted = [f"{node.module}.{alias.name}" for alias in node.names]
                wanted = [module if module in modules else node.module for module in wanted]
            else:
                continue
            graph.add_edges_from((name, module) for module in wanted if module in modules and module != name)
    return graph


def _module(root: Path, file: Path) -> str:
    parts = file.relative_to(root).with_suffix("").parts
    parts = parts if parts[0] == "rotorsim" else ("rotorsim", *parts)
    return ".".join(parts).removesuffix(".__init__")


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _calls(tree: ast.AST, name: str) -> int:
    return len(_called(tree, name))


def _called(tree: ast.AST, name: str) -> list[ast.Call]:
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
    return [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == name]


def _fixed_getattr(tree: ast.AST) -> int:
    return sum(isinstance(call.args[1], ast.Constant) for call in _called(tree, "getattr"))


def _own_isinstance(tree: ast.AST, own: set[str]) -> int:
    names = [{n.id for n in ast.walk(call.args[1]) if isinstance(n, ast.Name)} for call in _called(tree, "isinstance")]
    return sum(bool(used & own) for used in names)


def _private(tree: ast.AST) -> int:
    taken = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and (n.module or "").startswith("rotorsim.")]
    return sum(alias.name.startswith("_") for node in taken for alias in node.names)


def _unpacked(revision: str, folder: Path) -> Path:
    packed = subprocess.run(["git", "archive", revision], cwd=ROOT, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=BytesIO(packed)) as archive:
        archive.extractall(folder, filter="data")
    return folder


def main(revisions: list[str]) -> int:
    """Print one column for each revision."""
    with TemporaryDirectory() as folder:
        columns = [measured(_unpacked(name, Path(folder) / name)) for name in revisions] or [measured(ROOT)]
    print("| | " + " | ".join(revisions or ["working tree"]) + " |\n|---" + "|---" * len(columns) + "|")
    for row in columns[0]:
        print(f"| {row} | " + " | ".join(column[row] for column in columns) + " |")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
