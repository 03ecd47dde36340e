"""What laws promise beside a fit that explains the runs: parameters and motion are right there."""

from __future__ import annotations

import numpy as np
import pytest

from rotorsim.diagnosis.catalogue.catalogue import Catalogue
from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.evidence.waveform.open import waveform_evidence
from rotorsim.model.load import load
from tests.diagnosis.evidence.waveform.level_control import made
from tests.identification.waveform.test_domain import TANK, filled


@pytest.mark.slow
def test_beside_the_motion_of_a_fit_that_explains_promises_are_what_fits_leave():
    """FAULT: beside the fit without it, of two tanks, a cross-talk at a sensor promised seven times what it leaves.

    A level that is read 4 % of the pump's voltage too high: beside the outlet that was fitted without it promises err.
    """
    runs = [filled(seed) for seed in (1, 2)]
    for run in runs:
        run["level"] = run["level"] + 0.04 * run["voltage"]
    diagram = load(TANK)
    evidence = waveform_evidence(diagram, made([*runs, filled(3)], 1.0))
    before = evidence.fit(diagram.document, [])
    every = Catalogue.of(diagram, ["cross_talk"]).candidates(evidence.load(before.document), evidence.recorded)
    [item] = [one for one in every if (one.spot.side, one.depends_on) == ("reading", "voltage.output")]
    document = item.document(values_in(before.document, before.values), dict.fromkeys(item.fault.free, 0.03))
    right = evidence.fit(document, [[{}]])
    [beside] = evidence.bounds(before, right).promises([item])
    [far] = evidence.bounds(before).promises([item])
    assert beside.misfit == pytest.approx(right.misfit, rel=0.01)
    assert far.misfit > 7 * right.misfit
    assert beside.start[f"{item.name}.linear"] == pytest.approx(0.04, rel=0.02)


@pytest.mark.slow
def test_beside_a_law_of_a_reading_the_motion_is_that_before_it():
    """FAULT: the motion was what was read, so that another law of that reading had nothing left to do."""
    runs = [filled(seed) for seed in (1, 2)]
    for run in runs:
        run["level"] = np.minimum(run["level"], np.quantile(run["level"], 0.6))
    diagram = load(TANK)
    evidence = waveform_evidence(diagram, made([*runs, filled(3)], 1.0))
    before = evidence.fit(diagram.document, [])
    every = Catalogue.of(diagram, ["saturation"]).candidates(evidence.load(before.document), evidence.recorded)
    [item] = [one for one in every if one.spot.side == "reading"]
    top = float(runs[0]["level"].max())
    document = item.document(values_in(before.document, before.values), {"lower": -1.0, "upper": top})
    right = evidence.fit(document, [[{}]])
    [beside] = evidence.bounds(before, right).promises([item])
    assert right.misfit < before.misfit / 10
    assert beside.misfit < 2 * right.misfit
