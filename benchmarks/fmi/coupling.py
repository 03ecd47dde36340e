"""What coupling does to a magnetic bearing: error, damping kept, stability limit and cost of each master.

python -m benchmarks.fmi.coupling [--out docs/cosimulation.md]    cut at the controller; the rotor as an FMU of our own
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.cosim.cosimulation import cosimulate_diagram, couple
from rotorsim.cosim.stability import coupling_stability
from rotorsim.fmi.export.export import export_fmu
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate

MASTERS = (
    ("jacobi", 0, "Jacobi, held"),
    ("gauss_seidel", 0, "Gauss-Seidel, held"),
    ("jacobi", 1, "Jacobi, linear"),
    ("gauss_seidel", 1, "Gauss-Seidel, linear"),
    ("jacobi", 2, "Jacobi, quadratic"),
    ("iterative", 1, "iterative, linear"),
    ("iterative", 2, "iterative, quadratic"),
    ("iterative", 3, "iterative, cubic"),
)
STEPS = (5e-5, 1e-4, 2e-4, 1e-3)
INNER, STOP = 2e-5, 0.1


def rows() -> list[list[str]]:
    """Return the table: a row for each master."""
    settings = {"solver.step": INNER, "solver.stop": STOP}
    diagram = load("jeffcott", set=settings)
    whole = simulate(diagram)["rotor.displacement"]
    table = []
    with tempfile.TemporaryDirectory() as folder:
        export_fmu(diagram, Path(folder) / "rotor.fmu", blocks=["rotor"])
        document: dict[str, Any] = json.loads(json.dumps(diagram.document))
        document.pop("identify")
        document["blocks"]["rotor"] = {"type": "fmu", "file": "rotor.fmu", "parameters": {"in_process": True}}
        cut = load(document, folder=folder, trust_blocks=True)
        coupling = couple(diagram, [["rotor"]])
        for master, order, title in MASTERS:
            errors, cost = [], 0.0
            for step in (1e-4, 2e-4):
                begun = time.process_time()
                found = cosimulate_diagram(cut, step=step, master=master, order=order)
                cost = (time.process_time() - begun) / (len(found.time) - 1) * 1e6
                right = whole[:: round(step / INNER)][: len(found.time)]
                errors.append(float(np.abs(found["rotor.displacement"] - right).max() / np.abs(right).max()))
            kept = []
            for step in STEPS:
                stability = coupling_stability(coupling, step, master=master, order=order, limit=False)
                assert stability is not None
                kept.append(f"{100 * stability.kept:.1f} %" if stability.stable else "unstable")
            limit = coupling_stability(coupling, 1e-4, master=master, order=order)
            assert limit is not None
            falls = np.log2(errors[1] / errors[0])
            below = f"{limit.largest_step * 1e3:.2f} ms"
            table.append([title, f"{errors[0]:.1e}", f"{falls:.1f}", *kept, below, f"{cost:.0f} us"])
    return table


def main() -> None:
    """Print the table, or put it between its markers in a document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", help="document with the markers <!-- coupling --> and <!-- end -->")
    given = parser.parse_args()
    head = [
        "master",
        "error at 0.1 ms",
        "order",
        *(f"kept at {s * 1e3:g} ms" for s in STEPS),
        "stable below",
        "CPU a step",
    ]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(row) + " |" for row in rows()]
    text = "\n".join(lines)
    print(text)
    if given.out:
        path = Path(given.out)
        before, _, rest = path.read_text().partition("<!-- coupling -->\n")
        after = rest.partition("<!-- end -->")[2]
        path.write_text(f"{before}<!-- coupling -->\n{text}\n<!-- end -->{after}")


if __name__ == "__main__":
    main()
