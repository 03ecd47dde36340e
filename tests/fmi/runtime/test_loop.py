"""The fast loop in C against the same loop in Python: equal to the last bit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rotorsim.cosim.loop import FastLoop
from rotorsim.errors import RotorsimError
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.memory import Head
from rotorsim.fmi.runtime.slave import Slave, open_fmu
from tests.fmi.plant import FAULTS, floats_only, make_fmu

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
    assert seen == [1.0]  # and every tenth of a second before


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


@pytest.mark.parametrize("here", [True, False])
def test_rows_end_before_one_that_is_not_finite(files: list[Path], here: bool) -> None:
    with open_fmu(files[0], in_process=here) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(parameters={"fault": FAULTS.index("nan"), "fault_time": 0.1}, outputs=["y"])
        loop = FastLoop([slave], np.zeros((0, 1)), np.zeros(0))
        with pytest.raises(FmuError, match="gives y = nan") as caught:
            loop.run(0.0, H, STEPS)
    assert caught.value.time == pytest.approx(0.1)
    assert len(loop.rows) == 100
    assert np.isfinite(loop.rows).all()


@pytest.mark.parametrize("here", [True, False])
def test_a_status_that_is_none_is_a_failure(files: list[Path], here: bool) -> None:
    """A warning is status 1; it had been any status below."""
    with open_fmu(files[0], in_process=here) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(parameters={"fault": FAULTS.index("below"), "fault_time": 0.1}, outputs=["y"])
        with pytest.raises(FmuError, match="DoStep returned status -1"):
            FastLoop([slave], np.zeros((0, 1)), np.zeros(0)).run(0.0, H, STEPS)
        assert slave.warned == 0


def test_who_has_failed_is_asked_again_or_said_to_be_gone(files: list[Path]) -> None:
    """The loop had gone on where it was left, without asking: it returned rows of a process that had died."""
    with open_fmu(files[0]) as fmu:
        refusing, dying = fmu.instantiate("cs", "refusing"), fmu.instantiate("cs", "dying")
        for slave, fault in ((refusing, "discard"), (dying, "segv")):
            slave.setup(parameters={"fault": FAULTS.index(fault), "fault_time": 0.1}, outputs=["y"])
            loop = FastLoop([slave], np.zeros((0, 1)), np.zeros(0))
            for _ in range(2):
                with pytest.raises(FmuError, match="refused the step" if fault == "discard" else "SIGSEGV"):
                    loop.run(0.0, H, STEPS)
        refusing.terminate()
        loop.members[0] = refusing
        with pytest.raises(RotorsimError, match="refusing is not set up"):
            loop.run(0.0, H, STEPS)


def test_what_nobody_waited_for_is_no_reply(files: list[Path]) -> None:
    """As after Ctrl-C in a step: the reply to it is not taken for that to the next."""
    with open_fmu(files[0]) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(outputs=["time", "y"])
        slave.exchange(None, 0.0, H)
        slave.begin_exchange(None, H, H)
        while slave.worker.block.head[Head.REPLY] != slave.worker.count:
            pass
        assert slave.exchange(None, 2 * H, H)[0] == pytest.approx(3 * H)
        slave.begin_exchange(None, 3 * H, H)  # it may be at work still when it is asked again
        loop = FastLoop([slave], np.zeros((0, 2)), np.zeros(0))
        assert loop.run(4 * H, H, 2)[:, 0] == pytest.approx([5 * H, 6 * H])


def test_a_failure_that_nobody_waited_for_is_dropped(tmp_path: Path) -> None:
    """A command had been carried out in the place of the failure, and the next one waited for ever."""
    with open_fmu(make_fmu(tmp_path / "plant.fmu", description=floats_only())) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(parameters={"fault": FAULTS.index("fail")}, inputs=["u"], outputs=["y"])
        FastLoop([slave], np.zeros((1, 1)), np.zeros(1))  # its steps are in C now
        for _ in range(20):
            slave.begin_exchange(np.zeros(1), 0.0, H)
            assert slave.get(["y"]) == [1.0]


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
