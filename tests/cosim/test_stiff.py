"""FMUs for Model Exchange with a pole that is too fast for Runge-Kutta steps."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from rotorsim.cosim.cosimulation import cosimulate_diagram
from rotorsim.fmi.export.export import export_fmu
from rotorsim.model.load import load
from rotorsim.simulation.result import Result
from tests.model.documents import document


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with x' = -5000 x, x(0) = 1, as an FMU, alone in a diagram."""
    folder = tmp_path_factory.mktemp("stiff")
    blocks = {"state": ("integrator", {"initial": 1.0}), "rate": ("gain", {"gain": -5000.0})}
    wires = [["state.output", "rate.input"], ["rate.output", "state.input"]]
    decay = document(blocks, wires, ["state.output"])
    export_fmu(load(decay), folder / "decay.fmu")
    block = {"type": "fmu", "file": "decay.fmu", "parameters": {"interface": "me"}}
    alone = {
        "name": "it",
        "blocks": {"it": block},
        "wires": [],
        "solver": {"step": 1e-3, "stop": 0.1},
        "record": ["it.output"],
    }
    (folder / "it.json").write_text(json.dumps(alone))
    return folder


def run(folder: Path, step: float, stop: float, solver: str = "rk4") -> Result:
    return cosimulate_diagram(
        load(str(folder / "it.json"), trust_blocks=True), step=step, stop=stop, master="jacobi", solver=solver
    )


def output(found: Result) -> np.ndarray:
    [name] = [name for name in found.signals if name.startswith("it.")]
    return found[name]


@pytest.mark.slow
def test_a_step_too_large_for_a_fast_pole_is_not_finished(folder: Path) -> None:
    # RK4 is stable for x' = -k x up to 2.785293563 / k = 0.557 ms
    found = run(folder, 1e-3, 0.1)
    assert np.abs(output(found)).max() > 1e100
    assert found.status == "diverged"
    assert found.message == (
        "it: the step 0.001 s of its states is too large: RK4 is stable here up to 0.000557 s (its fastest pole: "
        "-5000 1/s)\n\nhint: --solver radau (implicit), or a smaller --step"
    )
    assert run(folder, 0.55e-3, 0.1).status == "finished"


@pytest.mark.parametrize(
    "solver", ["radau", *(pytest.param(name, marks=pytest.mark.slow) for name in ("bdf", "lsoda", "dop853"))]
)
def test_other_methods_take_the_fast_pole(folder: Path, solver: str) -> None:
    found = run(folder, 1e-3, 4e-3, solver)
    assert (found.status, found.message) == ("finished", "")
    assert output(found) == pytest.approx(np.exp(-5000 * found.time), abs=1e-6)
    assert output(found)[1] == pytest.approx(math.exp(-5.0), rel=1e-4)
