"""python -m benchmarks.generic make|list: see README.md; run, score, compare and compact are those of concealed."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # small matrices: threads only cost


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _make(arguments: argparse.Namespace) -> int:
    from benchmarks.generic import sets
    from benchmarks.generic.effects import has
    from benchmarks.generic.laws import LAWS
    from benchmarks.generic.plants import PLANTS

    diagrams, only = _words(arguments.diagrams) or tuple(PLANTS), _words(arguments.rows)
    known = {name for law in LAWS.values() for name in (law.key, law.physics)}
    for option, given, there in (("--diagrams", diagrams, set(PLANTS)), ("--rows", only, known)):
        wrong = sorted(set(given) - there)
        if wrong:
            raise ValueError(f"{option}: no {', '.join(wrong)}; hint: python -m benchmarks.generic list")
    if only:
        outside = {"one": (False,), "two": (False,), "outside": (True,)}.get(arguments.kind, (False, True))
        diagrams = tuple(name for name in diagrams if all(has(PLANTS[name], only, kind) for kind in outside))
        if not diagrams:
            raise ValueError(f"--rows: no diagram has {', '.join(only)} of kind {arguments.kind}")
    jobs = sets.plan(Path(arguments.folder), arguments.instances, arguments.seed, arguments.kind, diagrams, only)
    done = sets.make(jobs, arguments.processes)
    if arguments.json:
        print(json.dumps(done, indent=1))
        return 0
    for item in done:
        print(
            f"{item['case']}  {item['kind']:8} {item['diagram']:19} {', '.join(item['missing']) or '-':44} "
            f"chi {item['chi']:5.1f}, with the truth {item['true_chi']:.3f}  {item['cpu_seconds']:5.1f} s"
        )
    mean = sum(item["cpu_seconds"] for item in done) / len(done)
    print(f"{len(done)} cases, {mean:.1f} s of CPU each")
    return 0


def _list(arguments: argparse.Namespace) -> int:
    from benchmarks.generic.effects import effects_of
    from benchmarks.generic.laws import LAWS
    from benchmarks.generic.plants import PLANTS

    lines = ["# Laws and places", "", "| law | name in the truth | also called | equation |", "|---|---|---|---|"]
    lines += [f"| {k} | {law.physics} | {', '.join(law.also)} | {law.equation} |" for k, law in LAWS.items()]
    lines += ["", "| diagram | law | at | of |", "|---|---|---|---|"]
    for plant in PLANTS.values():
        for effect in [*effects_of(plant, False), *effects_of(plant, True)]:
            of = effect.port(effect.argument) if effect.argument else ""
            lines.append(f"| {plant.name} | {effect.law.key} | {effect.port(effect.place)} | {of} |")
    print("\n".join(lines))
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Run one of the commands; return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.generic", description=__doc__)
    verbs = parser.add_subparsers(required=True)
    make = verbs.add_parser("make", help="make a set of cases")
    make.add_argument("folder")
    make.add_argument("--instances", type=int, default=100)
    make.add_argument("--seed", type=int, default=0)
    make.add_argument("--kind", default="mixed", choices=["mixed", "nothing", "one", "two", "outside"])
    make.add_argument("--diagrams", default="", help="only these, by commas")
    make.add_argument("--rows", default="", help="only these laws, by commas")
    make.add_argument("--processes", type=int, default=2)
    make.add_argument("--json", action="store_true")
    make.set_defaults(do=_make)
    listed = verbs.add_parser("list", help="list laws and where they may be missing, as markdown")
    listed.set_defaults(do=_list)
    chosen = parser.parse_args(arguments)
    try:
        return int(chosen.do(chosen))
    except (FileNotFoundError, ValueError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
