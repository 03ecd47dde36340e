"""What being an FMU costs: doStep of our jeffcott FMU from FMPy and from C, beside the same steps in plain C.

``python -m benchmarks.fmu_calls``: CPU time per step of 0.1 ms, medians of interleaved runs.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

from benchmarks import baselines
from benchmarks.harness import Line, medians
from rotorsim.cosim.loop import FastLoop
from rotorsim.fmi.export.export import export_fmu
from rotorsim.fmi.runtime.slave import open_fmu
from rotorsim.model.load import load

STEPS, H = 20_000, 1e-4
OUTPUTS = ["rotor.displacement[1]", "rotor.displacement[2]"]


def fmpy_loop(file: Path, folder: str) -> Callable[[], Any]:
    """Return the loop that a user of FMPy's low-level class writes: doStep, getReal."""
    description = read_model_description(str(file))
    references = [v.valueReference for v in description.modelVariables if v.name in OUTPUTS]
    unpacked = extract(str(file), unzipdir=folder)
    identifier = description.coSimulation.modelIdentifier
    slave = FMU2Slave(
        guid=description.guid, modelIdentifier=identifier, unzipDirectory=unpacked, instanceName="jeffcott"
    )
    slave.instantiate()
    at = [0.0]

    def run() -> None:
        if at[0]:
            slave.reset()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        for k in range(STEPS):
            slave.doStep(k * H, H)
            slave.getReal(references)
        at[0] = 1.0

    return run


def main() -> None:
    """Print the cost of a step."""
    diagram = load("jeffcott")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "jeffcott.fmu"
        export_fmu(diagram, file)
        with open_fmu(file, in_process=True) as fmu:
            slave = fmu.instantiate("cs")

            def in_c() -> None:
                slave.reset()
                slave.setup(0.0, 1e6, outputs=OUTPUTS)
                slave.exchange(np.zeros(0), 0.0)
                FastLoop([slave], np.zeros((0, 2)), np.zeros(0)).run(0.0, H, STEPS)

            slave.setup(0.0, 1e6, outputs=OUTPUTS)
            times = medians(
                {
                    "plain C": baselines.jeffcott(STEPS, H, flags=baselines.PLAIN),
                    "doStep from C": in_c,
                    "doStep from FMPy": fmpy_loop(file, str(Path(folder) / "unpacked")),
                }
            )
    for name, seconds in times.items():
        print(Line(name, f"{seconds / STEPS * 1e9:.0f} ns a step", f"{seconds / times['plain C']:.2f} of plain C"))


if __name__ == "__main__":
    main()
