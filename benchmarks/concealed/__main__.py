"""python -m benchmarks.concealed make|run|score|compare|compact|shares|check|rows: see README.md."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # small matrices: threads only cost


def _make(arguments: argparse.Namespace) -> int:
    from benchmarks.concealed import sets
    from benchmarks.concealed.generator import known_rows
    from benchmarks.concealed.measuring import NUISANCES

    only = tuple(name.strip() for name in arguments.rows.split(",") if name.strip())
    wrong = sorted(set(only) - known_rows(arguments.kind))
    if wrong:
        raise ValueError(
            f"--rows: no {', '.join(wrong)} of kind {arguments.kind}; hint: python -m benchmarks.concealed rows"
        )
    nuisances = tuple(name.strip() for name in arguments.nuisances.split(",") if name.strip())
    nuisances = NUISANCES if nuisances == ("all",) else nuisances
    wrong = sorted(set(nuisances) - set(NUISANCES))
    if wrong:
        raise ValueError(f"--nuisances: no {', '.join(wrong)}; hint: all, or of {', '.join(NUISANCES)}")
    folder = Path(arguments.folder)
    drawn = arguments.seed, arguments.kind, arguments.machine, only, nuisances, arguments.ramps
    jobs = sets.plan(folder, arguments.instances, *drawn)
    done = sets.make(jobs, arguments.processes)
    if arguments.json:
        print(json.dumps(done, indent=1))
        return 0
    for item in done:
        what = ", ".join(item["missing"]) or "-"
        print(
            f"{item['case']}  {item['kind']:8} {what:44} D {item['detectability']:9.1f}  {item['cpu_seconds']:5.1f} s"
        )
    mean = sum(item["cpu_seconds"] for item in done) / len(done)
    print(f"{len(done)} cases, {mean:.2f} s of CPU each")
    return 0


def _run(arguments: argparse.Namespace) -> int:
    from benchmarks.concealed import sets

    folder, found = Path(arguments.folder), Path(arguments.diagnoses)
    codes = sets.diagnose(folder, found, arguments.processes, arguments.timeout, arguments.diagram, arguments.options)
    failed = sorted(name for name, code in codes.items() if code not in (0, 1))
    print(f"{len(codes)} diagnosed, {len(failed)} failed{': ' + ' '.join(failed) if failed else ''}")
    return 1 if failed else 0


def _score(arguments: argparse.Namespace) -> int:
    from benchmarks.concealed.scores import score, tables

    if len(arguments.sets) % 2:
        raise ValueError(f"{arguments.sets[-1]}: no folder of its diagnoses; hint: FOLDER DIAGNOSES, for each set")
    folders = [Path(name) for name in arguments.sets]
    pairs = list(zip(folders[::2], folders[1::2], strict=True))
    judged = [item for folder, found in pairs for item in score.judge_all(folder, found)]
    result = tables.summary(judged)
    page = tables.markdown(result, f"Diagnosis of {', '.join(folder.name for folder, _ in pairs)}")
    if arguments.out:
        Path(arguments.out).write_text(page)
    print(json.dumps({"summary": result, "cases": judged}, indent=1) if arguments.json else page, end="")
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    from benchmarks.concealed.scores import comparison

    result = comparison.compare_folders(Path(arguments.before), Path(arguments.after), arguments.common)
    print(json.dumps(result, indent=1) if arguments.json else comparison.text(result))
    return 0 if result["same"] else 1


def _compact(arguments: argparse.Namespace) -> int:
    from benchmarks.concealed.scores import compact

    written = compact.write_lines(Path(arguments.diagnoses), Path(arguments.file))
    print(f"{written} diagnoses in {arguments.file}")
    return 0


def _shares(arguments: argparse.Namespace) -> int:
    from benchmarks.concealed.scores import calibrate

    found = calibrate.shares(Path(arguments.folder), Path(arguments.diagnoses))
    print(json.dumps(found, indent=1) if arguments.json else calibrate.text(found))
    return 0


def _check(arguments: argparse.Namespace) -> int:
    from benchmarks.concealed import check

    found = check.everything(arguments.quick)
    print(json.dumps(found, indent=1) if arguments.json else check.text(found))
    return 0 if all(item["error"] <= item["limit"] for item in found) else 1


def _rows(arguments: argparse.Namespace) -> int:
    from benchmarks.concealed import listing

    print(listing.listing(arguments.visible))
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Run one of the commands; return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.concealed", description=__doc__)
    verbs = parser.add_subparsers(required=True)
    make = verbs.add_parser("make", help="make a set of cases")
    make.add_argument("folder")
    make.add_argument("--instances", type=int, default=100)
    make.add_argument("--seed", type=int, default=0)
    make.add_argument("--kind", default="mixed", choices=["mixed", "nothing", "one", "two", "alias", "outside"])
    machines = ["both", "beams", "jeffcott", "fe_rigid", "fe_flexible", "two_amb_rotor"]
    make.add_argument("--machine", default="both", choices=machines, help="beams: the last three in turn")
    make.add_argument("--rows", default="", help="only these rows or laws, by commas")
    make.add_argument("--nuisances", default="", help="defects of the measuring chain, by commas, or all")
    make.add_argument("--ramps", action="store_true", help="run-ups and coast-downs instead of constant speeds")
    make.add_argument("--processes", type=int, default=2)
    make.set_defaults(do=_make)
    run = verbs.add_parser("run", help="run rotorsim diagnose on each case that has no diagnosis yet")
    run.add_argument("folder")
    run.add_argument("diagnoses")
    run.add_argument("--processes", type=int, default=2)
    run.add_argument("--diagram", help="of a set that was not made here")
    run.add_argument("--timeout", type=float, default=3600.0, help="seconds for one case")
    run.add_argument(
        "--options", nargs=argparse.REMAINDER, default=[], help="for rotorsim diagnose, after everything else"
    )
    run.set_defaults(do=_run)
    score = verbs.add_parser("score", help="compare diagnoses with the truth")
    score.add_argument("sets", nargs="+", metavar="FOLDER DIAGNOSES", help="several sets are summed up as one")
    score.add_argument("--out", help="write the page here, as markdown")
    score.set_defaults(do=_score)
    compare = verbs.add_parser("compare", help="compare two folders of diagnoses; exit 1 if they differ")
    compare.add_argument("before", help="folder of CASE/diagnosis.json or with diagnoses.jsonl")
    compare.add_argument("after")
    compare.add_argument("--common", action="store_true", help="only the cases that both have")
    compare.set_defaults(do=_compare)
    compact = verbs.add_parser("compact", help="write a line of JSON for each diagnosis: verdict, names, numbers")
    compact.add_argument("diagnoses", help="folder of CASE/diagnosis.json")
    compact.add_argument("file", help="diagnoses.jsonl of the folder where they are to be kept")
    compact.set_defaults(do=_compact)
    shares = verbs.add_parser("shares", help="what right rows and imitators explain: to set thresholds by")
    shares.add_argument("folder")
    shares.add_argument("diagnoses")
    shares.set_defaults(do=_shares)
    check = verbs.add_parser("check", help="error of the integration, convergence of the beam, against other methods")
    check.add_argument("--quick", action="store_true", help="without the laws that have corners")
    check.set_defaults(do=_check)
    rows = verbs.add_parser("rows", help="list rows and laws, their sizes, and how visible the ends are")
    rows.add_argument("--visible", action="store_true", help="simulate both ends (minutes)")
    rows.set_defaults(do=_rows)
    for verb in (make, score, compare, shares, check):
        verb.add_argument("--json", action="store_true")
    chosen = parser.parse_args(arguments)
    try:
        return int(chosen.do(chosen))
    except (FileNotFoundError, ValueError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
