"""Diagnosis of measured machines beside its targets: python -m benchmarks.diagnosis.measured FOLDER [--only NAME ...].

FOLDER holds the recordings silverbox, emps, tum_amb_rotor, unbalanced_disc and rlc (docs/diagnosis_measured.md). Each
is diagnosed by the command line in a process of its own, two workers.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.diagnosis.prediction import predicted
from benchmarks.harness import Line, Process, at_least, at_most, run_process, within
from rotorsim.model.load import load
from rotorsim.recordings.loading import load_recording

COMMAND = [sys.executable, "-m", "rotorsim"]
WALL = 60.0  # s, of a diagnosis on two idle cores
EMPS = {  # Janot, Gautier & Brunot (2019)
    "carriage.mass": 95.1,
    "carriage.viscous_friction": 203.5,
    "coulomb_friction.friction": 20.4,
    "coulomb_friction.offset": -3.2,
}
PEAKS = (17.0, 51.0, 60.0, 100.5, 162.0, 203.3)  # Hz, as the recording of the rotor states them
DOUBLET = (203.3, 211.5)  # Hz, likewise


class Diagnosed:
    """What `rotorsim diagnose NAME FOLDER/NAME` left behind."""

    def __init__(self, name: str, recordings: Path, out: Path) -> None:
        self.name, self.recording, self.diagram = name, recordings / name, out / "diagram.json"
        command = [*COMMAND, "diagnose", name, str(self.recording), "--out", str(out), "--workers", "2"]
        self.process: Process = run_process(command)
        if self.process.code not in (0, 1):
            sys.exit(self.process.output)
        self.data: dict[str, Any] = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))

    def lines(self, physics: str, block: str) -> list[Line]:
        """Return what is named where, and the wall time."""
        named = [item["physics"] for item in self.data["missing"]]
        alike = [name for item in self.data["missing"] for name in item["class"]]
        blocks = sorted({place["block"] for place in self.data["where"]})
        return [
            Line("missing", ", ".join(named), physics, named == [physics] == alike),
            Line("   at", ", ".join(blocks), block, blocks == [block]),
            at_most("   wall time, with report and figures", self.process.wall, WALL, "{:.1f}", "s"),
        ]

    def error(self, when: str, signal: str) -> float:
        """Return the error of a hold-out signal, before or after, of its scatter."""
        return float(self.data["fit"][when]["ports"][signal])


def silverbox(recordings: Path, out: Path) -> list[Line]:
    """Silverbox: a cubic spring missing in a linear oscillator; error on the run multisine_b."""
    found = Diagnosed("silverbox", recordings, out)
    [held] = load_recording(found.recording).select("hold_out")
    before, after = (
        1e3 * found.error(when, "oscillator.displacement") * float(held.values["y"].std())
        for when in ("before", "after")
    )
    return [
        *found.lines("cubic_stiffness", "oscillator"),
        Line("   error of the simulation, held-out run, linear", f"{before:.3f} mV rms"),
        at_most("   the same, repaired", after, 0.35, "{:.3f}", "mV rms"),
    ]


def emps(recordings: Path, out: Path) -> list[Line]:
    """EMPS: dry friction missing on a carriage in closed loop; stretches left out one by one."""
    found = Diagnosed("emps", recordings, out)
    lines = found.lines("coulomb_friction", "carriage")
    values = found.data["parameters"]["after"]
    for name, published in EMPS.items():
        value = values.get(name, {"value": float("nan"), "std": float("nan"), "unit": ""})
        lines.append(within(f"   {name}, 3 std", value["value"], published, 3 * value["std"], "{:.4g}", value["unit"]))
    before, after = (found.error(when, "carriage.displacement") for when in ("before", "after"))
    lines.append(at_least("   error of the position left out, before / after", before / after, 3.0, "{:.2f}"))
    said = re.search(r"carriage\.displacement (.*?) rms, (.*?) after", found.data["statement"])
    lines.append(Line("   the same error, before; after", "; ".join(said.groups()) if said else "not stated"))
    return lines


def tum_amb_rotor(recordings: Path, out: Path) -> list[Line]:
    """TUM rotor: rotary inertia of discs missing in a rotor at rest; six resonances."""
    found = Diagnosed("tum_amb_rotor", recordings, out)
    linear = [f"{name}={item['value']!r}" for name, item in found.data["parameters"]["before"].items()]
    before, after = _rms(_modes("tum_amb_rotor", linear)), _rms(_modes(str(found.diagram), []))
    opened = re.search(r"Open: ([\d.]+) Hz", found.data["statement"])
    at = float(opened[1]) if opened else float("nan")
    fit = found.data["fit"]
    return [
        *found.lines("disc_rotary_inertia", "rotor"),
        Line("   relative error of the six frequencies stated, rms, before", f"{before:.3f}"),
        at_most("   the same, repaired", after, 0.05, "{:.3f}"),
        Line("   each predicted from the other resonances, before", f"{fit['before']['hold_out']:.3f}"),
        Line("   the same, repaired", f"{fit['after']['hold_out']:.3f}"),
        Line(
            "   resonance that is said to be open",
            f"{at:.1f} Hz",
            f"of {DOUBLET[0]} and {DOUBLET[1]} Hz",
            bool(min(abs(at / peak - 1) for peak in DOUBLET) < 0.01),
        ),
    ]


def unbalanced_disc(recordings: Path, out: Path) -> list[Line]:
    """Unbalanced disc: the weight of an off-centre mass and dry friction missing; start from 50 samples of part2."""
    found = Diagnosed("unbalanced_disc", recordings, out)
    other = [str(item["depends_on"]) for item in found.data["missing"]]
    named = {name for item in found.data["missing"] for name in item["class"]}
    return [
        Line("missing", ", ".join(sorted(named)), "dry_friction", "dry_friction" in named),
        Line("   depends on", ", ".join(other), "angle.output", "angle.output" in other),
        *_simulated(found, "given", None),
        *_simulated(found, "repaired", 0.09),
    ]


def rlc(recordings: Path, out: Path) -> list[Line]:
    """RLC circuit: an inductance that depends on the current; start from 50 samples of test_nl."""
    found = Diagnosed("rlc", recordings, out)
    [item] = found.data["missing"]
    blocks = {place["block"] for place in found.data["where"]}
    lines = [
        Line("missing", item["physics"], "signal_dependent_gain", item["physics"] == "signal_dependent_gain"),
        Line("   depends on", str(item["depends_on"]), "coil.output", item["depends_on"] == "coil.output"),
        Line("   at", ", ".join(sorted(blocks)), "voltage, inductance", blocks <= {"voltage", "inductance"}),
    ]
    given, repaired = _simulated(found, "given", None), _simulated(found, "repaired", None)
    ratio = found.data["fit"]["before"]["hold_out"] / found.data["fit"]["after"]["hold_out"]
    return [*lines, *given, *repaired, at_least("   error of the hold-out run, before / after", ratio, 10.0, "{:.1f}")]


def _simulated(found: Diagnosed, which: str, most: float | None) -> list[Line]:
    """Return the errors of hold-out runs after their first samples, of the diagram as given (refitted), or repaired."""
    before = {name: str(item["value"]) for name, item in found.data["parameters"]["before"].items()}
    diagram = load(found.name, set=before) if which == "given" else load(found.diagram)
    lines = []
    for (run, signal), error in predicted(diagram, load_recording(found.recording)).items():
        name = f"   {signal} of {run} after 50 samples, {which}"
        text = f"{error.rms:.4g} {error.unit} rms"
        lines.append(
            Line(name, text) if most is None else at_most(name, error.rms, most, "{:.4f}", f"{error.unit} rms")
        )
    return lines


def _modes(diagram: str, settings: list[str]) -> np.ndarray:
    """Return the lowest frequencies [Hz] of a diagram; both planes are alike."""
    given = [word for text in settings for word in ("--set", text)]
    found = run_process([*COMMAND, "modes", diagram, "--json", *given])
    return np.array([mode["frequency_hz"] for mode in json.loads(found.output)["modes"]])[::2][: len(PEAKS)]


def _rms(frequencies: np.ndarray) -> float:
    return float(np.sqrt(np.mean((frequencies / np.array(PEAKS) - 1) ** 2)))


SECTIONS: dict[str, Callable[[Path, Path], list[Line]]] = {
    "silverbox": silverbox,
    "emps": emps,
    "tum_amb_rotor": tum_amb_rotor,
    "unbalanced_disc": unbalanced_disc,
    "rlc": rlc,
}


def main() -> None:
    """Print every figure beside its target; exit 1 if one is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", choices=list(SECTIONS), default=list(SECTIONS))
    given = parser.parse_args()
    missed = 0
    for name in given.only:
        print(f"\n{SECTIONS[name].__doc__}")
        with tempfile.TemporaryDirectory() as out:
            for line in SECTIONS[name](given.folder.resolve(), Path(out)):
                print(line, flush=True)
                missed += line.ok is False
    print(f"\n{missed} NOT")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
