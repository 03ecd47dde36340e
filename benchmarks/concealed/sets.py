"""Make a set of cases, over processes; run a diagnosis over a set."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np

from benchmarks.concealed.generator import KINDS, MIX, make_case
from benchmarks.concealed.machines import MACHINES
from benchmarks.concealed.scores.compact import TIMES, read_diagnoses
from benchmarks.concealed.writing import write_case

GROUPS = {"both": ("jeffcott", "fe_rigid"), "beams": ("fe_rigid", "fe_flexible", "two_amb_rotor")}
Job = tuple[
    str, str, str, int, tuple[int, ...], tuple[str, ...], tuple[str, ...], bool, str
]  # name, kind, machine, number, seed, rows, nuisances, ramps, folder


def plan(
    folder: Path,
    instances: int,
    seed: int,
    kind: str,
    machine: str,
    only: tuple[str, ...],
    nuisances: tuple[str, ...] = (),
    ramps: bool = False,
) -> list[Job]:
    """Return the jobs of a set. A case depends on seed, machine, kind and its number, on nothing else."""
    machines = GROUPS.get(machine, (machine,))
    jobs: list[Job] = []
    counts: dict[tuple[str, str], int] = {}
    share = np.array(MIX) / sum(MIX)
    for index in range(instances):
        which = machines[index % len(machines)]
        if kind == "mixed":  # the kind that is most behind its share
            made = np.array([counts.get((which, k), 0) for k in KINDS])
            chosen = KINDS[int(np.argmax(share * (made.sum() + 1) - made))]
        else:
            chosen = kind
        number = counts.get((which, chosen), 0)
        counts[which, chosen] = number + 1
        name = f"{which[0]}{index:04d}"
        case_seed = (seed, [*MACHINES].index(which), KINDS.index(chosen), number)
        jobs.append((name, chosen, which, number, case_seed, only, nuisances, ramps, str(folder)))
    return jobs


def one(job: Job) -> dict[str, Any]:
    """Make and write one case; return how long it took."""
    from threadpoolctl import threadpool_limits

    name, kind, machine, number, seed, only, nuisances, ramps, folder = job
    begin, cpu = time.perf_counter(), time.process_time()
    with threadpool_limits(1):
        case = make_case(name, kind, machine, seed, number, only, ramps)
        write_case(case, Path(folder), seed, nuisances)
    return {
        "case": name,
        "kind": kind,
        "missing": [fault.law or fault.physics for fault in case.faults],
        "detectability": case.visible,
        "attempts": case.attempts,
        "seconds": time.perf_counter() - begin,
        "cpu_seconds": time.process_time() - cpu,
    }


def make(jobs: list[Job], processes: int) -> list[dict[str, Any]]:
    """Make all cases; one line to stderr as each is finished."""
    folder = Path(jobs[0][-1])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "set.json").write_text(json.dumps({"diagrams": {job[0]: job[2] for job in jobs}}, indent=1) + "\n")
    done = []
    with ProcessPoolExecutor(processes) as pool:
        for future in as_completed([pool.submit(one, job) for job in jobs]):
            done.append(future.result())
            print(f"{len(done)}/{len(jobs)} {done[-1]['case']} {done[-1]['cpu_seconds']:.1f} s", file=sys.stderr)
    return sorted(done, key=lambda item: str(item["case"]))


def diagrams_of(folder: Path, diagram: str | None) -> dict[str, str]:
    """Return the diagram of each case: as the set or its truths say, or one for all of a shared set.

    A file is meant from the folder of the set; the shared sets of several diagrams have them beside the set.

    Raises:
        FileNotFoundError: there is no set, or it does not say which diagram its cases are of
    """
    said = folder / "set.json"
    if diagram is None and said.exists():
        found: dict[str, str] = json.loads(said.read_text())["diagrams"]
        return {name: str(folder / which) if which.endswith(".json") else which for name, which in found.items()}
    cases = [file.parent.name for file in sorted(folder.glob("*/recording.json"))]
    if diagram is None and cases:
        own = {name: _named_diagram(folder, name) for name in cases}
        if all(own.values()):
            return {name: str(which) for name, which in own.items()}
    if not cases or diagram is None:
        raise FileNotFoundError(f"{folder}: no set.json; hint: a set of others needs --diagram jeffcott or fe_rigid")
    return dict.fromkeys(cases, diagram)


def _named_diagram(folder: Path, case: str) -> Path | None:
    """Return the file of the diagram that a truth, or the description of a recording, names."""
    truth = folder / case / "truth.json"
    name = str(json.loads(truth.read_text()).get("diagram", "")) if truth.exists() else ""
    if not name:
        text = str(json.loads((folder / case / "recording.json").read_text()).get("description", ""))
        name = next((word.removesuffix(".json") for word in text.split() if word.endswith(".json")), "")
    file = folder.parent / "diagrams" / f"{name}.json"
    return file if name and file.exists() else None


def held_out(folder: Path, case: str) -> Path:
    """Return where the held-out runs of a case are: in hold_out/, or in the shared sets' FOLDER_hold_out/."""
    own = folder / "hold_out" / case
    return own if own.exists() else folder.with_name(f"{folder.name}_hold_out") / case


def diagnose(
    folder: Path, diagnoses: Path, processes: int, timeout: float, diagram: str | None, extra: list[str]
) -> dict[str, int]:
    """Run `rotorsim diagnose` on each case that has no diagnosis yet; return the exit codes (negative: stopped).

    A line in DIAGNOSES/times.jsonl tells the seconds of each, of all its processes; stopped after `timeout`.
    """
    folder = folder.resolve()
    diagrams = diagrams_of(folder, diagram)
    program = Path(sys.executable).with_name("rotorsim")
    diagnoses.mkdir(parents=True, exist_ok=True)
    there = read_diagnoses(diagnoses)  # of an earlier session, too, compacted to lines
    todo = [name for name in sorted(diagrams) if not there.get(name)]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    def run(name: str) -> int:
        begin = time.perf_counter()
        command = [str(program), "diagnose", diagrams[name], str(folder / name), "--out", str(diagnoses / name)]
        hold = held_out(folder, name)
        command += (["--hold-out", str(hold)] if hold.exists() else []) + extra
        with open(diagnoses / f"{name}.log", "w") as log:
            process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment)
            stopped = Timer(timeout, process.kill)
            stopped.start()
            _, status, used = os.wait4(process.pid, 0)  # with the processes that it has waited for
            stopped.cancel()
        code, cpu, wall = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, time.perf_counter() - begin
        process.returncode = code
        line = {"case": name, "exit": code, "cpu_s": round(cpu, 1), "wall_s": round(wall, 1)}
        with open(diagnoses / TIMES, "a") as file:
            file.write(json.dumps(line) + "\n")
        print(f"{name}: exit {code}, {cpu:.0f} s of CPU, {wall:.0f} s", file=sys.stderr)
        return code

    with ThreadPoolExecutor(processes) as pool:
        return dict(zip(todo, pool.map(run, todo), strict=True))
