"""How many simulations a search in time takes: none at a minimum, one step where the outputs are linear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rotorsim.identification.waveform.evaluation import Evaluation
from rotorsim.identification.waveform.noise import reweighted
from rotorsim.identification.waveform.recorded.data import Channels, SampledRun
from rotorsim.identification.waveform.search import OutputErrorSearch
from rotorsim.identification.waveform.subsystems import subsystems_of
from rotorsim.model.load import load

DT, SAMPLES, NOISE = 0.02, 500, 1e-3
LAG = {  # x' = 2 u - 3 x
    "schema_version": 1,
    "name": "lag",
    "blocks": {
        "voltage": {"type": "recorded", "parameters": {"interpolation": "hold"}},
        "drive": {"type": "gain", "parameters": {"gain": 2.0}},
        "balance": {"type": "sum", "parameters": {"signs": "+-"}},
        "level": {"type": "integrator"},
        "leak": {"type": "gain", "parameters": {"gain": 3.0}},
    },
    "wires": [
        ["voltage.output", "drive.input"],
        ["drive.output", "balance.input1"],
        ["leak.output", "balance.input2"],
        ["balance.output", "level.input"],
        ["level.output", "leak.input"],
    ],
    "solver": {"method": "rk4", "step": "0.1 s", "stop": "10 s"},
    "record": ["level.output"],
    "identify": {"drive.gain": {}, "leak.gain": {}},
}
IN, OUT = "voltage.output", "level.output"
CHANNELS = Channels((IN,), (OUT,), {IN: IN, OUT: OUT}, {IN: "hold"})


class Counted(OutputErrorSearch):
    """A search that counts its simulations with sensitivities and without."""

    simulations: tuple[list[bool], ...] = ([],)

    def evaluate(self, unknowns: np.ndarray, sub: int, sensitivities: bool = True) -> Evaluation:
        self.simulations[0].append(sensitivities)
        return super().evaluate(unknowns, sub, sensitivities)


@pytest.fixture
def search() -> Counted:
    """Exact solution of the lag from 0.5 under a square wave, with noise."""
    random, x, t = np.random.default_rng(4), [0.5], DT * np.arange(SAMPLES)
    u = np.sign(np.sin(2.0 * t))
    for value in u[:-1]:
        x.append(2 / 3 * value + (x[-1] - 2 / 3 * value) * np.exp(-3 * DT))
    run = SampledRun("a", {IN: u, OUT: x + NOISE * random.normal(size=SAMPLES)}, CHANNELS.kinds, t, {})
    Counted.simulations[0].clear()
    return Counted(subsystems_of(load(LAG), CHANNELS), [run], {("", OUT): NOISE**-2})


def test_a_minimum_is_left_after_one_simulation(search):
    found = search.minimise(search.first() * np.array([1.3, 0.8, 1.0]))
    assert abs(found.cost - SAMPLES) < 4 * np.sqrt(2 * SAMPLES)
    search.simulations[0].clear()
    again = search.minimise(found.unknowns)
    assert search.simulations[0] == [True]
    assert again.unknowns == pytest.approx(found.unknowns, rel=1e-12)


def test_starts_of_a_linear_diagram_are_found_in_one_step(search):
    found = replace(search, hold="theta").minimise(search.first())
    assert search.simulations[0] == [True, False, True]
    assert found.unknowns[2] == pytest.approx(0.5, abs=4 * NOISE)


def test_other_weights_need_no_simulation(search):
    _, found = reweighted(replace(search, weights={("", OUT): 1.0}), search.first())
    with_sensitivities = sum(search.simulations[0])
    search.simulations[0].clear()
    search.minimise(search.first())
    assert with_sensitivities == sum(search.simulations[0])
    assert found.cost == pytest.approx(SAMPLES, rel=1e-6)
