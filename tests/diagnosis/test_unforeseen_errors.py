"""Errors that nobody foresaw in one hypothesis: they cost that one, are said, and nothing is consistent beside them."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.evidence.fit import Fit
from rotorsim.diagnosis.evidence.waveform.fits import WaveformFits
from rotorsim.diagnosis.search import work
from rotorsim.diagnosis.search.screening import Screening
from rotorsim.diagnosis.search.work import Work
from rotorsim.jobs.jobs import Jobs
from rotorsim.model.load import load
from rotorsim.report.diagnosis.report import save_report
from tests.diagnosis.evidence.waveform.machines import OSCILLATOR, oscillator_recording


def test_an_error_that_nobody_foresaw_costs_one_candidate_and_is_said() -> None:
    def fit(document: Any, starts: Any, effort: Any) -> Fit:
        if document == "bad":
            raise IndexError("index 29 is out of bounds")
        return Fit(document, misfit=1.0)

    def promise(document: Any, starts: Any) -> float:
        return fit(document, starts, None).misfit

    evidence: Any = SimpleNamespace(fit=fit, promise=promise)
    jobs: Any = [(name, [[{}]]) for name in ("a", "bad", "b", "c", "d", "e", "f", "g", "h", "i")]
    of = Work(evidence, Jobs(workers=1))
    fits = of.fits(jobs, work.Effort())
    assert [fit.stopped for fit in fits] == [job[0] == "bad" for job in jobs]
    assert fits[1].failure == "internal error: IndexError: index 29 is out of bounds"
    assert [np.isnan(one) for one in of.promises(jobs)] == [job[0] == "bad" for job in jobs]


def test_nothing_is_known_of_promises_beside_a_diagram_that_was_lost():
    promises = [[np.nan, 900.0, np.nan], [1000.0, 900.0, np.nan]]
    evidence: Any = None
    for found, known in zip(promises, ([None, None], [900.0, None]), strict=True):
        of: Any = SimpleNamespace(promises=lambda jobs, found=found: found)
        before = Fit({"blocks": {}}, misfit=1000.0, rows=10, equations=10, goodness=0.0)
        said = Screening(evidence, of)._by_sensitivities(before, [({}, [[{}]])] * 2)
        assert [one and one.misfit for one in said] == known


def test_nothing_is_consistent_while_a_candidate_could_not_be_fitted(monkeypatch, tmp_path):
    """FAULT: with all candidates lost to an error the verdict was consistent, with exit code 0."""
    fit = WaveformFits._fit

    def failing(self: Any, document: Any, starts: Any, effort: Any) -> Fit:
        if len(document["blocks"]) > len(OSCILLATOR["blocks"]):
            raise IndexError("index 29 is out of bounds")
        return fit(self, document, starts, effort)

    diagram, recording = load(OSCILLATOR), oscillator_recording(0.0)
    assert diagnose(diagram, recording, physics={"offset"}, workers=1).verdict == "consistent"
    monkeypatch.setattr(WaveformFits, "_fit", failing)
    found = diagnose(diagram, recording, physics={"offset"}, workers=1)
    assert found.verdict == "not_identifiable"
    assert "; no fault candidate that could be fitted explains more of it than noise would." in found.statement
    assert "Not fitted, so that nothing is said of it: offset at " in found.statement
    assert "(internal error: IndexError: index 29 is out of bounds)." in found.statement
    said = "none yet: what could not be fitted may be what is missing; once it can be, diagnose again"
    assert found.next_experiment == said
    page = save_report(found, tmp_path)[0].read_text(encoding="utf-8")
    assert "Whether physics is missing cannot be judged" in page
    assert "within its noise, which does not say that nothing is missing." in page
    assert "Physics is missing, and" not in page
