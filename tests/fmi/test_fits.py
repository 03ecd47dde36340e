"""Fits of diagrams with an FMU: parameters inside it, and what happens where it fails in the middle."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import butter, lfilter

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError
from rotorsim.fmi.functions import close_instances
from rotorsim.identification.identification import identify
from rotorsim.model.compiled import compile_diagram
from rotorsim.model.load import load
from rotorsim.recordings.loading import load_recording
from tests.fmi.plant import FAULTS, make_fmu
from tests.fmi.test_equations import of_plant

STIFFNESS, DAMPING = 130.0, 0.9


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the FMU, and a recording of another spring and damper, integrated here: x'' = u - 130 x - 0.9 x'."""
    folder = tmp_path_factory.mktemp("fits")
    make_fmu(folder / "plant2.fmu")
    chance = np.random.default_rng(1)
    t = np.arange(120) * 0.01
    u = lfilter(*butter(2, 0.1), 300.0 * chance.standard_normal(len(t)))

    def slope(s: float, x: np.ndarray) -> list[float]:
        return [x[1], float(np.interp(s, t, u)) - STIFFNESS * x[0] - DAMPING * x[1]]

    x = solve_ivp(slope, (0, t[-1]), [1.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=0.01).y[0]
    y = x + 0.005 * x.std() * chance.standard_normal(len(t))
    np.savetxt(folder / "run.csv", np.column_stack([u, y]), delimiter=",", header="u,y", comments="")
    signals = {"u": {"signal": "force.output", "unit": "N"}, "y": {"signal": "it.y", "unit": "m"}}
    runs = [{"id": "run", "file": "run.csv", "sample_rate": "100 Hz"}]
    document = {"name": "run", "source": "integrated in this test", "channels": signals, "runs": runs}
    (folder / "recording.json").write_text(json.dumps(document))
    return folder


def driven(folder: Path, **values: Any) -> Diagram:
    """Return the FMU under a recorded force, with its stiffness and damping free."""
    force = {"type": "recorded", "parameters": {"interpolation": "linear"}}
    diagram = of_plant(folder, blocks={"force": force}, wires=[["force.output", "it.u"]], **values)
    solver = {"step": 5e-3, "stop": 0.5}  # of 110 in a period: an error of 2e-7, far below the noise
    free = {**diagram.document, "solver": solver, "identify": {"it.stiffness": {}, "it.damping": {}}}
    return load(free, folder=folder, trust_blocks=True)


def found_right(found: Any) -> bool:
    return all(
        abs(found.parameters[name].value - true) < 4 * found.parameters[name].std < 0.02 * true
        for name, true in (("it.stiffness", STIFFNESS), ("it.damping", DAMPING))
    )


@pytest.mark.slow
def test_parameters_of_an_fmu_are_identified(folder: Path) -> None:
    assert found_right(identify(driven(folder), load_recording(folder)))


BEYOND = {"fault_time": 0.5, "fault_above": 135.0, "stiffness": 60.0, "damping": 3.0}
SAID = {
    "fail": "fmi2GetDerivatives returned fmi2Error (t = ",
    "nan": "gives der(v) = nan (t = ",
    "discard": "fmi2GetDerivatives returned fmi2Discard (t = ",
    "fatal": "fmi2GetDerivatives returned fmi2Fatal (t = ",
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", SAID)
def test_a_trial_in_which_it_fails_is_no_end_of_the_fit(folder: Path, fault: str) -> None:
    """From there the first step of the search goes beyond 135 N/m, where the FMU fails: a shorter one is tried."""
    found = identify(driven(folder, fault=FAULTS.index(fault), **BEYOND), load_recording(folder))
    assert found_right(found)
    [said] = [str(one) for one in found.warnings if one.subject == "it"]
    assert said.startswith(f"{folder}/plant2.fmu: warning: it: {SAID[fault]}")
    assert " with stiffness = 1" in said
    assert said.endswith(" failed so, and other values were tried")


def test_instances_end_when_they_are_told_to(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []

    def start(*words: Any, **options: Any) -> subprocess.Popen[bytes]:
        started.append(popen(*words, **options))
        return started[-1]

    popen = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", start)
    model = compile_diagram(driven(folder, in_process=False))

    def slope() -> np.ndarray:
        return np.array(model.rhs(0.0, model.x0(), model.z0(), model.p0))

    close_instances()
    first = slope()
    assert [one.poll() for one in started] == [None]
    close_instances()
    assert [one.poll() is None for one in started] == [False]
    np.testing.assert_array_equal(slope(), first)
    close_instances()


def test_a_fit_that_cannot_begin_says_what_failed(folder: Path) -> None:
    with pytest.raises(RotorsimError) as caught:
        identify(driven(folder, fault=FAULTS.index("fail"), fault_time=0.5), load_recording(folder))
    assert "it: fmi2GetDerivatives returned fmi2Error" in str(caught.value)
