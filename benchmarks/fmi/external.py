"""FMUs of other tools in our diagrams: OpenModelica's masses and springs, and a PID of pythonfmu on the Jeffcott rotor.

python -m benchmarks.fmi.external FOLDER [--pythonfmu PYTHON] [--out docs/cosimulation.md]

FOLDER holds what is to be tried, either or both:
  MassSpringSubSystem1.fmu, MassSpringSubSystem2.fmu, MassSpringSystem.fmu: from the wheel of gemseo-fmu 3.1.1
    (pip download --no-deps gemseo-fmu==3.1.1; unzip -j gemseo_fmu-*.whl '*/linux/MassSpring*' -d FOLDER)
  Pid.fmu: built from benchmarks/fmi/sources/pid.py; with --pythonfmu, a Python that has pythonfmu, it is built here.

The two halves, coupled, against the whole integrated as Model Exchange; exit 1 where a target is missed.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

from benchmarks.harness import ROOT, Line, at_least, at_most
from benchmarks.markers import expect, fill, refuse, table_text
from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.runtime.slave import open_fmu
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate

HALVES = ("MassSpringSubSystem1.fmu", "MassSpringSubSystem2.fmu")
WHOLE = "MassSpringSystem.fmu"
STEPS = (1e-1, 1e-2, 1e-3)  # s, communication
JUDGED = 1  # the step of STEPS at which masters are compared: at 1 ms the iterative one is at rounding
INNER, STOP = 1e-4, 1.0  # s; own steps of Model Exchange, and of Co-Simulation where inputs move
EXPLICIT = (
    ("jacobi", 0, "Jacobi, held"),
    ("gauss_seidel", 0, "Gauss-Seidel, held"),
    ("jacobi", 1, "Jacobi, linear"),
    ("gauss_seidel", 1, "Gauss-Seidel, linear"),
    ("jacobi", 2, "Jacobi, quadratic"),
    ("gauss_seidel", 2, "Gauss-Seidel, quadratic"),
)
ITERATIVE = {
    "me": (
        ("iterative", 1, "iterative, linear"),
        ("iterative", 2, "iterative, quadratic"),
        ("iterative", 3, "iterative, cubic"),
    ),
    "cs": (("waveform", None, "waveform"),),  # these FMUs cannot restore a state
}
TITLES = {"me": "Model Exchange", "cs": "Co-Simulation"}
TARGET = 1e-6  # m, of the iterative master; the reference is to be a thousand times better
PID_STEP, PID_STOP, LAST = 1e-4, 0.3, 0.05  # s; LAST: the part of the run whose peak is taken


def halves(folder: Path, kind: str) -> Diagram:
    """Return the two halves, each fed with the position of the other's mass."""
    blocks = {
        name: {"type": "fmu", "file": file, "parameters": {"interface": kind}}
        for name, file in zip("ab", HALVES, strict=True)
    }
    return _diagram(folder, blocks, [["a.x1", "b.x1"], ["b.x2", "a.x2"]])


def whole(folder: Path, kind: str) -> Diagram:
    """Return the whole system, one FMU."""
    return _diagram(folder, {"a": {"type": "fmu", "file": WHOLE, "parameters": {"interface": kind}}}, [])


def _diagram(folder: Path, blocks: dict[str, Any], wires: list[list[str]]) -> Diagram:
    document = {
        "schema_version": 1,
        "name": "masses",
        "blocks": blocks,
        "wires": wires,
        "solver": {"step": INNER, "stop": STOP},
        "record": ["a.x1"],
    }
    return load(document, folder=folder, trust_blocks=True)


def positions(diagram: Diagram, step: float, master: str = "jacobi", order: int | None = 0) -> np.ndarray:
    """Return the positions of the masses (n, 2) [m] at the communication points."""
    found = cosimulate_diagram(diagram, step=step, master=master, order=order)
    if found.status != "finished":
        raise RotorsimError(Problem(found.message))
    return np.column_stack([found["a.x1"], found["b.x2" if "b.x2" in found.signals else "a.x2"]])


