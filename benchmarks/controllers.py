"""Compare all controllers of the library on the thesis rotors; write docs/controllers.md.

``python -m benchmarks.controllers [--out FILE]`` swaps every controller into ``jeffcott`` and
``offset_disc`` with ``rotorsim swap`` (state feedback is designed from the linearised plant), runs the
result for 5 s and judges the last second. Sensitivity: ISO 14839-3, largest of both axes, 0.01 Hz to 2 kHz.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.harness import ROOT, run_process
from rotorsim.compile import compile_diagram
from rotorsim.diagram import load
from rotorsim.errors import RotorsimError
from rotorsim.simulate import sensitivity, simulate

MODELS = ("jeffcott", "offset_disc")
CONTROLLERS = (
    "pid", "pd", "lead_lag", "state_feedback", "controller_state_space", "discrete_pid", "notch_pid",
    "cross_coupled_pid",
)  # fmt: skip
WINDOW = (4.0, 5.0)  # s
TOUCH_DOWN = 1e-3  # m; a rotor that moves further does not levitate


@dataclass(frozen=True)
class Row:
    """One controller on one model; lengths in m, currents in A, over the window, both axes."""

    controller: str
    levitates: bool
    peak: float = np.nan
    rms: float = np.nan
    peak_current: float = np.nan
    rms_current: float = np.nan
    sensitivity: float = np.nan
    zone: str = ""
    note: str = ""


def swapped(model: str, controller: str, folder: Path) -> Path:
    """Return the file of a shipped diagram with another controller, made by ``rotorsim swap``."""
    path = folder / f"{model}_{controller}.json"
    tool = str(Path(sys.executable).with_name("rotorsim"))
    done = run_process([tool, "swap", f"diagrams/{model}.json", "controller", controller, "-o", str(path)])
    if done.code != 0:
        raise RotorsimError(f"rotorsim swap: {done.output.strip()[:200]}")
    return path


def judge(path: Path, controller: str) -> Row:
    """Run a diagram and return its row."""
    model = compile_diagram(load(path))
    result = simulate(model, stop=WINDOW[1], record=["rotor.displacement", "controller.current"])
    window = result.time >= WINDOW[0]
    displacement = np.linalg.norm(result["rotor.displacement"][window], axis=1)
    current = result["controller.current"][window]
    levitates = result.status == "finished" and float(displacement.max(initial=np.inf)) < TOUCH_DOWN
    try:
        found = sensitivity(model)
        sensitivity_peak, zone, note = found.peak, found.zone, "" if found.stable else "unstable"
    except RotorsimError as error:
        sensitivity_peak, zone, note = np.nan, "-", error.problems[0].what
    return Row(
        controller,
        levitates and note != "unstable",
        peak=float(displacement.max()),
        rms=float(np.sqrt(np.mean(displacement**2))),
        peak_current=float(np.abs(current).max()),
        rms_current=float(np.sqrt(np.mean(current**2))),
        sensitivity=sensitivity_peak,
        zone=zone,
        note=note,
    )


def measure() -> dict[str, list[Row]]:
    """Return the rows of every model; a controller that cannot be swapped or run is a row that says why."""
    found: dict[str, list[Row]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for model in MODELS:
            rows = found.setdefault(model, [])
            for controller in CONTROLLERS:
                try:
                    rows.append(judge(swapped(model, controller, Path(folder)), controller))
                except RotorsimError as error:
                    rows.append(Row(controller, False, note=error.problems[0].what))
    return found


def table(rows: list[Row]) -> str:
    """Return a Markdown table of rows."""
    text = [
        "| controller | levitates | displacement, peak [um] | rms [um] | current, peak [A] | rms [A] "
        "| sensitivity peak | ISO 14839-3 zone | |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        numbers = [f"{row.peak * 1e6:.2f}", f"{row.rms * 1e6:.2f}", f"{row.peak_current:.4f}", f"{row.rms_current:.4f}"]
        numbers.append(f"{row.sensitivity:.2f}")
        shown = " | ".join("-" if n == "nan" else n for n in numbers)
        text.append(f"| `{row.controller}` | {'yes' if row.levitates else 'no'} | {shown} | {row.zone} | {row.note} |")
    return "\n".join(text)


def page(found: dict[str, list[Row]]) -> str:
    """Return the page of docs."""
    text = [
        "# Controllers compared",
        "",
        "Every controller of the library in the place of `controller`, all else as shipped: `rotorsim swap DIAGRAM",
        "controller TYPE`. Runs of 5 s from rest, the last second judged: displacement is the distance from the centre",
        "(0-peak and rms), current is per axis. Sensitivity: peak of |S| at the controller's output, zones after",
        "ISO 14839-3 (A below 3, B below 4, C below 5, else D). The gains are those that `swap` gives, not tuned for",
        "the smallest vibration. Made by",
        "",
        "```sh",
        "python -m benchmarks.controllers",
        "```",
    ]
    for model, rows in found.items():
        text += ["", f"## `{model}`", "", table(rows)]
    return "\n".join(text) + "\n"


def main() -> None:
    """Measure and write the page; exit 1 if a controller does not levitate the rotor."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "controllers.md")
    given = parser.parse_args()
    found = measure()
    text = page(found)
    given.out.write_text(text, encoding="utf-8")
    print(text)
    sys.exit(0 if all(row.levitates for rows in found.values() for row in rows) else 1)


if __name__ == "__main__":
    main()
