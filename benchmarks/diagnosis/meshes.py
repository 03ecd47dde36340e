"""The residual variance of meshes where another mesh is the truth: python -m benchmarks.diagnosis.meshes FOLDER.

FOLDER: cases of `python -m benchmarks.concealed make FOLDER --kind nothing --machine fe_rigid`: beams of 15 elements,
fitted with 5, 10 and 20. Printed is the residual variance over that of the noise: with a mesh that is fine enough it
is that of noise, so that `Criteria.mesh_error` allows for other programs alone.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from rotorsim.diagnosis.evidence.base_fit import with_uncertain
from rotorsim.identification.harmonic.estimate import Search, estimate
from rotorsim.identification.harmonic.experiment import open_experiment
from rotorsim.identification.harmonic.likelihood import Likelihood
from rotorsim.model.load import load
from rotorsim.recordings.loading import load_recording
from rotorsim.signals.harmonics import harmonics_of

SUBDIVISIONS = (1, 2, 4)


def left(folder: Path) -> np.ndarray:
    """Return the residual variance of every mesh, (meshes,), over that of the noise."""
    recording = load_recording(folder)
    runs = recording.select("identify")
    harmonics = harmonics_of(recording, runs)
    out = np.empty(len(SUBDIVISIONS))
    for i, subdivisions in enumerate(SUBDIVISIONS):
        document = with_uncertain(load("fe_rigid"))
        document["blocks"]["rotor"]["parameters"]["subdivisions"] = subdivisions
        experiment = open_experiment(load(document), recording, runs=runs, harmonics=harmonics)
        found = estimate(Search(Likelihood(experiment)))
        out[i] = found.misfit / found.freedom
    return out


def main() -> int:
    """Print the residual variance of every case, and of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    cases = sorted(file.parent for file in parser.parse_args().folder.glob("*/recording.json"))
    heads = [f"{5 * s} elements" for s in SUBDIVISIONS]
    print(f"{'case':<10}" + "".join(f"{head:>16}" for head in heads))
    found = []
    with threadpool_limits(1, "blas"):
        for case in cases:
            found.append(left(case))
            print(f"{case.name:<10}" + "".join(f"{value:16.3f}" for value in found[-1]), flush=True)
    for name, figure in (("median", np.median), ("largest", np.max)):
        print(f"{name:<10}" + "".join(f"{value:16.3f}" for value in figure(found, axis=0)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