def exact(folder: Path) -> np.ndarray:
    """Return the positions (n, 2) [m] every INNER by the matrix exponential of the whole FMU's own derivatives.

    The system is linear: x' = A x + b, with A and b from its derivatives at unit states, without any integration.
    """
    with open_fmu(folder / WHOLE) as fmu:
        slave = fmu.instantiate("me")
        slave.setup(0.0, STOP, inputs=[], outputs=["x1", "x2"])
        x = slave.states()
        n = len(x)
        b = slave.derivatives(0.0, np.zeros(n))
        A = np.array([slave.derivatives(0.0, unit) - b for unit in np.eye(n)]).T
        C = np.array([slave.outputs(0.0, unit) for unit in np.eye(n)]).T
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n] = A, b
    step = expm(augmented * INNER)
    z, rows = np.append(x, 1.0), []
    for _ in range(round(STOP / INNER) + 1):
        rows.append(C @ z[:n])
        z = step @ z
    return np.array(rows)


def masses(folder: Path) -> tuple[str, list[Line]]:
    """Return the table of the masters, and what is promised."""
    reference = positions(whole(folder, "me"), INNER)

    def error(diagram: Diagram, step: float, master: str = "jacobi", order: int | None = 0) -> float:
        found = positions(diagram, step, master, order)
        return float(np.abs(found - reference[:: round(step / INNER)][: len(found)]).max())

    rows, lines = [], []
    own = float(np.abs(reference - exact(folder)).max())
    lines.append(at_most("MassSpringSystem, ME, RK4 of 0.1 ms, against exp(A t)", own, 1e-3 * TARGET, unit="m"))
    alone = [error(whole(folder, "cs"), step) for step in STEPS]
    rows.append(["Co-Simulation", "the whole FMU alone, no coupling", *(f"{e:.1e}" for e in alone), ""])
    finer = error(whole(folder, "cs"), INNER)
    lines.append(Line("MassSpringSystem, CS alone, doStep of 0.1 ms", f"{finer:.3g} m"))
    for kind in ("cs", "me"):
        diagram = halves(folder, kind)
        made = {
            title: [error(diagram, step, master, order) for step in STEPS]
            for master, order, title in (*EXPLICIT, *ITERATIVE[kind])
        }
        best = list(made)[-1]
        for title, errors in made.items():
            shown = "" if title == best else f"{errors[JUDGED] / made[best][JUDGED]:.2g}"
            rows.append([TITLES[kind], title, *(f"{e:.1e}" for e in errors), shown])
        if kind == "me":
            lines.append(at_most(f"halves, ME, {best}, 10 ms", made[best][JUDGED], TARGET, unit="m"))
        for _, order, title in EXPLICIT:
            ratio, what = (
                made[title][JUDGED] / made[best][JUDGED],
                f"halves, {kind.upper()}, 10 ms: {title} over {best}",
            )
            judged = kind == "me" or order == 0
            lines.append(at_least(what, ratio, 5.0) if judged else Line(what, f"{ratio:.3g}", "(own solver's error)"))
    head = ["interface", "master", *(f"error at {1e3 * s:g} ms [m]" for s in STEPS), "over the last, at 10 ms"]
    return table_text(head, rows), lines


def with_foreign_controller(folder: Path) -> Diagram:
    """Return the Jeffcott rotor with Pid.fmu in the place of its controller."""
    plain = load("jeffcott", set={"solver.stop": PID_STOP}, without=("bus", "reference"))
    document: dict[str, Any] = json.loads(json.dumps(plain.document))
    for key in ("identify", "layout"):
        document.pop(key, None)
    gone = ("bus", "reference")
    blocks = {name: block for name, block in document["blocks"].items() if name not in gone}
    blocks |= {"controller": {"type": "fmu", "file": "Pid.fmu"}, "axes": {"type": "mux"}}
    wires = [wire for wire in document["wires"] if not {end.partition(".")[0] for end in wire} & {"controller", *gone}]
    for k, axis in enumerate("xy", start=1):
        wires.append([f"rotor.displacement[{k}]", f"controller.{axis}"])
        wires.append([f"rotor.velocity[{k}]", f"controller.v{axis}"])
        wires.append([f"controller.i{axis}", f"axes.input{k}"])
    wires.append(["axes.output", "amb.current"])
    document |= {"blocks": blocks, "wires": wires, "record": ["rotor.displacement", "controller.ix"]}
    return load(document, folder=folder, trust_blocks=True)


