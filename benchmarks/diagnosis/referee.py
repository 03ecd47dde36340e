"""The referee of residuals on a set with known truths: python -m benchmarks.diagnosis.referee FOLDER [--limit N].

FOLDER: a set of `benchmarks.generic make`, or a shared one with its truths. Of every case the diagram as given is
fitted, and a black box predicts hold-out runs of its residual (rotorsim.identification.waveform.predictability).
Printed: that share with its level, and where the place that is wrong stands among those at which a free signal is
estimated; in the end false alarms and power at several shares (the receiver operating characteristic).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.concealed.sets import diagrams_of
from rotorsim.criteria import CRITERIA
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.base_fit import base_fit
from rotorsim.diagnosis.evidence.fit import is_noise
from rotorsim.diagnosis.evidence.waveform.open import waveform_evidence
from rotorsim.errors import RotorsimError
from rotorsim.identification.waveform.noise import judged_beside, reweighted
from rotorsim.model.load import load as load_diagram
from rotorsim.recordings.loading import load_recording

SHARES = (0.005, 0.01, 0.02, 1 - 1 / CRITERIA.model_error, 0.1, 0.2, 0.4)
VISIBLE = (1.0, 4.0, 10.0, np.inf)  # residual over noise floor: classes of the power


@dataclass(frozen=True)
class Judged:
    """share: largest one whose level is below that of false alarms. left: residual variance over that of what counts
    as noise. noise: whether that is taken for noise. rank: of the place that is wrong, 0 for none.
    """

    case: str
    missing: Sequence[str]
    visible: float
    share: float
    level: float
    left: float
    noise: bool
    rank: int
    places: int


def truth_of(folder: Path, case: str) -> dict[str, Any]:
    """Return the truth of a case, which lies in truth/ or beside its recording."""
    own = folder / "truth" / f"{case}.json"
    found: dict[str, Any] = json.loads((own if own.exists() else folder / case / "truth.json").read_text())
    return found


def judged(folder: Path, case: str, diagram: str) -> Judged:
    """Return what the referee says of the residual of a diagram as given."""
    truth, document = truth_of(folder, case), load_diagram(diagram)
    evidence = waveform_evidence(document, load_recording(folder / case))
    fit, _ = base_fit(document, evidence)
    values = values_in(fit.document, fit.values)
    search = evidence.search(values)
    search, evaluation = reweighted(search, search.first(evidence.starts))
    found = judged_beside(evidence.load(values), search, evaluation)
    share = float(found.share[found.level < CRITERIA.false_alarm].max(initial=0.0))
    bounds = evidence.bounds(fit) if truth["missing"] else None
    ports = [str(bounds.places[item.place]) for item in bounds.unknown.estimates()] if bounds else []
    accepted = {place for effect in truth["effects"] for place in effect["accepted_locations"]}
    rank = next((k for k, port in enumerate(ports, 1) if port in accepted), 0)
    visible = float(truth.get("detectability") or 1.0)
    left, noise = fit.misfit / fit.freedom, is_noise(fit)
    return Judged(case, truth["missing"], visible, share, float(found.level.min()), left, noise, rank, len(ports))


def printed(cases: Sequence[Judged]) -> list[str]:
    """Return the table of false alarms and power, and how the places rank."""
    healthy, wrong = [c for c in cases if not c.missing], [c for c in cases if c.missing]
    classes = [[c for c in wrong if low <= c.visible < high] for low, high in pairwise(VISIBLE)]
    names = [f"{low:g} to {high:g} times the noise" for low, high in pairwise(VISIBLE)]
    lines = ["", "| share above | healthy | " + " | ".join(names) + " |", "|---" * (2 + len(names)) + "|"]
    for share in SHARES:
        alarms = [f"{sum(c.share > share for c in group)} of {len(group)}" for group in (healthy, *classes)]
        lines.append(f"| {100 * share:.2g} % | " + " | ".join(alarms) + " |")
    alarms = [f"{sum(not c.noise for c in group)} of {len(group)}" for group in (healthy, *classes)]
    lines.append("| residual is no noise | " + " | ".join(alarms) + " |")
    first = sum(c.rank == 1 for c in wrong), sum(0 < c.rank <= 3 for c in wrong)
    lines += ["", f"the place that is wrong is the likeliest {first[0]} times, among three {first[1]}, of {len(wrong)}"]
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what the referee says of every case of a set, and its false alarms and power."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.diagnosis.referee", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--limit", type=int, help="only so many cases")
    chosen = parser.parse_args(arguments)
    cases = []
    for case, diagram in sorted(diagrams_of(chosen.folder.resolve(), None).items())[: chosen.limit]:
        try:
            cases.append(judged(chosen.folder.resolve(), case, diagram))
        except RotorsimError as error:
            print(f"{case}: {error}")
            continue
        last = cases[-1]
        print(
            f"{case}  share {last.share:8.3f}, level {last.level:7.1e}; left {last.left:8.2f}; "
            f"{last.visible:6.1f} times the noise; "
            f"place {last.rank} of {last.places}; {', '.join(last.missing) or '-'}",
            flush=True,
        )
    print("\n".join(printed(cases)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
