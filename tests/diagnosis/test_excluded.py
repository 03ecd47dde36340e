"""What is said of fault candidates that linear theory told to explain too little to be fitted."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from rotorsim.diagnosis.conclude.verdict import detectable_sizes, effect_of, rejected_of, unfinished
from rotorsim.diagnosis.evidence.evidence import Promise, Terms
from rotorsim.diagnosis.search.candidates import Round
from rotorsim.diagnosis.search.selection import Selection
from tests.diagnosis.test_selection import candidate
from tests.diagnosis.test_verdicts import ROWS, left


def test_what_linear_theory_excludes_is_said_with_what_it_leaves():
    """Rejected where it is told exactly, open where it is not; with the least size that would have been seen."""
    found = candidate("residual_bow", 1.0 * ROWS, 1, nuisances=0)
    kind = SimpleNamespace(parameters={"gain_error": SimpleNamespace(unit="1")})

    def law(physics: str) -> SimpleNamespace:
        fault = SimpleNamespace(free={"gain_error": (0.01,)})
        return SimpleNamespace(physics=physics, kind=kind, free=("x.gain_error",), fault=fault)

    excluded = (
        (law("sensor_gain"), Promise(500.0 * ROWS, exact=True, std={"gain_error": 1e-3})),
        (law("rub"), Promise(700.0 * ROWS)),
    )
    first = Round(left(1000.0), (found,), excluded=excluded)
    picked = Selection(left(1000.0), (found,), (first,), found.fit, 1e-4, {}, 0.0, first)
    effects = [effect_of(found, first, 0.0)]
    assert dict(rejected_of(picked, effects, Terms())) == {
        "sensor_gain": "by linear theory its residual variance is 500 times the noise, against 1"
    }
    assert dict(unfinished(picked, effects, Terms())) == {
        "rub": "was not fitted; by linear theory its residual variance is 700 times the noise"
    }
    least = 1e-3 * np.sqrt(chi2.isf(1e-4, 1))
    assert detectable_sizes(picked) == {
        "sensor_gain": {"parameter": "gain_error", "value": pytest.approx(least), "unit": "1"}
    }
