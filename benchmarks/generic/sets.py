"""Make a set of cases, over processes."""

from __future__ import annotations

import json
import shutil
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.generic.generator import KINDS, MIX, make_case
from benchmarks.generic.plants import PLANTS
from benchmarks.generic.writing import write_case

Job = tuple[str, str, str, int, tuple[int, ...], tuple[str, ...], str]  # name, kind, plant, number, seed, rows, folder


def plan(
    folder: Path, instances: int, seed: int, kind: str, diagrams: tuple[str, ...], only: tuple[str, ...] = ()
) -> list[Job]:
    """Return the jobs of a set. A case depends on seed, diagram, kind and its number, on nothing else."""
    jobs: list[Job] = []
    counts: dict[str, int] = {}
    numbers: dict[tuple[str, str], int] = {}
    share = np.array(MIX) / sum(MIX)
    for index in range(instances):
        chosen = kind
        if kind == "mixed":  # the kind that is most behind its share
            made = np.array([counts.get(k, 0) for k in KINDS])
            chosen = KINDS[int(np.argmax(share * (made.sum() + 1) - made))]
        turn = counts.get(chosen, 0)
        counts[chosen] = turn + 1
        which = diagrams[turn % len(diagrams)]
        number = numbers.get((which, chosen), 0)
        numbers[which, chosen] = number + 1
        case_seed = (seed, PLANTS[which].number, KINDS.index(chosen), number)
        jobs.append((f"g{index:04d}", chosen, which, number, case_seed, only, str(folder)))
    return jobs


def one(job: Job) -> dict[str, Any]:
    """Make and write one case; return how long it took."""
    from threadpoolctl import threadpool_limits

    name, kind, plant, number, seed, only, folder = job
    begin = time.process_time()
    with threadpool_limits(1):
        case = make_case(name, kind, plant, seed, number, only)
        truth = write_case(case, Path(folder), seed)
    return {
        "case": name,
        "kind": kind,
        "diagram": plant,
        "missing": [f"{effect.law.key} at {effect.place}" for effect in case.effects],
        "chi": truth["detectability"],
        "true_chi": (truth["scores"].get("true_refitted") or truth["scores"]["base_refitted"])["chi"],
        "integration_error": case.error,
        "attempts": case.attempts,
        "cpu_seconds": time.process_time() - begin,
    }


def make(jobs: list[Job], processes: int) -> list[dict[str, Any]]:
    """Make all cases, beside them their diagrams; one line to stderr as each is finished."""
    folder = Path(jobs[0][-1])
    (folder / "diagrams").mkdir(parents=True, exist_ok=True)
    for name in sorted({job[2] for job in jobs}):
        shutil.copy(PLANTS[name].file, folder / "diagrams" / f"{name}.json")
    said = {job[0]: f"diagrams/{job[2]}.json" for job in jobs}
    (folder / "set.json").write_text(json.dumps({"diagrams": said}, indent=1) + "\n")
    done = []
    with ProcessPoolExecutor(processes) as pool:
        for future in as_completed([pool.submit(one, job) for job in jobs]):
            done.append(future.result())
            print(f"{len(done)}/{len(jobs)} {done[-1]['case']} {done[-1]['cpu_seconds']:.1f} s", file=sys.stderr)
    return sorted(done, key=lambda item: str(item["case"]))
