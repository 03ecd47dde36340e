"""What it costs that equations are inside an FMU, and how far off the answers are.

``python -m benchmarks.fmi.called [--steps 2000]``: the cracked rotor of `jeffcott` as it is, with its rotor and with
its controller replaced by their own FMUs (2.0 and 3.0), in this process and in processes of their own: time of an RK4
step above that of the plain diagram and of the FMU's own calls, which a loop of C makes alone (the time, the states,
outputs, inputs, derivatives, once at each stage), and the largest differences of the run, the modes and the settled
motion. As FMUs for Co-Simulation: the errors of run and settled motion over those that are told. Last an FMU that is
not ours (tests/fmi/c), with its events.
"""

from __future__ import annotations

import argparse
import copy
import ctypes
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Line, at_most
from rotorsim.diagram.diagram import Diagram
from rotorsim.fmi.export.export import export_fmu
from rotorsim.fmi.functions import functions_of
from rotorsim.linear.modes.eigenmodes import modes
from rotorsim.model.compiled import model_for_runs
from rotorsim.model.emit.toolchain import compile_c, find_compiler
from rotorsim.model.instance import make_instance
from rotorsim.model.load import load
from rotorsim.settled.periodic import periodic
from rotorsim.simulation.run import simulate

H = 1e-4
REPEATS = 400  # the least of these counts, over a second or so: others share the processors
IN_PROCESS, FOREIGN, ISOLATED = 0.5, 3.0, 15.0  # us a step above the plain diagram and the FMU's own calls
TOLD = 1.25  # of the error that is told: the next order of the method is a tenth of it at this step


def replaced(folder: Path, block: str, version: str, *, in_process: bool, interface: str = "me") -> Diagram:
    """Return jeffcott with a block replaced by its FMU."""
    plain, file = load("jeffcott"), folder / f"{block}{version[0]}.fmu"
    if not file.exists():
        export_fmu(plain, file, blocks=[block], version=version)
    document = copy.deepcopy(dict(plain.document))
    document["blocks"][block] = {"type": "fmu", "file": file.name, "parameters": {}}
    document["blocks"][block]["parameters"] = {"in_process": in_process, "interface": interface}
    return load(document, folder=folder, trust_blocks=True)


def microseconds(diagram: Diagram, steps: int) -> float:
    """Return the least time of an RK4 step [us] of several runs."""
    model = model_for_runs(diagram)
    instance = make_instance(model, [], model.p0)
    instance.start(0.0)
    rows = np.empty((steps + 1, 0))
    return least(lambda: instance.run(0, steps, 0.0, H, steps, rows)) / steps


def least(work: Callable[[], Any]) -> float:
    """Return the least time [us] that work takes."""
    found = np.inf
    for _ in range(REPEATS):
        begun = time.perf_counter()
        work()
        found = min(found, time.perf_counter() - begun)
    return 1e6 * found


OWN_CALLS = """
void own_calls(const rs_fmu *f, void *fmu, int64_t stages, double h, double *x, double *u, double *out) {
    for (int64_t k = 0; k < stages; k++) {
        const double sign = k % 2 ? -1.0 : 1.0; /* no call may rest on the one before */
        for (int64_t i = 0; i < f->n_x; i++) x[i] = sign * 1e-5;
        for (int64_t i = 0; i < f->n_u; i++) u[i] = sign * 1e-5;
        ((time_)f->set_time)(fmu, k * h);
        if (f->n_x) ((set_)f->set_x)(fmu, x, (size_t)f->n_x);
        if (f->n_y) access_real(f, f->get_real, fmu, 1, out, f->n_y);
        if (f->n_u) access_real(f, f->set_real, fmu, 0, u, f->n_u);
        if (f->n_x) ((get_)f->get_xdot)(fmu, out, (size_t)f->n_x);
        if (f->n_z) ((get_)f->get_z)(fmu, out, (size_t)f->n_z);
    }
}
"""


@cache
def _library() -> Any:
    compiler = find_compiler()
    assert compiler is not None, "no C compiler"
    return compile_c(files("rotorsim.fmi").joinpath("evaluate.h").read_text("utf-8") + OWN_CALLS, compiler, "-O3")[0]


def own_calls(diagram: Diagram, block: str, steps: int) -> float:
    """Return the least time [us] that the FMU of a block takes for what it is asked in an RK4 step, of several runs."""
    model = model_for_runs(diagram)
    model.rhs(0.0, model.x0(model.p0), model.z0(model.p0), model.p0)  # an instance is at work
    native = functions_of(diagram.nodes[block].block).equations.native
    assert native is not None, "it is not called from C"
    x, u, out = np.empty((3, 64))
    numbers = [array.ctypes.data_as(ctypes.c_void_p) for array in (x, u, out)]
    fmu = ctypes.c_void_p(next(one.of.instance for one in native._ready if one.p))
    arguments = ctypes.byref(native.made), fmu, ctypes.c_int64(4 * steps), ctypes.c_double(H / 4), *numbers
    return least(lambda: _library().own_calls(*arguments)) / steps