def controller(folder: Path) -> tuple[str, list[Line]]:
    """Return the table of the foreign controller, and what is promised."""
    monolithic = simulate(load("jeffcott", set={"solver.stop": PID_STOP}))["rotor.displacement"]
    count = round(LAST / PID_STEP)
    with private_temporary_folder() as made:
        found = cosimulate_diagram(with_foreign_controller(folder), step=PID_STEP, master="gauss_seidel")
        processes, folders = alive(made), len(list(made.iterdir()))
    coupled = found["rotor.displacement"]
    peaks = [float(np.linalg.norm(u[-count:], axis=1).max()) for u in (coupled, monolithic)]
    apart = float(np.abs(coupled - monolithic[: len(coupled)]).max() / np.abs(monolithic).max())
    head = ["controller", "ends", "peak of the last 50 ms [um]", "processes left", "folders left"]
    rows = [
        [
            "Pid.fmu (pythonfmu), Gauss-Seidel, held, 0.1 ms",
            f"{found.status} at {found.time[-1]:.3g} s",
            f"{1e6 * peaks[0]:.3f}",
            str(processes),
            str(folders),
        ],
        ["`pid`, monolithic", "finished", f"{1e6 * peaks[1]:.3f}", "", ""],
    ]
    lines = [
        Line("Pid.fmu: the run", found.message or found.status, "finished", found.status == "finished"),
        Line("Pid.fmu: peak of the last 50 ms, coupled over monolithic", f"{peaks[0] / peaks[1]:.4f}"),
        Line("Pid.fmu: largest difference over the run, of the peak", f"{100 * apart:.2f} %"),
        at_most("Pid.fmu: processes left behind; this one goes on", processes, 0, "{:d}"),
        at_most("Pid.fmu: folders left behind", folders, 0, "{:d}"),
    ]
    return table_text(head, rows), lines


@contextlib.contextmanager
def private_temporary_folder() -> Iterator[Path]:
    """Let everything temporary of this process be made in a folder of its own."""
    before = tempfile.tempdir
    with tempfile.TemporaryDirectory(prefix="external-") as name:
        tempfile.tempdir = name
        try:
            yield Path(name)
        finally:
            tempfile.tempdir = before


def alive(folder: Path) -> int:
    """Return how many other processes were told of a folder: those that FMUs run in, orphans too (Linux)."""
    count = 0
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            count += entry.name != str(os.getpid()) and str(folder).encode() in (entry / "cmdline").read_bytes()
    return count


def build(python: str, folder: Path) -> None:
    """Build Pid.fmu by a Python that has pythonfmu."""
    with tempfile.TemporaryDirectory() as scratch:
        shutil.copy(ROOT / "benchmarks" / "fmi" / "sources" / "pid.py", scratch)
        command = [python, "-m", "pythonfmu", "build", "-f", "pid.py", "-d", str(folder.resolve())]
        try:
            done = subprocess.run(command, cwd=scratch, capture_output=True, text=True, check=False)
        except OSError as error:
            refuse(f"--pythonfmu {python}: {error.strerror}")
    if done.returncode != 0 or not (folder / "Pid.fmu").is_file():
        refuse(f"--pythonfmu {python}: {(done.stderr.strip().splitlines() or ['it made no Pid.fmu'])[-1]}")


def main() -> None:
    """Print tables and targets, or put the tables between their markers in a document; exit 1 for a target missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pythonfmu", metavar="PYTHON", help="build Pid.fmu by this Python, which has pythonfmu")
    parser.add_argument("--out", type=Path, help="document with <!-- masses -->, <!-- pythonfmu --> and <!-- end -->")
    given = parser.parse_args()
    parts = {"masses": (masses, (*HALVES, WHOLE)), "pythonfmu": (controller, ("Pid.fmu",))}
    expect(given.out, *parts)
    if given.pythonfmu:
        build(given.pythonfmu, given.folder)
    lines: list[Line] = []
    tried = 0
    for name, (measure, files) in parts.items():
        missing = [file for file in files if not (given.folder / file).is_file()]
        if missing:
            print(f"left out: {name}: {given.folder} does not hold {', '.join(missing)} (see --help)\n")
            continue
        tried += 1
        try:
            text, found = measure(given.folder)
        except RotorsimError as error:
            refuse(f"{name}: {error.problems[0].what}")
        print(f"{text}\n", flush=True)
        lines += found
        if given.out:
            fill(given.out, name, text)
    print("\n".join(map(str, lines)))
    sys.exit(2 if not tried else int(any(line.ok is False for line in lines)))


if __name__ == "__main__":
    main()
