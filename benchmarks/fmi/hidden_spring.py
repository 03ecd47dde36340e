"""A hidden cubic spring between two FMUs of OpenModelica, and a wrong mass in one: found by `diagnose` and `identify`?

python -m benchmarks.fmi.hidden_spring FOLDER [--only CASE ...] [--isolated] [--workers N]

FOLDER holds MassSpringSubSystem1.fmu and MassSpringSubSystem2.fmu: from the wheel of gemseo-fmu 3.1.1, as
`python -m benchmarks.fmi.external` says. Each is a mass on a spring to the wall and one to the other mass, whose
position is its input; that connection is drawn: its stretch, and what each end feels of it. The recordings are made
here, of the equations of the masses written down and integrated by SciPy, with 1 % of white noise on both positions:

  nothing   nothing is hidden: `diagnose` must say consistent
  spring    the connection hardens by its cube, which the diagram lacks: static_nonlinearity on its way from one mass to
            the other; its size is printed beside the truth, and how far it is off
  mass      mass 1 is a fifth heavier than the diagram says: `identify` must find it within three standard deviations

The FMUs run in this process; --isolated: each instance in one of its own, as is the default of a block. Exit 1 where
one is wrong.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.fmi.external import HALVES
from benchmarks.harness import Line, Process, run_process
from benchmarks.markers import refuse

CASES = ("nothing", "spring", "mass")
M1, M2, K1, K2, K3 = 2.0, 3.0, 100.0, 50.0, 80.0  # kg, kg, N/m: walls K1 and K3, between the masses K2
CUBIC = 0.6  # of the hidden spring: K2 (s + CUBIC s^3); a third of the force at the largest stretch of the runs
HEAVIER = 1.2  # times M1
STARTS = ((1.0, 0.0, 0.0, 1.0), (-0.7, 0.7, 0.0, 0.0), (0.2, -1.0, 3.0, 0.0))  # x1, x2, v1, v2; the last is held out
STEP, SAMPLES = 0.02, 600  # s: some 30 samples to the shorter period; 17 periods
NOISE = 0.01  # of the rms of a position
CONNECTION = ("stretch", "pull")  # blocks between the masses, through which its law passes
SIGNIFICANT = 3.0  # standard deviations: a right estimate is farther off in 0.3 % of cases


def diagram(folder: Path, isolated: bool) -> dict[str, Any]:
    """Return the pair: the stretch of the spring between the masses, and what both ends feel of it."""
    more: dict[str, Any] = {"interface": "me", "in_process": not isolated}
    first, second = (str((folder / name).resolve()) for name in HALVES)
    return {
        "schema_version": 1,
        "name": "pair",
        "blocks": {
            "a": {"type": "fmu", "file": first, "parameters": {**more, "m1": M1, "k1": K1, "k2": K2}},
            "b": {"type": "fmu", "file": second, "parameters": {**more, "m2": M2, "k2": K2, "k3": K3}},
            "stretch": {"type": "sum", "parameters": {"signs": "+-"}},
            "pull": {"type": "gain", "parameters": {"gain": 1.0}},
            "push": {"type": "gain", "parameters": {"gain": -1.0}},
        },
        "wires": [
            ["b.x2", "stretch.input1"],
            ["a.x1", "stretch.input2"],
            ["stretch.output", "pull.input"],
            ["pull.output", "push.input"],
            ["a.x1", "a.x2"],  # inputs add up: the other end of the spring is where the mass is, and the stretch on
            ["pull.output", "a.x2"],
            ["b.x2", "b.x1"],
            ["push.output", "b.x1"],
        ],
        "identify": {"a.m1": {"low": 0.1}},
        "solver": {"step": 1e-3, "stop": 5.0},
        "record": ["a.x1", "b.x2"],
    }


def recording(folder: Path, cubic: float, m1: float, seed: int) -> None:
    """Write what the two masses do, integrated to 1e-11."""
    folder.mkdir()
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(SAMPLES)

    def slope(_: float, z: np.ndarray) -> list[float]:
        s = z[1] - z[0]
        force = K2 * (s + cubic * s**3)
        return [z[2], z[3], (force - K1 * z[0]) / m1, (-force - K3 * z[1]) / M2]

    runs = []
    for k, start in enumerate(STARTS):
        x = solve_ivp(slope, (0.0, t[-1]), start, method="DOP853", rtol=1e-11, atol=1e-12, t_eval=t).y[:2]
        x = x + NOISE * np.sqrt((x**2).mean(axis=1, keepdims=True)) * rng.standard_normal(x.shape)
        np.savetxt(folder / f"run{k}.csv", np.column_stack([t, *x]), "%.9g", ",", header="t,x1,x2", comments="")
        runs.append({"id": f"run{k}", "file": f"run{k}.csv", "use": "identify" if k < len(STARTS) - 1 else "hold_out"})
    channels = {"x1": {"signal": "a.x1", "unit": "1"}, "x2": {"signal": "b.x2", "unit": "1"}}
    about = {"name": "two masses", "source": "benchmarks.fmi.hidden_spring", "time": "t"}
    text = json.dumps({**about, "channels": channels, "runs": runs})
    (folder / "recording.json").write_text(text, encoding="utf-8")


def asked(verb: str, case: Path, folder: Path, *more: str) -> tuple[Process, dict[str, Any]]:
    """Return what `rotorsim VERB` took and wrote."""
    out = folder / f"{case.name}_{verb}"
    command = [sys.executable, "-m", "rotorsim", verb, str(folder / "pair.json"), str(case), "--trust-blocks", *more]
    done = run_process([*command, "--out", str(out)], {"OMP_NUM_THREADS": "1"})
    written = out / ("diagnosis.json" if verb == "diagnose" else "identification.json")
    if done.code not in (0, 1) or not written.is_file():
        refuse(f"{verb}: {done.output.strip()[-2000:]}")
    return done, json.loads(written.read_text(encoding="utf-8"))


def estimated(what: str, item: dict[str, Any], truth: float) -> Line:
    """Return an estimate beside the truth."""
    off = abs(item["value"] - truth)
    text = f"{item['value']:.6g} +- {item['std']:.2g}"
    return Line(what, text, f"{truth:g} within {SIGNIFICANT:g} std", off <= SIGNIFICANT * item["std"])


def diagnosed(case: Path, folder: Path, workers: int) -> list[Line]:
    """Return what `diagnose` says of a recording, beside what is so."""
    process, said = asked("diagnose", case, folder, "--workers", str(workers))
    hidden = case.name == "spring"
    verdict = "missing_physics" if hidden else "consistent"
    lines = [Line(f"{case.name}: verdict", said["verdict"], verdict, said["verdict"] == verdict)]
    if hidden:
        named = [name for item in said["missing"] for name in item["class"]]
        places = [f"{one['block']}.{one['port']}" for one in said["where"]]
        first = said["where"][0]["block"] if said["where"] else ""
        lines.append(Line("   named", ", ".join(named), "static_nonlinearity", named == ["static_nonlinearity"]))
        lines.append(Line("   likeliest places", ", ".join(places[:3]), " or ".join(CONNECTION), first in CONNECTION))
        found = {key: value for item in said["missing"] for key, value in item["parameters"].items()}
        cubic = next((value for key, value in found.items() if key.endswith("cubic")), None)
        off = (cubic["value"] - CUBIC) / cubic["std"] if cubic else 0.0
        text = f"{cubic['value']:.6g} +- {cubic['std']:.2g}, {off:+.2g} std off {CUBIC:g}" if cubic else "-"
        lines.append(Line("   cubic", text))
    return [*lines, Line("   wall time", f"{process.wall:.0f} s ({process.cpu:.0f} s CPU)")]


def identified(case: Path, folder: Path) -> list[Line]:
    """Return what `identify` says of the mass."""
    process, said = asked("identify", case, folder)
    mass = said["parameters"]["a.m1"]
    return [
        estimated("mass: a.m1", mass, HEAVIER * M1),
        Line("   90 % interval", " .. ".join(f"{end:.6g}" for end in mass["interval90"])),
        Line("   the model explains the data", str(said["adequate"]), "True", said["adequate"] is True),
        Line("   wall time", f"{process.wall:.0f} s ({process.cpu:.0f} s CPU)"),
    ]


def main() -> int:
    """Print each figure beside its target."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", default=CASES, choices=CASES, metavar="CASE")
    parser.add_argument("--isolated", action="store_true", help="each FMU in a process of its own")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0, help="of the noise of the first case; one more for each other")
    given = parser.parse_args()
    missing = [name for name in HALVES if not (given.folder / name).is_file()]
    if missing:
        refuse(f"{given.folder} does not hold {', '.join(missing)} (see --help)")
    lines: list[Line] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = json.dumps(diagram(given.folder, given.isolated))
        (folder / "pair.json").write_text(text, encoding="utf-8")
        for seed, case in enumerate(CASES, given.seed):
            if case not in given.only:
                continue
            hidden, mass = CUBIC if case == "spring" else 0.0, M1 * (HEAVIER if case == "mass" else 1.0)
            recording(folder / case, hidden, mass, seed)
            made = identified(folder / case, folder) if case == "mass" else None
            made = made or diagnosed(folder / case, folder, given.workers)
            print("\n".join(map(str, made)), flush=True)
            lines += made
    return int(any(line.ok is False for line in lines))


if __name__ == "__main__":
    sys.exit(main())
