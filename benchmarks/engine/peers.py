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

from benchmarks.engine import baselines
from benchmarks.harness import ROOT, medians
from tests.systems import shipped

STEPS = 50_000
PEERS = {"jaxonomy": 50_000, "pathsim": 5_000, "bdsim": 5_000}
PUBLIC = {"jaxonomy": "jaxonomy", "pathsim": "PathSim", "bdsim": "bdsim"}


def run_peer(python: str, name: str, steps: int) -> dict[str, Any]:
    """Return what ``peer_models.py`` prints for one peer, or {"error": why}."""
    script = Path(__file__).with_name("peer_models.py")
    try:
        done = subprocess.run(
            [python, str(script), name, str(steps)], capture_output=True, text=True, timeout=900, cwd=ROOT, check=False
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


def page(rows: list[dict[str, Any]]) -> str:
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
    text = page(measure(given.python))
    given.out.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
