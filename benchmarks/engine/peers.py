"""Compare with other block-diagram tools on the same model; write docs/peers.md.

``python -m benchmarks.engine.peers --python PEERS_VENV/bin/python`` where that environment has the peers:
``python -m venv PEERS_VENV && PEERS_VENV/bin/pip install pathsim bdsim jaxonomy`` (or the optional group
``peers`` of this project). Every run is a process of its own; the median of 3 is taken, CPU time of the
run alone (no import, no building, no compiling). PathSim and bdsim run fewer steps and are scaled by steps.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.engine import baselines
from benchmarks.harness import ROOT, medians
from rotorsim.simulation.ensemble.many import simulate_many
from rotorsim.simulation.ensemble.result import Ensemble
from rotorsim.simulation.run import simulate
from tests.systems import shipped

STEPS = 50_000
PEERS = {"jaxonomy": 50_000, "pathsim": 5_000, "bdsim": 5_000}
PUBLIC = {"jaxonomy": "jaxonomy", "pathsim": "PathSim", "bdsim": "bdsim", "scipy": "SciPy"}
ENSEMBLES = {"jaxonomy": (5_000, 64), "scipy": (5_000, 64), "pathsim": (1_000, 4)}  # steps and runs
GAINS = 9000.0, 16000.0  # K_P, as in peer_models.py


def run_peer(python: str, name: str, *numbers: int) -> dict[str, Any]:
    """Return what ``peer_models.py`` prints for one peer, or {"error": why}."""
    script = Path(__file__).with_name("peer_models.py")
    try:
        done = subprocess.run(
            [python, str(script), name, *map(str, numbers)],
            capture_output=True,
            text=True,
            timeout=900,
            cwd=ROOT,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return {"error": f"{type(error).__name__}: {error}"[:200]}
    for line in reversed(done.stdout.splitlines()):
        if line.startswith("{"):
            found: dict[str, Any] = json.loads(line)
            return found
    return {"error": (done.stderr.strip().splitlines() or ["no output"])[-1][:200]}


def measure(python: str, repeats: int = 3) -> list[dict[str, Any]]:
    """Return one row per program: name, ratio to plain C, blocks, note, deviation from plain C."""
    plain = baselines.jeffcott(STEPS, 1e-4)
    runs = {
        "C, tuned by hand": baselines.jeffcott(STEPS, 1e-4, by_hand=True),
        "plain C": plain,
        "rotorsim": shipped.runner("jeffcott", steps=STEPS),
        "rotorsim, elementary blocks": shipped.runner("jeffcott_elementary", steps=STEPS),
    }
    times = medians(runs, 9)
    unit = times["plain C"] / STEPS
    notes = {
        "C, tuned by hand": "a rotated vector for the angle, series by recurrence, forcing shared between stages",
        "plain C": "-O3, 1 by definition",
    }
    rows = []
    for name, seconds in times.items():
        note = notes.get(name, "RK4, fixed step")
        blocks = {
            "rotorsim": shipped.block_count("jeffcott"),
            "rotorsim, elementary blocks": shipped.block_count("jeffcott_elementary"),
        }.get(name, "")
        rows.append({"name": name, "ratio": seconds / STEPS / unit, "blocks": blocks, "note": note})
    for peer, steps in PEERS.items():
        found = [run_peer(python, peer, steps) for _ in range(repeats)]
        bad = next((f["error"] for f in found if "error" in f), None)
        if bad is not None:
            rows.append({"name": PUBLIC[peer], "ratio": None, "blocks": "", "note": f"did not run: {bad}"})
            continue
        seconds = statistics.median(f["cpu"] for f in found)
        reference = baselines.jeffcott(steps, 1e-4)()
        peak = float(abs(reference[:, :2]).max())
        off = max(abs(a - b) for a, b in zip(found[0]["last"], reference[-1, :2], strict=True)) / peak
        note = f"{found[0]['note']}; last point within {off:.0e} of the peak of plain C"
        wall = statistics.median(f["wall"] for f in found)
        if wall < 0.9 * seconds:  # it works on several cores at once
            note += f"; {wall / steps / unit:.3g} by wall time"
        name = f"{PUBLIC[peer]} {found[0]['version']}"
        rows.append({"name": name, "ratio": seconds / steps / unit, "blocks": found[0]["blocks"], "note": note})
    return rows


def measure_ensembles(python: str, repeats: int = 3) -> list[dict[str, Any]]:
    """Return one row per program: CPU time of a run of an ensemble over gains, beside a run of plain C."""
    model, runs = shipped.shipped("jeffcott"), 64
    gains = {"controller.KP": np.linspace(*GAINS, runs)}
    options: dict[str, Any] = {"stop": 5.0, "record": ["rotor.displacement", "controller.current"]}
    kept: list[Ensemble] = []
    actions = {
        "plain C": baselines.jeffcott(STEPS, 1e-4),
        "sums": lambda: kept.append(simulate_many(model, gains, scheduler="synchronous", **options)),
    }
    times = medians(actions, 5)
    unit = times["plain C"] / STEPS
    path = str(kept[0].provenance["path"]).partition(",")[0]
    note = f"{path}, RK4, fixed step, every run judged; peak and rms kept"
    rows = [
        {"name": "rotorsim, simulate_many", "runs": runs, "ratio": times["sums"] / runs / STEPS / unit, "note": note}
    ]
    for peer, (steps, count) in ENSEMBLES.items():
        found = [run_peer(python, peer, steps, count) for _ in range(repeats)]
        bad = next((f["error"] for f in found if "error" in f), None)
        if bad is not None:
            rows.append({"name": PUBLIC[peer], "runs": count, "ratio": None, "note": f"did not run: {bad}"})
            continue
        cpu, wall = (statistics.median(f[key] for f in found) / count / steps / unit for key in ("cpu", "wall"))
        alone = simulate(model, parameters={"controller.KP": GAINS[1]}, stop=steps * 1e-4)["rotor.displacement"]
        off = float(np.abs(alone[-1] - found[0]["last"]).max() / np.abs(alone).max())
        note = f"{found[0]['note']}; last point within {off:.0e} of the peak of rotorsim"
        note += f"; {wall:.3g} by wall time" if wall < 0.9 * cpu else ""
        rows.append({"name": f"{PUBLIC[peer]} {found[0]['version']}", "runs": count, "ratio": cpu, "note": note})
    return rows


def page(rows: list[dict[str, Any]], ensembles: list[dict[str, Any]]) -> str:
    """Return the page of docs."""
    text = [
        "# Speed beside other block-diagram tools",
        "",
        "The cracked Jeffcott rotor of thesis chapter 2 from blocks of each tool, step 0.1 ms, displacement and",
        "current recorded at every step. Ratio: CPU time per step to that of a plain hand-written C loop compiled with",
        "-O3 in the same run (import, building and compiling apart). Made by",
        "",
        "```sh",
        "python -m venv peers && peers/bin/pip install pathsim bdsim jaxonomy",
        "python -m benchmarks.engine.peers --python peers/bin/python",
        "```",
        "",
        "| program | blocks | CPU time, plain C = 1 | |",
        "|---|---|---|---|",
    ]
    for row in sorted(rows, key=lambda r: (r["ratio"] is None, r["ratio"] or 0.0)):
        ratio = "-" if row["ratio"] is None else f"{row['ratio']:.3g}"
        text.append(f"| {row['name']} | {row['blocks']} | {ratio} | {row['note']} |")
    text += [
        "",
        "The same rotor with many gains K_P, 9000 to 16 000 A/m: CPU time of one run and step, beside plain C.",
        "",
        "| program | runs | CPU time, plain C = 1 | |",
        "|---|---|---|---|",
    ]
    for row in sorted(ensembles, key=lambda r: (r["ratio"] is None, r["ratio"] or 0.0)):
        ratio = "-" if row["ratio"] is None else f"{row['ratio']:.3g}"
        text.append(f"| {row['name']} | {row['runs']} | {ratio} | {row['note']} |")
    text += [
        "",
        "The models are in [peer_models.py](../benchmarks/engine/peer_models.py). Peers are no part of CI.",
        "",
    ]
    return "\n".join(text)


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--python", default=sys.executable, help="Python of the environment that has the peers")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "peers.md")
    given = parser.parse_args()
    text = page(measure(given.python), measure_ensembles(given.python))
    given.out.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
