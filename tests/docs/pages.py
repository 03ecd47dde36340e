"""What a page says of commands: its fenced blocks, and whether what it shows is what they print."""

from __future__ import annotations

import itertools
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from click.testing import CliRunner, Result

from rotorsim.cli.app import rotorsim

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
EXIT_CODE = re.compile(r"\s# exit code (\d)(?:: (.*))?$", re.MULTILINE)
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w)")
OTHERS = (".venv/bin", "python -m benchmarks", "pip install")  # lines that are not this program's


@dataclass(frozen=True)
class Command:
    """One command of a page: its words, the block it is in, what its comment states, and what is shown below it."""

    words: tuple[str, ...]
    block: int
    exit_code: int = 0
    printed: tuple[str, ...] = ()
    shown: str | None = None


def page_text(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page: str, language: str) -> list[str]:
    return [text for kind, text in FENCE.findall(page_text(page)) if kind == language]


def commands(page: str) -> list[Command]:
    """Return the commands of a page in order; a ``text`` block next to an ``sh`` block is what the last one prints."""
    return list(_commands(page_text(page)))


def _commands(text: str) -> Iterator[Command]:
    fences = [*FENCE.findall(text), ("", "")]
    for number, ((kind, block), (next_kind, shown)) in enumerate(itertools.pairwise(fences)):
        lines = [line for line in re.sub(r"\\\n", " ", block).splitlines() if not any(o in line for o in OTHERS)]
        for k, line in enumerate(lines if kind == "sh" else []):
            said = EXIT_CODE.search(line)
            below = shown if next_kind == "text" and k == len(lines) - 1 else None
            printed = tuple(said[2].split(", ")) if said and said[2] else ()
            yield Command(tuple(shlex.split(line, comments=True)), number, int(said[1]) if said else 0, printed, below)


def run(command: Command) -> Result:
    """Run a command in this process, in the current folder; ``> file`` writes what it prints."""
    program, *arguments = command.words
    assert program == "rotorsim", f"{command.words}: another program"
    assert not {"|", "||", "&&", ";", "&"} & set(arguments), f"{command.words}: not a command by itself"
    if ">" not in arguments:
        return CliRunner().invoke(rotorsim, arguments)
    *arguments, _, target = arguments
    result = CliRunner().invoke(rotorsim, arguments)
    Path(target).write_text(result.stdout, encoding="utf-8")
    return result


def differences(shown: str, printed: str) -> list[str]:
    """Return the lines of what a page shows that are not printed; ``...`` stands for any number of lines."""
    rest = printed.splitlines()
    wrong = []
    skipping = False
    for line in shown.splitlines():
        if line.strip() == "...":
            skipping = True
            continue
        near = len(rest) if skipping else 1
        found = next((k for k in range(min(near, len(rest))) if same(line, rest[k])), None)
        if found is None:
            wrong.append(f"shown: {line}\nprinted: {rest[0] if rest and not skipping else 'no such line'}")
        rest = rest[(0 if skipping else 1) if found is None else found + 1 :]
        skipping = False
    if rest and not skipping:
        wrong.append(f"printed, not shown: {rest[0]}")
    return wrong


def same(shown: str, printed: str) -> bool:
    """Tell whether two lines agree: words alike, figures within one of the last digit shown, spaces as they come."""
    if [" ".join(part.split()) for part in NUMBER.split(shown)] != [
        " ".join(part.split()) for part in NUMBER.split(printed)
    ]:
        return False
    return all(close(a, b) for a, b in zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True))


def close(shown: str, printed: str) -> bool:
    """Tell whether a printed figure is that shown, within one of the last digit shown (whole numbers: exactly)."""
    if re.fullmatch(r"[-+]?\d+", shown) and re.fullmatch(r"[-+]?\d+", printed):
        return int(shown) == int(printed)
    mantissa, _, power = shown.partition("e")
    digit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
    return abs(float(shown) - float(printed)) <= 1.0000001 * digit


def says(printed: str, words: str) -> bool:
    """Tell whether words, figures within their digits, stand in what is printed, next to each other."""
    wanted, pieces = words.split(), re.sub(r"[(),]", " ", printed).split()
    return any(
        all(same(a, b) for a, b in zip(wanted, pieces[k : k + len(wanted)], strict=True))
        for k in range(len(pieces) - len(wanted) + 1)
    )
