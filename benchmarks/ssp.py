"""Systems of FMUs (SSP) of other tools: which of them import as diagrams, and which of these run here.

python -m benchmarks.ssp FOLDER [--steps 100]

FOLDER (a whole path below) holds *.ssp. The 16 of docs/cosimulation.md are those with FMUs in OMSimulator's test suite,
which has them unpacked (github.com/OpenModelica/OMSimulator, as of 2026-08-20); packed as its build does:
  cd OMSimulator/testsuite/tests/resources
  for f in $(grep -l 'source="resources/.*[.]fmu"' */SystemStructure.ssd); do
    d=$(dirname $f); (cd $d && zip -qr FOLDER/$d.ssp .); done

Each runs for some communication steps of 1 ms. Foreign code: every FMU is in a process of its own.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.markers import refuse, table_text
from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.ssp.to_diagram import import_ssp

STEP = 1e-3  # s, communication


def tried(file: Path, steps: int) -> tuple[bool, bool, list[str]]:
    """Return whether a system imports and runs, and its row of the table."""
    with tempfile.TemporaryDirectory(prefix="ssp-") as scratch:
        try:
            made = import_ssp(file, Path(scratch) / "system", trust_blocks=True)
        except RotorsimError as error:
            return False, False, [file.stem, f"no: {_first(error.problems)}", "", ""]
        nodes = made.diagram.nodes.values()
        size = f"{sum(node.block.type_name == 'fmu' for node in nodes)} FMUs, {len(made.diagram.wires)} wires"
        try:
            run = cosimulate_diagram(made.diagram, step=STEP, stop=steps * STEP)
        except RotorsimError as error:
            return True, False, [file.stem, "yes", size, f"no: {_first(error.problems)}"]
        runs = run.status == "finished"
        return True, runs, [file.stem, "yes", size, "yes" if runs else f"no: {run.message or run.status}"]


def _first(problems: tuple[Problem, ...]) -> str:
    """Return the first mistake in one line of a table."""
    text = f"{problems[0].subject}: {problems[0].what}".splitlines()[0].replace("|", "/")
    return f"{text} (and {len(problems) - 1} more)" if len(problems) > 1 else text


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, default=100, help="communication steps of 1 ms that each runs")
    given = parser.parse_args()
    files = sorted(given.folder.glob("*.ssp"))
    if not files:
        refuse(f"{given.folder} holds no .ssp (see --help)")
    found = [tried(file, given.steps) for file in files]
    imported, ran = (sum(row[k] for row in found) for k in (0, 1))
    print(table_text(["system", "imports", "of", "runs"], [row for *_, row in found]))
    print(f"\n{imported} of {len(files)} import, {ran} of these run.")


if __name__ == "__main__":
    main()
