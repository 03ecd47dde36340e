"""Numbers that decide something in fits, runs and settled motions with FMUs: what each does, stated literally."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rotorsim.cosim import coupled_periodic
from rotorsim.cosim.coupled_periodic import _comes_to, _drifting, _limit, _settle, periodic_coupled
from rotorsim.errors import Place
from rotorsim.fmi import equations
from rotorsim.fmi.equations import FmuEquations
from rotorsim.fmi.functions import functions_of
from rotorsim.fmi.runtime.binding import Log
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.slave import TIMEOUT
from rotorsim.model.heard import hearing, tell
from rotorsim.simulation import switching
from rotorsim.simulation.switching import SwitchingInstance
from tests.fmi.plant import make_fmu
from tests.fmi.test_equations import of_plant


@pytest.fixture(scope="module")
def plants(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plants")
    make_fmu(folder / "plant2.fmu")
    return folder


def equations_of(folder: Path, **values: Any) -> FmuEquations:
    return functions_of(of_plant(folder, **values).nodes["it"].block).equations


# -- settled motion ----------------------------------------------------------------------------------------------------


def geometric(modes: int, terms: int) -> np.ndarray:
    """Return a sequence (terms, modes) about 1 in which each mode is a decaying turn of its own."""
    roots = 0.8 * np.exp(2j * np.pi * np.arange(modes) / modes)
    mixed = np.random.default_rng(0).standard_normal((modes, modes))
    return np.asarray(1.0 + roots[None] ** np.arange(terms)[:, None] @ mixed)


def test_the_first_periods_settle_ten_modes() -> None:
    """Of 24 periods the last half is extrapolated: 12 terms, from which 10 modes are eliminated, and not 11."""
    half = coupled_periodic.FIRST_TURNS // 2
    errors = [np.abs(_limit(geometric(modes, half)) - 1.0).max() for modes in (10, 11)]
    assert half == 12
    assert errors[0] < 1e-10 < 1e-4 < errors[1]


@pytest.mark.parametrize(("change", "turns"), [(0.9e-5, 24), (1.1e-5, 48)])
def test_what_changes_by_a_hundred_thousandth_stays(monkeypatch: pytest.MonkeyPatch, change: float, turns: int) -> None:
    """A channel that turns once; its limit as extrapolated from all later terms, and from earlier ones."""

    def rows_of(_: Any, result: Any, names: Sequence[str], times: np.ndarray, step: float) -> np.ndarray:
        return np.asarray(np.cos(2 * np.pi * times / (8 * step)))[:, None]

    ran: list[float] = []
    limits = iter([0.0, change, 0.0, 0.0])
    monkeypatch.setattr(coupled_periodic, "_limit", lambda terms: terms[-1] + next(limits))
    monkeypatch.setattr(coupled_periodic, "rows_of", rows_of)
    monkeypatch.setattr(
        coupled_periodic,
        "coupling_of",
        lambda *_, stop, **__: ran.append(stop) or SimpleNamespace(status="finished", message=""),
    )
    model: Any = SimpleNamespace(shape_of=lambda name: ())
    found, _ = _settle(model, ["y"], np.zeros(0), 1.0, 8, 2, check=False)
    assert (found.status, found.turns, ran[-1]) == ("settled", turns, turns)


def test_a_motion_that_leaves_its_limit_is_not_come_to() -> None:
    """Growth by less than STAYS is rounding."""
    for size, comes in ((0.9e-5, True), (1.1e-5, False)):
        assert _comes_to(np.array([[0.0], [0.0], [0.0], [size]]), np.zeros(1)) is comes


def test_what_grows_alike_to_a_millionth_is_no_harmonic() -> None:
    """A transient as constant as that has a time constant of a million periods, and 1536 are run at most."""
    grown = [np.array([0.0, 1.0, 2.0 + off])[:, None, None] for off in (0.9e-6, 1.1e-6)]
    assert [bool(_drifting(rows)[0]) for rows in grown] == [True, False]


@pytest.mark.parametrize(("size", "orders"), [(0.9e-6, 1), (1.1e-6, 3)])
def test_orders_above_a_millionth_are_kept(
    plants: Path, monkeypatch: pytest.MonkeyPatch, size: float, orders: int
) -> None:
    """A harmonic of that size, beside a first one of 1."""
    settled = coupled_periodic._Settled(np.array([0.0, 1.0, 0.0, size], complex)[:, None], "settled", True, 24)
    monkeypatch.setattr(coupled_periodic, "_settle", lambda *_, **__: (settled, []))
    monkeypatch.setattr(coupled_periodic, "provenance", lambda *_: {})
    names = {"y": SimpleNamespace(names=("y",), units={}, signals=lambda both: {"y": both[..., 0]})}
    monkeypatch.setattr(coupled_periodic, "Channels", lambda *_: names["y"])
    solver = SimpleNamespace(solver=SimpleNamespace(step=0.1))
    model: Any = SimpleNamespace(record_names=lambda names: ["y"], diagram=solver)
    found = periodic_coupled(model, ["y"], np.ones(1), np.zeros((1, 0)), None, harmonics=None, subharmonic=1)
    assert found.orders.max() == orders


# -- runs and fits -----------------------------------------------------------------------------------------------------


def test_steps_at_once_double_until_an_event(monkeypatch: pytest.MonkeyPatch) -> None:
    """64, 128, ... 65536, and 64 again after the event at step 200 000."""
    pieces: list[int] = []
    events = iter([None] * 12 + [200_000.5])

    def run(n0: int, n1: int, *_: Any) -> int:
        pieces.append(n1 - n0)
        return n1

    monkeypatch.setattr(switching, "event_that_waits", lambda: next(events, None))
    made: Any = object.__new__(SwitchingInstance)
    made.inner = SimpleNamespace(run=run, save=lambda: None, restore=lambda _: None)
    made.stepwise, made._ahead = False, switching.AT_ONCE[0]
    monkeypatch.setattr(made, "_guard", lambda on: None)
    monkeypatch.setattr(made, "_careful", lambda *_: None)
    made.run(0, 300_000, 0.0, 1.0, 1, np.zeros((1, 1)))
    doubled = [64 * 2**k for k in range(11)]
    assert pieces[:12] == [*doubled, 65536]
    assert pieces[14:16] == [64, 128]


def test_instances_of_six_points_are_kept_in_this_process(plants: Path) -> None:
    """Each with two for the difference by every parameter, one itself, and one that comes."""
    equations = equations_of(plants, in_process=True, label="kept")
    most = 6 * (2 * equations.n_p + 2)
    u, p = np.nan_to_num(equations._u.starts), equations._p.starts
    for k in range(most + 3):
        equations.rates(0.0, np.zeros(2), u, p + k * np.eye(len(p))[equations._p.names.index("stiffness")])
    assert len(equations._slaves) == most
    equations.close()


def test_an_fmu_is_asked_six_times_in_a_fit(plants: Path) -> None:
    equations = equations_of(plants, in_process=True, label="hangs")
    u, p = np.nan_to_num(equations._u.starts), equations._p.starts
    with hearing():
        for k in range(6):
            assert equations.rates(0.0, np.zeros(2), u, p).tolist() == [0.0, 0.0]
            tell(FmuError(f"does not answer, {k}", kind="hang", name=equations.name, place=Place("a.fmu")))
            equations.hangs = True
        with pytest.raises(FmuError, match="in which 6 times it did not answer; first: does not answer, 0") as caught:
            equations.rates(0.0, np.zeros(2), u, p)
    assert caught.value.problems[0].hint == 'more time for an answer: "timeout" among the parameters of its block, in s'
    equations.rates(0.0, np.zeros(2), u, p)  # of the next fit
    equations.close()


def test_the_time_for_an_answer_is_an_option(plants: Path) -> None:
    assert TIMEOUT == 10.0
    for timeout in ({}, {"timeout": 2.5}):
        equations = equations_of(plants, in_process=False, **timeout)
        assert equations.instances.timeout == timeout.get("timeout", 10.0)


def test_of_a_flood_of_messages_the_first_and_the_last_are_kept() -> None:
    log = Log("3.0")
    for k in range(20_000):
        log.add(0, b"c", b"%d" % k)
    lines = [text for _, _, text in log.taken()]
    said = "19000 more messages came at once and are lost"
    assert lines == [*map(str, range(500)), said, *map(str, range(19_500, 20_000))]
    assert (log.counts, log.taken()) == ({"OK": 20_000}, [])


def test_of_a_longer_flood_only_warnings_are_kept() -> None:
    log = Log("3.0")
    for k in range(21_002):  # 20 000 lost, beside the 1000 that are kept
        log.add(int(k == 21_001), b"c", b"%d" % k)
    lines = [text for _, _, text in log.taken()]
    assert lines[500:502] == ["20002 more messages came at once and are lost", "20501"]
    assert lines[-2:] == ["20999", "21001"]
    assert log.counts == {"OK": 21_001, "Warning": 1}


def test_what_has_vanished_in_c_has_in_python() -> None:
    """A decay that has ended in denormal numbers counts as zero: its relative step would be none."""
    text = (Path(equations.__file__).parent / "equations.c").read_text(encoding="utf-8")
    assert "#define RS_VANISHED 1e-250 " in text
    assert equations.VANISHED == 1e-250
    assert (equations.size_of(1e-300, 2.0), equations.size_of(-3e-9, 2.0)) == (2.0, 3e-9)