def foreign(folder: Path, steps: int) -> Line:
    """Return what a step of a run takes above the own calls of an FMU with events that was written by hand."""
    from tests.fmi.plant import floats_only, make_fmu

    make_fmu(folder / "plant.fmu", description=floats_only())
    block = {"type": "fmu", "file": "plant.fmu", "parameters": {"interface": "me", "in_process": True}}
    document = {"name": "it", "blocks": {"it": block}, "solver": {"step": H, "stop": H * steps}, "record": ["it.y"]}
    diagram = load(document, folder=folder, trust_blocks=True)
    taken = min(float(simulate(diagram).counters["run_cpu_seconds"]) for _ in range(REPEATS))
    above = 1e6 * taken / steps - own_calls(diagram, "it", steps)
    return at_most("an FMU of others, in process: a step of a run above its own calls", above, FOREIGN, unit="us")


def off(plain: Diagram, other: Diagram) -> tuple[float, float, float]:
    """Return the largest relative differences of a run, the poles and the settled motion."""
    runs, poles, motions = (
        [simulate(one, stop=0.05) for one in (plain, other)],
        [np.array([mode.eigenvalue for mode in modes(one).modes]) for one in (plain, other)],
        [periodic(one, speeds=[150.0], harmonics=9) for one in (plain, other)],
    )

    def largest(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.abs(a - b).max() / np.abs(a).max())

    return (
        max(largest(values, runs[1].signals[name]) for name, values in runs[0].signals.items()),
        largest(*poles),
        max(largest(values, motions[1].harmonics[name]) for name, values in motions[0].harmonics.items()),
    )


def told(plain: Diagram, other: Diagram) -> tuple[float, float, float, float]:
    """Return the errors of a run and of the settled motion with a part for Co-Simulation, each before what is told."""
    runs, motions = (
        [simulate(one, stop=0.3) for one in (plain, other)],
        [periodic(one, speeds=[150.0]) for one in (plain, other)],
    )
    run = max(
        float(np.sqrt(((values - runs[1].signals[name]) ** 2).sum() / (values**2).sum()))
        for name, values in runs[0].signals.items()
    )
    motion = max(
        float(np.abs(motions[1].harmonic(name, k) - motions[0].harmonic(name, k))[0] / np.abs(values).max())
        for name, values in motions[0].harmonics.items()
        if name not in motions[0].two_axis
        for k in range(10)
    )
    return run, float(runs[1].counters["step_error"]), motion, float(motions[1].provenance["coupling_error"][0])


def main() -> int:
    """Print the figures; return 1 if one misses its target."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=2000)
    steps = parser.parse_args().steps
    lines: list[Line] = []
    with tempfile.TemporaryDirectory() as name:
        plain = load("jeffcott")
        base = microseconds(plain, steps)
        lines.append(Line("jeffcott as it is: a step", f"{base:.3g} us"))
        for block in ("rotor", "controller"):
            for version in ("2.0", "3.0"):
                what = f"{block} as an FMU {version}"
                here = replaced(Path(name), block, version, in_process=True)
                run, poles, motion = off(plain, here)
                lines += [
                    at_most(f"{what}: run off by", run, 1e-9),
                    at_most(f"{what}: poles off by", poles, 1e-6),
                    at_most(f"{what}: settled motion off by", motion, 1e-6),
                ]
                above = microseconds(here, steps) - base
                own = own_calls(here, block, steps)
                lines += [
                    Line(f"{what}, in process: its own calls in a step", f"{own:.3g} us"),
                    at_most(
                        f"{what}, in process: a step above those and the plain", above - own, IN_PROCESS, unit="us"
                    ),
                ]
                hidden = replaced(Path(name), block, version, in_process=True, interface="cs")
                run, said, motion, motion_said = told(plain, hidden)
                lines += [
                    at_most(f"{what} (CS): run off by {run:.3g}, told {said:.3g}: ratio", run / said, TOLD),
                    at_most(
                        f"{what} (CS): settled motion off by {motion:.3g}, told {motion_said:.3g}: ratio",
                        motion / motion_said,
                        TOLD,
                    ),
                ]
            apart = replaced(Path(name), block, "2.0", in_process=False)
            above = microseconds(apart, steps // 20) - base
            lines.append(at_most(f"{block}, in a process of its own: a step above", above, ISOLATED, unit="us"))
        lines.append(foreign(Path(name), steps))
    print(*lines, sep="\n")
    return int(any(line.ok is False for line in lines))


if __name__ == "__main__":
    sys.exit(main())
