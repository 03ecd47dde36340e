"""How long a diagnosis takes: python -m benchmarks.diagnosis.times RECORDINGS [--sets SET] [--only NAME ...].

RECORDINGS/SET holds one recording a machine, RECORDINGS/SET_hold_out the runs held out, under the same names; all are
diagnosed by the command line in a process of its own, with report and figures, two workers. Diagrams are those that a
set names for its cases (benchmarks/generic), or one for all.

  python -m benchmarks.diagnosis.times ../shared/recordings
  python -m benchmarks.diagnosis.times ../shared/recordings/generic --sets development --most 40
  python -m benchmarks.diagnosis.times RECORDINGS --sets runup_development --most 90 --only rdev05_beam_nothing
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.concealed.sets import diagrams_of, held_out
from benchmarks.harness import Line, at_most, markdown, run_process

BEAM = "fe_rigid"
COMMAND = [sys.executable, "-m", "rotorsim", "diagnose"]
# s, on two idle cores: any machine, the median of all, where nothing explains the rest
MOST, MEDIAN, NOTHING = 60.0, 40.0, 45.0


def processor() -> str:
    """Return the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _diagrams(folder: Path, diagram: str | None) -> dict[str, str]:
    """Return the diagram of each case that has one of its own, or that given for all."""
    try:
        return diagrams_of(folder, diagram)
    except FileNotFoundError:
        return {}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print wall and CPU time of every machine of a set, and what was found."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.diagnosis.times", description=__doc__)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--sets", default="beams_development", metavar="SET")
    parser.add_argument("--diagram", help="default: as the set says, or else fe_rigid")
    parser.add_argument(
        "--most", type=float, help="s, of any machine (default: 60, 45 where nothing explains the rest)"
    )
    parser.add_argument("--only", nargs="*", default=(), metavar="NAME")
    chosen = parser.parse_args(arguments)
    folder = chosen.recordings.resolve() / chosen.sets
    diagrams, lines, walls = _diagrams(folder, chosen.diagram), [], []
    every = sorted(path for path in folder.iterdir() if path.is_dir())
    for case in [path for path in every if not chosen.only or path.name in chosen.only]:
        held = held_out(folder, case.name)
        with tempfile.TemporaryDirectory() as out:
            more = ["--hold-out", str(held)] if held.is_dir() else []
            done = run_process(
                [*COMMAND, diagrams.get(case.name, BEAM), str(case), *more, "--out", out, "--workers", "2"]
            )
            if done.code not in (0, 1):
                sys.exit(done.output)
            found = json.loads((Path(out) / "diagnosis.json").read_text(encoding="utf-8"))
        named = ", ".join(item["physics"] for item in found["missing"]) or found["verdict"]
        limit = chosen.most or (MOST if found["missing"] else NOTHING)
        lines.append(at_most(f"{case.name}: {named}", done.wall, limit, "{:.0f}", "s", f" ({done.cpu:.0f} s CPU)"))
        print(lines[-1], flush=True)
        walls.append(done.wall)
    if len(walls) > 1 and chosen.most is None:
        lines.append(at_most("median", statistics.median(walls), MEDIAN, "{:.0f}", "s"))
    lines.append(Line("processor", processor()))
    print(markdown(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
