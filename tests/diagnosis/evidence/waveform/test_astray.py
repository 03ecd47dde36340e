"""A fit of the diagram as given that leaves all sizes for want of what is missing."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from rotorsim.diagnosis.diagnosis import diagnose
from rotorsim.diagnosis.evidence.base_fit import base_fit
from rotorsim.diagnosis.evidence.fit import is_adequate
from rotorsim.diagnosis.evidence.waveform.open import nearer, waveform_evidence
from rotorsim.model.load import load
from rotorsim.recordings.recording import Recording
from tests.diagnosis.evidence.waveform.level_control import CONTROL, controlled, made

DT, SAMPLES, FINE, NOISE = 1.0, 1500, 20, (0.7, 0.2, 0.07)
TRUTH = {"heater.gain": 0.0044, "conductance.gain": 3.6, "chamber.gain": 0.00094, "loss.gain": 2.3}
STATED = {"heater.gain": 0.005, "conductance.gain": 5.0, "chamber.gain": 0.00125, "loss.gain": 2.0}
SHARE = 0.4
CHAMBER = {  # h' = 0.0044 (u - q), c' = 0.00094 (q - 2.3 c), q = 3.6 (h - c), u = 20 e + z, z' = 0.05 e
    "schema_version": 1,
    "name": "chamber",
    "blocks": {
        "setpoint": {"type": "recorded", "parameters": {"interpolation": "hold"}},
        "error": {"type": "sum", "parameters": {"signs": "+-"}},
        "proportional": {"type": "gain", "parameters": {"gain": 20.0}},
        "share": {"type": "gain", "parameters": {"gain": 0.05}},
        "integral": {"type": "integrator"},
        "power": {"type": "sum", "parameters": {"signs": "++"}},
        "heated": {"type": "sum", "parameters": {"signs": "+-"}},
        "cooled": {"type": "sum", "parameters": {"signs": "+-"}},
        "apart": {"type": "sum", "parameters": {"signs": "+-"}},
        "heater_heat": {"type": "integrator"},
        "chamber_heat": {"type": "integrator"},
        "heater_meter": {"type": "gain"},
        "chamber_meter": {"type": "gain"},
        **{name.partition(".")[0]: {"type": "gain", "parameters": {"gain": value}} for name, value in STATED.items()},
    },
    "wires": [
        ["setpoint.output", "error.input1"],
        ["chamber_meter.output", "error.input2"],
        ["error.output", "proportional.input"],
        ["error.output", "share.input"],
        ["share.output", "integral.input"],
        ["proportional.output", "power.input1"],
        ["integral.output", "power.input2"],
        ["power.output", "heated.input1"],
        ["conductance.output", "heated.input2"],
        ["heated.output", "heater.input"],
        ["heater.output", "heater_heat.input"],
        ["heater_heat.output", "apart.input1"],
        ["chamber_heat.output", "apart.input2"],
        ["apart.output", "conductance.input"],
        ["conductance.output", "cooled.input1"],
        ["loss.output", "cooled.input2"],
        ["cooled.output", "chamber.input"],
        ["chamber.output", "chamber_heat.input"],
        ["chamber_heat.output", "loss.input"],
        ["heater_heat.output", "heater_meter.input"],
        ["chamber_heat.output", "chamber_meter.input"],
    ],
    "solver": {"method": "rk4", "step": "1 s", "stop": "10 s"},
    "record": ["power.output", "heater_meter.output", "chamber_meter.output"],
    "identify": {name: {"low": 0.0} for name in STATED},
}


@cache
def heated(share: float) -> Recording:
    """Return three runs of the chamber by Euler steps, whose thermometer sees a share of the heater, too."""
    runs = []
    for seed in (1, 2, 3):
        random = np.random.default_rng(seed)
        setpoint = np.repeat(random.uniform(0.0, 10.0, SAMPLES // 250), 250)
        heater = chamber = z = 0.0
        out = np.empty((SAMPLES, 3))
        for k, r in enumerate(setpoint.tolist()):
            for n in range(FINE):
                error = r - chamber - share * heater
                power = 20 * error + z
                if n == 0:
                    out[k] = power, heater, chamber + share * heater
                flow = 3.6 * (heater - chamber)
                heater += DT / FINE * 0.0044 * (power - flow)
                chamber += DT / FINE * 0.00094 * (flow - 2.3 * chamber)
                z += DT / FINE * 0.05 * error
        out += NOISE * random.normal(size=out.shape)
        runs.append(dict(zip(("setpoint", "power", "heater_meter", "chamber_meter"), [setpoint, *out.T], strict=True)))
    return made(runs, 1 / DT)


@pytest.mark.parametrize("share", [SHARE, 0.0])
def test_a_base_fit_that_goes_astray_for_nothing_stays_near_what_was_stated(share):
    evidence = waveform_evidence(load(CHAMBER), heated(share))
    base, _ = base_fit(load(CHAMBER), evidence)
    near, said = nearer(evidence, base)
    if not share:
        assert is_adequate(base)
        assert near is base
        assert said == []
        return
    assert base.values["heater.gain"] > 100 * STATED["heater.gain"]
    assert all(0.1 <= value / STATED[name] <= 10.0 for name, value in near.values.items())
    assert base.misfit < near.misfit < 1.05 * base.misfit
    assert near.free == base.free
    went = f"fitted as given, heater.gain to {base.values['heater.gain']:.3g}"
    assert said == [f"{went}: held within 10 times what is stated, and a tenth"]


@pytest.mark.slow
@pytest.mark.parametrize("stated", [0.0011, 0.01])
def test_a_fit_stays_where_what_was_stated_is_wrong(stated):
    """FAULT: held near a gain that was 1800 times too small much more was left, and any law helped."""
    gain = {"type": "gain", "parameters": {"gain": stated}}
    diagram = load({**CONTROL, "blocks": {**CONTROL["blocks"], "actuator": gain}})
    runs = [controlled(seed, taken=lambda u: min(max(u, -6.0), 6.0)) for seed in (1, 2)]
    evidence = waveform_evidence(diagram, made(runs, 50.0))
    base, _ = base_fit(diagram, evidence)
    assert not is_adequate(base)
    assert base.values["actuator.gain"] > 100 * stated
    assert nearer(evidence, base) == (base, [])


@pytest.mark.slow
def test_what_is_missing_is_found_beside_a_fit_that_would_go_astray():
    """FAULT: beside a heater that warms up at once no law shows what it explains, and wrong ones were named."""
    done = diagnose(load(CHAMBER), heated(SHARE), workers=1)
    [effect] = done.effects
    assert (effect.physics, str(effect.spots[0])) == ("cross_talk", "chamber_meter.output")
    [share] = [name for name in done.after.values if name.endswith(".linear")]
    assert abs(done.after.values[share] - SHARE) < 4 * done.after.std([*done.after.values].index(share)) < 0.01
