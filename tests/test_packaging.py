"""The package list is complete; an sdist holds everything, and a wheel the blocks, the diagrams and the pages."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
IMPORT = re.compile(r"^ *(?:import|from(?= [\w.]+ import )) (\w[\w., ]*?)(?: import .*| *#.*)?$", re.MULTILINE)


def test_the_package_list_is_complete() -> None:
    inside = {".".join(init.parent.relative_to(ROOT).parts) for init in (ROOT / "rotorsim").rglob("__init__.py")}
    blocks = {
        "rotorsim." + ".".join(init.parent.relative_to(ROOT).parts) for init in ROOT.glob("blocks/**/__init__.py")
    }
    expected = inside | blocks | {"rotorsim.diagrams", "rotorsim.docs"}
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == expected


def test_every_folder_with_code_is_a_package() -> None:
    folders = {source.parent for source in (ROOT / "rotorsim").rglob("*.py")}
    assert [str(folder) for folder in folders if not (folder / "__init__.py").exists()] == []


@pytest.mark.parametrize("folder", ["blocks", "diagrams", "docs"])
def test_block_diagram_and_page_folders_have_a_docstring_only_init(folder: str) -> None:
    body = ast.parse((ROOT / folder / "__init__.py").read_text()).body
    assert len(body) == 1
    assert isinstance(body[0], ast.Expr)
    assert isinstance(body[0].value, ast.Constant)
    assert isinstance(body[0].value.value, str)


def test_block_files_import_only_what_a_block_is() -> None:
    """lint-imports does not see the folder blocks/, which is rotorsim.blocks only once installed."""
    allowed = {"rotorsim.block", "rotorsim.fault", "rotorsim.blocks.common"}
    allowed |= {f"rotorsim.blocks.common.{name}" for name in ("beam", "drawing", "drawn_mistakes", "mesh", "shaft")}
    found = set()
    for source in (ROOT / "blocks").rglob("*.py"):
        for node in ast.walk(ast.parse(source.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            found |= {f"{source.name}: {n}" for n in names if n.startswith("rotorsim") and n not in allowed}
    assert found == set()


def test_every_third_party_import_is_a_declared_dependency() -> None:
    declared = {re.split(r"[<>=!;\[ ]", item)[0].lower() for item in PROJECT["project"]["dependencies"]}
    optional = {
        re.split(r"[<>=!;\[ ]", item)[0].lower()
        for group in PROJECT["project"]["optional-dependencies"].values()
        for item in group
    }
    optional.add("cycler")  # a part of matplotlib's interface, and always installed with it
    unknown = set()
    for source in [*(ROOT / "rotorsim").rglob("*.py"), *(ROOT / "blocks").rglob("*.py")]:
        for words in IMPORT.findall(source.read_text()):
            for name in words.split(","):
                top = re.split(r"[. ]", name.strip())[0].lower()
                if top not in sys.stdlib_module_names and top not in declared | optional | {"rotorsim"}:
                    unknown.add(f"{source.relative_to(ROOT)}: {top}")
    assert unknown == set()


FOLDERS = (".ci", "benchmarks", "blocks", "diagrams", "docs", "rotorsim", "tests")
FILES = ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", ".gitignore")


def sources() -> list[str]:
    """Return what the repository holds, less what tools have made."""
    found = [file.relative_to(ROOT) for folder in FOLDERS for file in (ROOT / folder).rglob("*") if file.is_file()]
    made = {"__pycache__", ".hypothesis", ".pytest_cache"}
    return [*FILES, *(file.as_posix() for file in found if not made & set(file.parts))]


@pytest.mark.slow
def test_an_sdist_holds_everything_and_a_wheel_from_it_what_runs(tmp_path: Path) -> None:
    try:
        major = int(version("setuptools").split(".")[0])
    except PackageNotFoundError:
        major = 0
    if major < 77:
        pytest.skip("setuptools >= 77 is not installed, and nothing can be built without it or the network")
    # A copy, so that the build leaves nothing behind in the repository.
    copy = tmp_path / "source"
    for name in sources():
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_bytes((ROOT / name).read_bytes())

    def build(kind: str, folder: Path) -> Path:
        code = f"import sys; from setuptools import build_meta; print(build_meta.build_{kind}(sys.argv[1]))"
        command = [sys.executable, "-c", code, str(tmp_path)]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        return tmp_path / done.stdout.splitlines()[-1]

    with tarfile.open(build("sdist", copy)) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
        assert sorted(set(sources()) - names) == []
        archive.extractall(tmp_path / "unpacked", filter="data")
    [unpacked] = (tmp_path / "unpacked").iterdir()
    names = set(zipfile.ZipFile(build("wheel", unpacked)).namelist())
    homes = {"rotorsim/": "", "blocks/": "rotorsim/", "diagrams/": "rotorsim/", "docs/": "rotorsim/"}
    wanted = {home + name for name in sources() for start, home in homes.items() if name.startswith(start)}
    assert sorted(wanted - names) == []
    assert {name for name in names if not name.startswith("rotorsim/")} == {
        name for name in names if ".dist-info/" in name
    }
    assert any(name.endswith("licenses/LICENSE") for name in names)
