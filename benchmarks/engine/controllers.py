"""Compare all controllers of the library on the thesis rotors; write docs/controllers.md.

``python -m benchmarks.engine.controllers [--out FILE]`` swaps every controller into ``jeffcott`` and
``offset_disc`` with ``rotorsim swap`` (state feedback is designed from the linearised plant; the state-space
controller gets its matrices), runs the result for 5 s and judges the last second. Sensitivity: ISO 14839-3,
largest of both axes, 0.01 Hz to 2 kHz; of the sampled controller from the plant's frequency response, see
`sampled_sensitivity`.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import ROOT, run_process
from rotorsim.errors import RotorsimError
from rotorsim.linear.control.margins import margins
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load
from rotorsim.report.style import GREY, figure, styled
from rotorsim.simulation.run import simulate

MODELS = ("jeffcott", "offset_disc")
CONTROLLERS = (
    "pid",
    "pd",
    "lead_lag",
    "state_feedback",
    "state_space",
    "discrete_pid",
    "notch_pid",
    "cross_coupled_pid",
)
DRAWN = ("pid", "pd", "lead_lag", "state_feedback", "notch_pid")  # cross_coupled_pid is pid, state_space state_feedback
HZ = np.geomspace(5.0, 2000.0, 1200)
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
    if controller == "state_space":  # any matrices will do: those that were designed for state feedback
        content = json.loads(swapped(model, "state_feedback", folder).read_text(encoding="utf-8"))
        content["blocks"]["controller"]["type"] = controller
        path.write_text(json.dumps(content), encoding="utf-8")
        return path
    tool = str(Path(sys.executable).with_name("rotorsim"))
    done = run_process([tool, "swap", f"diagrams/{model}.json", "controller", controller, "-o", str(path)])
    if done.code != 0:
        raise RotorsimError(f"rotorsim swap: {done.output.strip().splitlines()[0][:160]}")
    return path


def judge(path: Path, controller: str) -> Row:
    """Run a diagram and return its row."""
    model = compile_diagram(load(path))
    result = simulate(model, stop=WINDOW[1], record=["rotor.displacement", "controller.current"])
    if result.status != "finished":
        return Row(controller, False, note=result.message)
    window = result.time >= WINDOW[0]
    displacement = np.linalg.norm(result["rotor.displacement"][window], axis=1)
    current = result["controller.current"][window]
    levitates = float(displacement.max()) < TOUCH_DOWN
    found = margins(model, "controller.current")
    note = "" if found.stable else "unstable"
    return Row(
        controller,
        levitates and note != "unstable",
        peak=float(displacement.max()),
        rms=float(np.sqrt(np.mean(displacement**2))),
        peak_current=float(np.abs(current).max()),
        rms_current=float(np.sqrt(np.mean(current**2))),
        sensitivity=found.peak,
        zone=found.zone,
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


def sensitivity_picture() -> Figure:
    """Return |S| of the loop of the Jeffcott rotor with each continuous controller, and the zones of ISO 14839-3."""
    with styled(), tempfile.TemporaryDirectory() as folder:
        made = figure(8.0, 3.8, "jeffcott: sensitivity with each controller, zones after ISO 14839-3")
        axes = made.add_subplot()
        for k, controller in enumerate(DRAWN):  # those that lie behind are wider
            found = margins(load(swapped("jeffcott", controller, Path(folder))), "controller.current", frequencies=HZ)
            largest = np.abs(np.diagonal(found.sensitivity, axis1=1, axis2=2)).max(axis=1)
            axes.semilogx(HZ, largest, lw=4.5 - 0.8 * k, label=f"{controller}, peak {found.peak:.2f}")
        for limit, name in ((3, "A"), (4, "B"), (5, "C")):
            axes.axhline(limit, color=GREY, lw=0.8, ls="--")
            axes.annotate(
                f"zone {name} below {limit}", (HZ[0], limit), (3, -3), textcoords="offset points", va="top", fontsize=8
            )
        axes.set(xlabel="frequency [Hz]", ylabel="|S|, largest of both axes", ylim=(0, 6.4), xlim=(HZ[0], HZ[-1]))
        axes.legend(loc="upper center", ncols=3, fontsize=8)
    return made


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
        "the smallest vibration: `cross_coupled_pid` has no cross gains then and is `pid`. `state_space` has no",
        "matrices of its own and takes those that `swap` designs for `state_feedback`. Made by",
        "",
        "```sh",
        "python -m benchmarks.engine.controllers",
        "```",
        "",
        "![Sensitivity over frequency with each controller](images/controllers.png)",
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
