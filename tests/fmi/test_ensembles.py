"""Ensembles of diagrams with FMUs: one run after another, each what it is by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rotorsim.model.load import load
from rotorsim.simulation.ensemble.many import simulate_many
from rotorsim.simulation.run import simulate
from tests.fmi.conftest import Make
from tests.fmi.test_equations import BOTH, REPLACED, with_fmu

SPEEDS = [150.0, 200.0, 260.0]
OPTIONS: dict[str, Any] = {"stop": 0.1, "reduce": ["peak", "rms", "harmonics=2", "poincare", "last"]}


@pytest.mark.slow
@BOTH
@REPLACED
def test_they_are_those_of_the_plain_diagram(fmu: Make, block: str, version: str) -> None:
    made = simulate_many(with_fmu(fmu, block, version), {"speed": SPEEDS}, **OPTIONS)
    plain = simulate_many(load("jeffcott"), {"speed": SPEEDS}, **OPTIONS)
    assert made.provenance["path"] == "one by one: a part of the diagram is an FMU"
    assert made.status.tolist() == ["finished"] * 3
    for kind, of in plain.values.items():
        for name, values in of.items():
            scale = 1e-9 * float(np.nanmax(np.abs(values)))
            assert made[kind, name] == pytest.approx(values, rel=0, abs=scale, nan_ok=True), (kind, name)


@pytest.mark.slow
def test_co_simulated_runs_are_those_by_themselves(fmu: Make) -> None:
    """Their parts hide their equations; the error of the coupling is told of each."""
    diagram = with_fmu(fmu, "controller", interface="cs")
    found = simulate_many(diagram, {"speed": SPEEDS}, stop=0.1, reduce=["last"])
    for k, speed in enumerate(SPEEDS):
        alone = simulate(diagram, parameters={"speed": speed}, stop=0.1)
        assert np.array_equal(found["last", "rotor.displacement"][k], alone["rotor.displacement"][-1])
        assert found.step_error[k] == alone.counters["step_error"]


@pytest.mark.slow
def test_workers_have_the_consent_of_the_diagram(fmu: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rotorsim.simulation.ensemble.many.STEPS_OF_A_JOB", 1.0)
    monkeypatch.setattr("rotorsim.simulation.ensemble.many.STEPS_HERE", 0.0)
    diagram = with_fmu(fmu, "controller")
    speeds = np.linspace(150.0, 260.0, 9)
    here, there = (
        simulate_many(diagram, {"speed": speeds}, stop=0.02, scheduler=how, workers=2) for how in ("synchronous", None)
    )
    assert np.array_equal(here["peak", "rotor.displacement"], there["peak", "rotor.displacement"])
