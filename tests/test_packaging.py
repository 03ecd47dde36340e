"""The package list is complete, and a wheel holds the blocks and the diagrams."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_package_list_is_complete() -> None:
    inside = {
        ".".join(init.parent.relative_to(ROOT).parts) for init in (ROOT / "rotorsim").rglob("__init__.py")
    }  # fmt: skip
    expected = inside | {"rotorsim.blocks", "rotorsim.diagrams"}
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == expected


def test_every_folder_with_code_is_a_package() -> None:
    folders = {source.parent for source in (ROOT / "rotorsim").rglob("*.py")}
    assert [str(folder) for folder in folders if not (folder / "__init__.py").exists()] == []


@pytest.mark.parametrize("folder", ["blocks", "diagrams"])
def test_block_and_diagram_folders_have_a_docstring_only_init(folder: str) -> None:
    body = ast.parse((ROOT / folder / "__init__.py").read_text()).body
    assert len(body) == 1
    assert isinstance(body[0], ast.Expr)
    assert isinstance(body[0].value, ast.Constant)
    assert isinstance(body[0].value.value, str)


def test_block_files_import_only_what_a_block_is() -> None:
    """lint-imports does not see the folder blocks/, which is rotorsim.blocks only once installed."""
    allowed = {"rotorsim.block", "rotorsim.fault", "rotorsim.blocks", "rotorsim.blocks._beam"}
    found = set()
    for source in (ROOT / "blocks").glob("*.py"):
        for node in ast.walk(ast.parse(source.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            found |= {f"{source.name}: {n}" for n in names if n.startswith("rotorsim") and n not in allowed}
    assert found == set()


def test_every_third_party_import_is_a_declared_dependency() -> None:
    declared = {re.split(r"[<>=!;\[ ]", item)[0].lower() for item in PROJECT["project"]["dependencies"]}
    optional = {re.split(r"[<>=!;\[ ]", item)[0].lower()
                for group in PROJECT["project"]["optional-dependencies"].values() for item in group}  # fmt: skip
    optional.add("cycler")  # a part of matplotlib's interface, and always installed with it
    unknown = set()
    for source in [*(ROOT / "rotorsim").rglob("*.py"), *(ROOT / "blocks").glob("*.py")]:
        for node in ast.walk(ast.parse(source.read_text())):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module or ""]
            else:
                continue
            for name in names:
                top = name.split(".")[0].lower()
                if top not in sys.stdlib_module_names and top not in declared | optional | {"rotorsim"}:
                    unknown.add(f"{source.relative_to(ROOT)}: {top}")
    assert unknown == set()


def test_a_wheel_holds_every_source_and_diagram(tmp_path: Path) -> None:
    try:
        major = int(version("setuptools").split(".")[0])
    except PackageNotFoundError:
        major = 0
    if major < 77:
        pytest.skip("setuptools >= 77 is not installed, and a wheel cannot be built without it or the network")
    # A copy, so that the build leaves nothing behind in the repository.
    tracked = ["pyproject.toml", "README.md", "LICENSE"]
    copy = tmp_path / "source"
    copy.mkdir()
    for name in tracked:
        (copy / name).write_bytes((ROOT / name).read_bytes())
    wanted = []
    for folder, package in (("rotorsim", "rotorsim"), ("blocks", "rotorsim/blocks"), ("diagrams", "rotorsim/diagrams")):
        for source in (ROOT / folder).rglob("*"):
            inside = source.relative_to(ROOT / folder)
            if source.suffix in {".py", ".json", ".c", ".h", ".typed"} and "__pycache__" not in inside.parts:
                wanted.append(f"{package}/{inside.as_posix()}")
                target = copy / folder / inside
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(source.read_bytes())
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index",
               "--disable-pip-version-check", "-q", "-w", str(tmp_path / "wheel"), str(copy)]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    [wheel] = (tmp_path / "wheel").glob("rotorsim-*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert sorted(set(wanted) - names) == []
    assert any(name.endswith("licenses/LICENSE") for name in names)
