"""Fits as plain data, runs left out by linear theory, and values written into documents."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from rotorsim.diagnose.fitting import Fit, fit_from_plain, fit_to_plain, left_out
from rotorsim.diagnose.naming import least_gain
from rotorsim.diagnose.trials import SECOND_EVALUATIONS, Trials
from rotorsim.diagnose.values import values_in
from rotorsim.diagram.diagram import Free


def test_a_run_left_out_is_what_a_fit_without_it_predicts():
    random = np.random.default_rng(1)
    sizes = [7, 5, 9]
    J, y = random.standard_normal((sum(sizes), 4)), random.standard_normal(sum(sizes))
    best = np.linalg.lstsq(J, y, rcond=None)[0]
    found = left_out(J @ best - y, J, sizes)
    at = 0
    for r, size in enumerate(sizes):
        rows = np.zeros(sum(sizes), bool)
        rows[at : at + size] = True
        others = np.linalg.lstsq(J[~rows], y[~rows], rcond=None)[0]
        error = J[rows] @ others - y[rows]
        assert found[r] == pytest.approx(error @ error, rel=1e-9)
        at += size


def test_a_fit_goes_through_plain_data():
    free = (Free("e", "e", 0, 1.0, "m", 0.0, np.inf),)
    fit = Fit({"blocks": {}}, free, np.array([2.0]), np.eye(1), np.array([False]), 3.0, 10, 12, np.ones(2), np.ones(2))
    again = fit_from_plain(fit.document, fit_to_plain(fit))
    assert again.free == free
    assert again.values == {"e": 2.0}
    assert (again.misfit, again.rows, again.equations, again.nuisances) == (3.0, 10, 12, 2)
    assert again.criterion == pytest.approx(3.0 + 2 + np.log(12))


def test_means_that_are_left_open_cost_what_noise_gives_them():
    """A model with more states that have not settled explains more of any noise: it is no better for it."""
    few = Fit({}, misfit=100.0, rows=98, equations=100)
    many = Fit({}, misfit=90.0, rows=88, equations=100)
    assert many.criterion == few.criterion
    one_more = replace(few, free=(Free("x", "x", 0, 1.0, "", 0.0, np.inf),))
    assert one_more.criterion == pytest.approx(few.criterion + np.log(100))
    assert least_gain(SimpleNamespace(fit=many), few, 1e-3) > 29  # chi-squared of ten unknowns
    assert least_gain(SimpleNamespace(fit=few), many, 1e-3) == pytest.approx(chi2.isf(1e-3, 1))


def test_values_are_written_where_parameters_are():
    document = {
        "parameters": {"e": "24 um"},
        "blocks": {"rub": {"type": "rub"}, "left": {"type": "support", "parameters": {"stiffness": [1.0, 2.0]}}},
    }
    new = values_in(document, {"e": 1e-6, "rub.gap": 2e-5, "left.stiffness[2]": 5.0, "gone.x": 1.0})
    assert new["parameters"] == {"e": 1e-6}
    assert new["blocks"]["rub"]["parameters"] == {"gap": 2e-5}
    assert new["blocks"]["left"]["parameters"]["stiffness"] == [1.0, 5.0]
    assert document["parameters"] == {"e": "24 um"}
    assert "parameters" not in document["blocks"]["rub"]


def test_a_nonlinear_law_that_began_too_far_away_is_carried_on():
    """Beside one that explains the data after few evaluations; but not for ever, if it explains hardly anything."""

    def left(times: float, nonlinear: bool = True) -> Fit:
        adequate = 0.5 if times < 1.2 else 0.0
        return Fit({}, misfit=times * 1000, rows=1000, equations=1000, goodness=adequate, nonlinear=nonlinear)

    def refined(before: float, fits: list[Fit], reached: list[float]) -> list[tuple[int, int | None]]:
        trials, asked, ends = Trials(None, None, None, None, None, None), [], iter(reached)

        def fit(jobs: list, most: int | None) -> list[Fit]:
            asked.append((len(jobs), most))
            return [left(next(ends)) for _ in jobs]

        trials._fit = fit
        trials._refined(left(before), [({"blocks": {}}, [])] * len(fits), fits, [("law", k) for k in range(len(fits))])
        return asked

    explains, far, idle = left(1.04, nonlinear=False), left(1100.0), left(4.4)
    assert refined(4.5, [explains, far], [1.1, 1.0, 1.0]) == [(1, SECOND_EVALUATIONS), (2, None)]
    assert refined(4.5, [explains, far, idle], [4.3, 4.2, 1.0]) == [(2, SECOND_EVALUATIONS), (1, None)]
    assert refined(4.5, [explains, left(4.4, nonlinear=False)], [1.0, 4.4]) == [(0, SECOND_EVALUATIONS), (2, None)]
    assert refined(4500.0, [explains, far], [1.0]) == [(1, None)]  # no rival: so much was to explain
