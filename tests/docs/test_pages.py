"""What the pages say of commands is true: they run, end as stated, and print what is shown."""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path

import pytest
from click.testing import Result

from tests.docs.pages import ROOT, Command, blocks, commands, differences, run, says
from tests.report import undrawn

PAGES = [
    "README.md",
    "docs/acceptance.md",
    "docs/cosimulation.md",
    "docs/diagnosis.md",
    "docs/diagrams.md",
    "docs/frequency.md",
    "docs/from_drawing_to_acceptance.md",
    "docs/identification.md",
    "docs/machines.md",
    "docs/margins.md",
    "docs/orders.md",
    "docs/recordings.md",
    "docs/ross.md",
    "docs/sweeps.md",
    "docs/thesis.md",
]
LONG = {
    "README.md",
    "docs/acceptance.md",
    "docs/cosimulation.md",
    "docs/diagrams.md",
    "docs/from_drawing_to_acceptance.md",
    "docs/recordings.md",
    "docs/identification.md",
    "docs/machines.md",
    "docs/margins.md",
    "docs/orders.md",
    "docs/sweeps.md",
    "docs/thesis.md",
}
MEASURED = ROOT.parent / "shared" / "recordings"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand in a folder with nothing but the diagrams, as the pages do."""
    shutil.copytree(ROOT / "diagrams", tmp_path / "diagrams", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said_wrongly(command: Command, done: dict[tuple[str, ...], Result]) -> list[str]:
    """Run a command, unless it was run here before; return what the page says of it that is not so."""
    if command.words not in done:
        done[command.words] = run(command)
    found = done[command.words]
    assert not found.exception or isinstance(found.exception, SystemExit), f"{command.words}: {found.exception!r}"
    wrong = [] if found.exit_code == command.exit_code else [f"exit code {found.exit_code}: {found.output}"]
    wrong += [f"not printed: {words}" for words in command.printed if not says(found.stdout, words)]
    wrong += differences(command.shown, found.stdout) if command.shown is not None else []
    return [f"{' '.join(command.words)}: {text}" for text in wrong]


def is_long(command: Command) -> bool:
    return command.words[1] == "diagnose" and "--sensors" not in command.words


def parts(page: str, long: bool) -> list[Command]:
    """Return the commands of the blocks that diagnose a recording (half a minute), or of those that do not."""
    every = commands(page)
    numbers = {command.block for command in every if is_long(command)}
    return [command for command in every if (command.block in numbers) == long]


@pytest.mark.skipif(sys.platform == "win32", reason="the documents show a POSIX shell")
@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=pytest.mark.slow) if page in LONG else page for page in PAGES]
)
def test_commands_print_what_is_shown(page: str, folder: Path) -> None:
    done: dict[tuple[str, ...], Result] = {}
    with undrawn():
        assert [text for command in parts(page, long=False) for text in said_wrongly(command, done)] == []


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="the documents show a POSIX shell")
def test_diagnoses_print_what_is_shown(folder: Path) -> None:
    """README and the page of diagnosis speak of the same machine: it is diagnosed once."""
    done: dict[tuple[str, ...], Result] = {}
    every = [*parts("README.md", long=True), *parts("docs/diagnosis.md", long=True)]
    assert [text for command in every for text in said_wrongly(command, done)] == []


@pytest.mark.slow
@pytest.mark.skipif(not (MEASURED / "tum_amb_rotor").exists(), reason="the shared recordings are not here")
def test_measured_machines_are_diagnosed_as_the_page_says(folder: Path) -> None:
    os.symlink(MEASURED, "FOLDER")
    done: dict[tuple[str, ...], Result] = {}
    assert [text for command in commands("docs/diagnosis_measured.md") for text in said_wrongly(command, done)] == []


# --- that this can fail -----------------------------------------------------------------------------------------------


def test_what_is_shown_is_compared_to_the_last_digit_shown() -> None:
    printed = "signal   peak  unit\nrotor  11.9433    um\nphase  -3.74 deg\nruns 5\n"
    assert differences("signal peak unit\nrotor 11.94 um\n...\n", printed) == []
    assert differences("...\nphase -3.7 deg\nruns 5\n", printed) == []
    assert differences(printed, printed) == []
    assert differences("...\nrotor 11.97 um\n...\n", printed) == ["shown: rotor 11.97 um\nprinted: no such line"]
    assert differences("...\nrotor 11.94 mm\n...\n", printed) == ["shown: rotor 11.94 mm\nprinted: no such line"]
    assert differences("...\nruns 6\n...\n", printed) == ["shown: runs 6\nprinted: no such line"]
    assert differences("signal peak unit\n", printed) == ["printed, not shown: rotor  11.9433    um"]
    assert differences("signal peak unit\nphase -3.74 deg\n...\n", printed) == [
        "shown: phase -3.74 deg\nprinted: rotor  11.9433    um"
    ]
    assert says("Missing is gain (velocity_error 0.09983 +- 0.002) at x", "velocity_error 0.0998")
    assert not says("Missing is gain (velocity_error 0.0963 +- 0.002) at x", "velocity_error 0.0998")


@pytest.mark.parametrize("page", [*PAGES, "docs/diagnosis_measured.md"])
def test_no_page_hides_how_a_command_ends(page: str) -> None:
    """``|| true`` passes whatever a command does."""
    assert commands(page)
    assert not re.search(r"\|\||; true", "".join(blocks(page, "sh")))


def test_exit_codes_and_words_are_read_from_comments() -> None:
    stated = {c.words[1:]: (c.exit_code, c.printed) for c in commands("README.md") if c.exit_code}
    assert stated == {
        ("diff", "jeffcott", "mine.json"): (1, ("blocks.controller.type: pid -> state_feedback",)),
        ("diagnose", "jeffcott", "bench", "--out", "diagnosis"): (1, ("controller_gain_error",)),
        ("diff", "jeffcott", "diagnosis/diagram.json"): (1, ("+ blocks.controller_gain_error:",)),
    }
