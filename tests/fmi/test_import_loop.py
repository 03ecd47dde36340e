"""The fast loop in C against the same loop in Python: equal to the last bit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.fmi.failure import FmuError
from rotorsim.fmi.loop import FastLoop
from rotorsim.fmi.slave import Slave, open_fmu
from tests.fmi.plant import FAULTS, make_fmu

H, STEPS = 1e-3, 250
L = np.array([[0.0, 0.0, 3.0], [2.0, 0.0, 0.0], [0.0, -1.0, 4.0]])  # u of plant 2.0, u[1] and u[2] of plant 3.0
U0 = np.array([0.5, 0.0, -0.25])


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("plants")
    return [make_fmu(folder / f"plant{version[0]}.fmu", version) for version in ("2.0", "3.0")]


@pytest.fixture
def slaves(files: list[Path]) -> Iterator[list[Slave]]:
    with open_fmu(files[0], in_process=True) as two, open_fmu(files[1], in_process=True) as three:
        found = [two.instantiate("cs"), three.instantiate("cs")]
        for slave in found:
            slave.setup(parameters={"stiffness": 50.0}, inputs=["u"], outputs=["y"])
            slave.exchange(None, 0.0)
        yield found


def by_hand(slaves: list[Slave], sequential: bool) -> np.ndarray:
    y = np.concatenate([slave.exchange(None, 0.0) for slave in slaves])
    u_parts, y_parts = (slice(0, 1), slice(1, 3)), (slice(0, 1), slice(1, 3))
    rows = []
    for n in range(STEPS):
        t = n * H
        old = y.copy()
        for k in (1, 0) if sequential else (0, 1):
            seen = y if sequential else old
            u = [U0[i] + sum(L[i, j] * seen[j] for j in range(3) if L[i, j]) for i in range(3)]
            y[y_parts[k]] = slaves[k].exchange(np.array(u)[u_parts[k]], t, (n + 1) * H - t)
        rows.append(y.copy())
    return np.array(rows)


@pytest.mark.parametrize("sequential", [False, True])
def test_as_by_hand(slaves: list[Slave], files: list[Path], sequential: bool) -> None:
    rows = FastLoop(slaves, L, U0, order=(1, 0) if sequential else None).run(0.0, H, STEPS)
    for slave in slaves:
        slave.reset()
        slave.setup(parameters={"stiffness": 50.0}, inputs=["u"], outputs=["y"])
    assert rows == pytest.approx(by_hand(slaves, sequential), abs=1e-14)
    assert abs(rows[-1]).max() > 0.1


def test_every_other_row(slaves: list[Slave]) -> None:
    seen: list[float] = []
    rows = FastLoop(slaves, L, U0).run(0.0, H, STEPS, every=50, progress=seen.append)
    assert rows.shape == (5, 3)
    assert seen == [0.4, 1.0]  # after 100 steps, then more at once


@pytest.mark.parametrize("version", [0, 1])
def test_a_failure_names_function_time_and_log(files: list[Path], version: int) -> None:
    with open_fmu(files[version], in_process=True) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(parameters={"fault": FAULTS.index("fail"), "fault_time": 0.1}, outputs=["y"])
        loop = FastLoop([slave], np.zeros((0, 1 + version)), np.zeros(0))
        with pytest.raises(FmuError, match=r"DoStep returned fmi\dError") as caught:
            loop.run(0.0, H, STEPS)
    assert caught.value.time == pytest.approx(0.1)
    assert caught.value.kind == "error"
    assert len(caught.value.log) == 1


def test_rows_end_where_one_is_not_finite(files: list[Path]) -> None:
    with open_fmu(files[0], in_process=True) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(parameters={"fault": FAULTS.index("nan"), "fault_time": 0.1}, outputs=["y"])
        rows = FastLoop([slave], np.zeros((0, 1)), np.zeros(0)).run(0.0, H, STEPS)
    assert len(rows) == 101
    assert np.isnan(rows[-1, 0])
    assert np.isfinite(rows[:-1]).all()


def test_who_cannot_take_part(files: list[Path]) -> None:
    with open_fmu(files[0]) as apart, open_fmu(files[0], in_process=True) as here:
        far, near = apart.instantiate("cs", "far"), here.instantiate("cs", "near")
        assert not FastLoop.possible([far])
        with pytest.raises(RotorsimError) as caught:
            FastLoop([far, near], np.zeros((0, 0)), np.zeros(0))
        what = "no fast loop: far is not set up for Co-Simulation; near is not set up for Co-Simulation"
        assert caught.value.problems[0].what == what
        far.setup(outputs=["count"])
        near.setup(outputs=["count"])
        assert not FastLoop.possible([near])
