"""Diagnoses of order vectors of discs of chance: python -m benchmarks.diagnosis.orders [MACHINES] [FIRST].

Discs by SciPy (tests/diagnosis/orders.py), 100 rows of a run-up through the critical speed with slow roll and noise of
0.1 um, of every second machine alike from row to row (0.8). Each machine hides nothing, then a cubic spring, planes
that differ and a cross-coupling; the whole catalogue is asked. Printed: verdict, what is named and CPU time of each,
and how many are right: with one probe, nothing that could be across it is ever `consistent`.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import Counter
from pathlib import Path
from time import process_time

from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.model.load import load
from rotorsim.recordings.orders import load_orders
from tests.diagnosis.orders import drawn, run_up
from tests.identification.waveform.orders import ROTOR

MEMORY = 0.8
HIDDEN = {
    "nothing": ({}, "consistent"),
    "cubic spring": ({"cubic": 1e12}, "cubic_stiffness"),
    "planes that differ": ({"split": 1500.0}, "anisotropic_support"),
    "cross-coupling": ({"cross": 100.0}, "seal_cross_coupling"),
}


def main() -> None:
    """Print a line per diagnosis, and how many are right."""
    machines, first = (int(sys.argv[k]) if len(sys.argv) > k else default for k, default in ((1, 10), (2, 1000)))
    counts: dict[tuple[str, int], Counter[str]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "disc.json").write_text(json.dumps(ROTOR))
        diagram = load(str(folder / "disc.json"))
        for seed in range(first, first + machines):
            memory = MEMORY * (seed % 2)
            for what, (hidden, right) in HIDDEN.items():
                for axes in ("xy", "x"):
                    rows = run_up(folder / f"{seed}{what}{axes}", drawn(seed, **hidden), seed, memory, axes)
                    began = process_time()
                    found = diagnose(diagram, load_orders(rows), workers=1)
                    names = [" or ".join(effect.members) for effect in found.effects]
                    said = ", ".join(names) if found.verdict == "missing_physics" else found.verdict
                    print(
                        f"{seed} {what}, {len(axes)} probes, memory {memory:g}: {said}; "
                        f"{found.before.excess_variance:.3g} times the noise; {process_time() - began:.0f} s",
                        flush=True,
                    )
                    counts.setdefault((what, len(axes)), Counter())[said if said != right else f"{right} (right)"] += 1
    for (what, probes), said in counts.items():
        print(f"{what}, {probes} probes: " + "; ".join(f"{count} {one}" for one, count in said.most_common()))


if __name__ == "__main__":
    main()
