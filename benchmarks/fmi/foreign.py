"""FMUs that other tools made, each run alone as `rotorsim cosim` does: what runs, and why the others do not.

python -m benchmarks.fmi.foreign FOLDER [--references FOLDER]

FOLDER is searched, also below; files that are alike are taken once. Each FMU is run for the experiment that it proposes
(1 s where it proposes none) as Co-Simulation where it offers that, else as Model Exchange, without inputs.
NAME_out.csv or NAME_ref.csv beside NAME.fmu, or among the references: the largest deviation from it at its times, of
its largest value; the steps are those of the reference. References of runs with inputs (NAME_in.csv) are left out.

Where such FMUs are, all of them public repositories of github.com (nothing of them is kept here):
  modelica/Reference-FMUs: built with cmake, -DFMI_VERSION=2 or 3; the last commit that has FMI 1.0 is c8d4e6d
    (-DFMI_VERSION=1 -DFMI_TYPE=CS or ME); NAME/NAME_out.csv of later ones are references, of Euler steps
  qtronic/fmusdk: fmu10/src/models, a compiler call each, with -DFMI_COSIMULATION for Co-Simulation
  open-simulation-platform/libcosim (tests/data), NTNU-IHB/FMI4j (test-fmus), ThummeTo/FMIZoo.jl (models/bin),
  OpenModelica/OMSimulator: as they are
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.markers import refuse, table_text
from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.block import block_class
from rotorsim.fmi.description.model import FMU_KINDS, ModelDescription
from rotorsim.fmi.runtime.slave import describe_fmu
from rotorsim.model.load import load

STOP, STEPS = 1.0, 500  # s, where no experiment is proposed; communication steps, where there is no reference
MOST_STEPS = 20_000  # of a reference or of the step that is proposed
LONGEST = 110  # characters of a reason
NO_LIBRARY = "holds no library for this platform"
ENDED = "asks for the end of the simulation"
CLOSE = 1e-9  # relative: the same instant


@dataclass
class Tried:
    """What came of an FMU."""

    version: str = "?"
    kind: str = ""
    reason: str = ""
    end: float = 0.0
    ended: bool = False  # by itself
    deviation: str = ""

    @property
    def result(self) -> str:
        """What came of it in words."""
        return self.reason or f"runs to {self.end:g} s" + (", where it ends the simulation" if self.ended else "")


def files_in(folder: Path) -> Iterator[Path]:
    """Yield the FMUs in a folder and below, each content once."""
    seen: set[bytes] = set()
    for file in sorted(folder.rglob("*.fmu")):
        digest = hashlib.sha256(file.read_bytes()).digest()
        if digest not in seen:
            seen.add(digest)
            yield file


def reference_of(file: Path, references: Path | None) -> dict[str, np.ndarray]:
    """Return the columns of numbers of a reference, by name; {} where there is none."""
    for folder in filter(None, (file.parent, references)):
        if (folder / f"{file.stem}_in.csv").is_file():
            return {}
        for end in ("out", "ref"):
            found = folder / f"{file.stem}_{end}.csv"
            if found.is_file():
                with found.open(newline="", encoding="utf-8") as stream:
                    head, *rows = csv.reader(stream)
                return {name: column for k, name in enumerate(head) if (column := _numbers(rows, k)) is not None}
    return {}


def _numbers(rows: list[list[str]], k: int) -> np.ndarray | None:
    try:
        return np.array([float(row[k]) for row in rows])
    except (ValueError, IndexError):
        return None


def try_fmu(file: Path, references: Path | None) -> Tried:
    """Run an FMU alone."""
    made = Tried()
    try:
        description = describe_fmu(file)
        made.version, made.kind = description.version, next(k for k in ("cs", "me", "se") if k in description.kinds)
        reference = reference_of(file, references)
        block: Any = block_class(file)
        shown = [f"it.{name}" for name in block.fmu_outputs] or _inside(description, file)
        stop, step = _experiment(description, reference)
        document = {
            "name": "alone",
            "blocks": {"it": {"type": "fmu", "file": str(file.resolve())}},
            "solver": {"step": step, "stop": stop},
            "record": shown,
        }
        result = cosimulate_diagram(load(document, trust_blocks=True), step=step, check=True)
    except RotorsimError as error:
        made.reason = _short(error.problems[0])
        return made
    made.end = float(result.time[-1])
    made.ended = ENDED in result.message
    if result.status != "finished" and not made.ended:
        made.reason = f"{result.status} at {made.end:g} s: {result.message}".partition("\n")[0][:LONGEST]
        return made
    values = {
        entry: column
        for name, port in block.fmu_outputs.items()
        for entry, column in zip(port.entries, np.reshape(result[f"it.{name}"], (len(result.time), -1)).T, strict=True)
    }
    made.deviation = deviation(reference, result.time, values)
    return made


def _short(problem: Problem) -> str:
    what = ": ".join(part for part in (problem.subject, problem.what) if part)
    return " ".join(what.partition("\n")[0].split())[:LONGEST]


def _inside(description: ModelDescription, file: Path) -> list[str]:
    """Return a number inside to be recorded, where an FMU has no outputs."""
    local = [v.name for v in description.by_causality("local") if v.type == "Float64" and v.name.isidentifier()]
    return [f"it.{name}" for name in local[:1]]


def _experiment(description: ModelDescription, reference: dict[str, np.ndarray]) -> tuple[float, float]:
    """Return stop time and communication step [s]."""
    stop, own = description.experiment.stop or STOP, description.experiment.step
    times = reference.get("time", np.zeros(0))
    gaps = np.diff(times)
    if gaps.size and (gaps > 0).any():
        stop, own = float(times[-1]), float(gaps[gaps > 0].min())
    return stop, own if own and stop / own <= MOST_STEPS else stop / STEPS


def deviation(reference: dict[str, np.ndarray], times: np.ndarray, values: dict[str, np.ndarray]) -> str:
    """Return the largest deviation of a signal from its reference, of the largest value of that, and whose it is."""
    if "time" not in reference:
        return ""
    wanted = reference["time"]
    nearest = np.abs(times[None, :] - wanted[:, None]).argmin(axis=1)
    close = np.abs(times[nearest] - wanted) <= CLOSE * max(float(times[-1]), 1.0)
    last = np.append(np.diff(wanted) > 0, True)  # of an instant that is there twice, what is behind its event
    use = close & last
    found = {}
    for name in sorted(reference.keys() & values.keys()):
        own = reference[name][use]
        scale = float(np.abs(own).max(initial=0.0)) or 1.0
        found[name] = float(np.abs(values[name][nearest[use]] - own).max(initial=0.0)) / scale
    if not found or not use.any():
        return ""
    worst = max(found, key=lambda name: found[name])
    return f"{found[worst]:.1e} ({worst})"


def main() -> None:
    """Print the table and how many run; exit 2 where there is nothing to try."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--references", type=Path, help="folder of NAME_out.csv or NAME_ref.csv")
    given = parser.parse_args()
    files = list(files_in(given.folder))
    if not files:
        refuse(f"{given.folder} holds no FMU (see --help)")
    tried = {}
    for file in files:
        tried[str(file.relative_to(given.folder))] = made = try_fmu(file, given.references)
        print(f"{file.name}: {made.result}", file=sys.stderr, flush=True)
    rows = [
        [name, made.version, FMU_KINDS.get(made.kind, ""), made.result, made.deviation] for name, made in tried.items()
    ]
    every = Counter(made.version for made in tried.values())
    good = Counter(made.version for made in tried.values() if not made.reason)
    counted = [f"FMI {version}: {good[version]} of {every[version]}" for version in sorted(every.keys() - {"?"})]
    without = sum(NO_LIBRARY in made.reason for made in tried.values())
    print(table_text(["file", "FMI", "kind", "result", "from its reference"], rows))
    print(f"\n{good.total()} of {every.total()} run ({without} hold no library for this machine); {', '.join(counted)}")


if __name__ == "__main__":
    main()
