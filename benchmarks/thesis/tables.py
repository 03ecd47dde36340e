"""The errors of Tables 2-5 to 5-5 of the thesis beside those found here: the tables of docs/thesis.md.

python -m benchmarks.thesis.tables [--only 2-5 ...] [--seeds 100] [--out docs/thesis.md]

Clean data, 5 % of the three kinds of noise, or known parameters wrong by 1 and 5 %; the thesis' regression, in % of the
true value. --out puts every table between <!-- table 2-5 --> and <!-- end --> of the document. Three minutes on two
cores.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.markers import expect, fill, refuse, table_text
from rotorsim.errors import RotorsimError
from rotorsim.identification.study.plan import Case
from rotorsim.identification.study.printed import TABLES
from rotorsim.identification.study.study import StudyResult, run_study, study_of_table

SYMBOLS = {
    "viscous_damping": "c",
    "crack_stiffness": "dk",
    "eccentricity": "e",
    "eccentricity1": "e1",
    "eccentricity2": "e2",
    "unbalance_phase": "beta",
    "unbalance_phase1": "beta1",
    "unbalance_phase2": "beta2",
    "force_displacement_factor": "k_s",
    "force_current_factor": "k_i",
    "support_left.stiffness[1]": "k_Lx",
    "support_left.stiffness[2]": "k_Ly",
    "support_right.stiffness[1]": "k_Rx",
    "support_right.stiffness[2]": "k_Ry",
}
NOISES = {"uniform": "5 % uniform: mean (rms)", "white": "5 % white", "thesis": "5 % normal (2.67)"}
NOISE, BIASES = 0.05, (0.01, 0.05)
CLEAN = Case("", 0.0, 0.0)
ZERO = 5e-4  # %; less is written 0


def percent(value: float | None) -> str:
    """Return an error in % with two digits."""
    if value is None:
        return "-"
    if abs(value) < ZERO:
        return "0"
    return f"{value:.2g}" if abs(value) < 10 else f"{value:.0f}"


def noise_table(found: StudyResult) -> str:
    """Return the table of a study of noise: clean data and 5 %, mean and rms over the seeds."""
    rows = []
    for name in found.parameters:
        clean = found.row(name, CLEAN)
        noisy = [found.row(name, Case(kind, NOISE, 0.0)) for kind in NOISES]
        shown = [f"{percent(row.mean_percent)} ({percent(row.rms_percent)})" for row in noisy]
        cells = [percent(clean.mean_percent), percent(clean.published), *shown, percent(noisy[0].published)]
        rows.append([SYMBOLS[name], *cells])
    return table_text(["", "clean: ours", "printed", *NOISES.values(), "printed 5 %"], rows)


def bias_table(found: StudyResult) -> str:
    """Return the table of a study of wrong known parameters: clean data, rms at 1 and 5 %."""
    rows = []
    for name in found.parameters:
        clean = found.row(name, CLEAN)
        cells = [percent(clean.mean_percent), percent(clean.published)]
        for bias in BIASES:
            row = found.row(name, Case("", 0.0, bias))
            cells += [percent(row.rms_percent), percent(row.published)]
        rows.append([SYMBOLS[name], *cells])
    levels = [cell for bias in BIASES for cell in (f"{100 * bias:g} %: rms", "printed")]
    return table_text(["", "clean: ours", "printed", *levels], rows)


def table(number: str, seeds: int) -> str:
    """Return a table of the thesis beside ours; a seed without an estimate is said on stderr."""
    noisy = TABLES[number].kind == "noise"
    levels = {"noise": (0.0, NOISE), "kinds": tuple(NOISES)} if noisy else {"bias": (0.0, *BIASES)}
    found = run_study(study_of_table(number, seeds=seeds, **levels))
    for failure in found.failed:
        print(f"Table {number}, left out: {failure}", file=sys.stderr)
    return noise_table(found) if noisy else bias_table(found)


def main() -> None:
    """Print the tables, or put them between their markers in a document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(TABLES), default=list(TABLES), metavar="NUMBER")
    parser.add_argument("--seeds", type=int, default=100, help="draws of each case (100)")
    parser.add_argument("--out", type=Path, help="document with <!-- table NUMBER --> and <!-- end -->")
    given = parser.parse_args()
    expect(given.out, *(f"table {number}" for number in given.only))
    for number in given.only:
        try:
            text = table(number, given.seeds)
        except RotorsimError as error:
            refuse(f"Table {number}: {error.problems[0].what}")
        print(f"Table {number}: {TABLES[number].diagram}\n\n{text}\n", flush=True)
        if given.out:
            fill(given.out, f"table {number}", text)


if __name__ == "__main__":
    main()
