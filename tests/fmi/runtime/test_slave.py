"""FMUs at work: both versions, both kinds, in this process and in another; numbers against formulas."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rotorsim.errors import RotorsimError
from rotorsim.fmi.runtime.failure import FmuError
from rotorsim.fmi.runtime.slave import Fmu, Slave, open_fmu
from tests.fmi.plant import make_fmu

OMEGA = math.sqrt(100.0 - 0.25**2)  # x'' + 0.5 x' + 100 x = 0


def exact(t: float) -> float:
    """Return x(t) of the plant from x = 1, v = 0."""
    return math.exp(-0.25 * t) * (math.cos(OMEGA * t) + 0.25 / OMEGA * math.sin(OMEGA * t))


@pytest.fixture(scope="session")
def plants(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("plants")
    return {version: make_fmu(folder / f"plant{version[0]}.fmu", version) for version in ("2.0", "3.0")}


@pytest.fixture(params=["2.0 here", "2.0 apart", "3.0 here", "3.0 apart"])
def fmu(request: pytest.FixtureRequest, plants: dict[str, Path]) -> Iterator[Fmu]:
    version, where = request.param.split()
    with open_fmu(plants[version], in_process=where == "here") as opened:
        yield opened


def step_on(slave: Slave, n_u: int, steps: int, h: float) -> np.ndarray:
    return np.array([slave.exchange(np.zeros(n_u), k * h, h) for k in range(steps)])


def test_co_simulation_against_the_formula(fmu: Fmu) -> None:
    slave = fmu.instantiate("cs")
    slave.setup(0.0, 1.0, inputs=["u"], outputs=["y"])
    n = len(slave.input_names)
    y = step_on(slave, n, 1000, 1e-3)[:, 0]
    error = max(abs(value - exact((k + 1) * 1e-3)) for k, value in enumerate(y))
    assert error < 1e-3**4 * 10.0**5 / 100  # the error of RK4 is h^4 omega^5 t / 120
    slave.terminate()


def test_both_places_agree_to_the_last_bit(plants: dict[str, Path]) -> None:
    for version, path in plants.items():
        found = []
        for here in (True, False):
            with open_fmu(path, in_process=here) as fmu:
                slave = fmu.instantiate("cs")
                slave.setup(0.0, 1.0, parameters={"damping": 0.3}, inputs=["u"], outputs=["y", "v"])
                u = np.linspace(0.5, 1.0, len(slave.input_names))
                found.append([slave.exchange(u * k, k * 1e-2, 1e-2) for k in range(50)])
        assert np.array_equal(*found), version


def test_inputs_reach_the_outputs_without_a_step(fmu: Fmu) -> None:
    slave = fmu.instantiate("cs")
    slave.setup(parameters={"gain": 2.0}, inputs=["u"], outputs=["y"], exit_initialisation=False)
    n = len(slave.input_names)
    assert slave.exchange(np.full(n, 3.0), 0.0)[0] == 1.0 + 2.0 * 3.0  # while it initialises
    slave.exit_initialisation()
    assert slave.exchange(np.full(n, -1.0), 0.0)[0] == 1.0 - 2.0
    assert slave.exchange(None, 0.0)[0] == -1.0  # inputs stay


def rk4(slave: Slave, x: np.ndarray, t: float, h: float) -> np.ndarray:
    a = slave.derivatives(t, x)
    b = slave.derivatives(t + h / 2, x + h / 2 * a)
    c = slave.derivatives(t + h / 2, x + h / 2 * b)
    d = slave.derivatives(t + h, x + h * c)
    return x + h / 6 * (a + 2 * b + 2 * c + d)


@pytest.mark.slow
def test_model_exchange_gives_the_same_as_its_co_simulation(fmu: Fmu) -> None:
    me, cs = fmu.instantiate("me"), fmu.instantiate("cs")
    me.setup(outputs=["y"])
    cs.setup(outputs=["y"])
    x = me.states()
    assert x.tolist() == [1.0, 0.0] if me.n_states == 2 else [1.0, 0.0, 0.0, 0.0]
    assert me.nominals().tolist() in ([1.0, 10.0], [1.0, 1.0, 10.0, 10.0])
    for k in range(100):
        x = rk4(me, x, k * 1e-2, 1e-2)
        y = cs.exchange(None, k * 1e-2, 1e-2)
        assert not me.completed_step((k + 1) * 1e-2, x)
    assert me.outputs(1.0, x) == pytest.approx(y, abs=1e-13)
    slope, again = me.evaluate(1.0, x)
    assert np.array_equal(again, me.outputs(1.0, x))
    assert np.array_equal(slope, me.derivatives(1.0, x))


def test_events(fmu: Fmu) -> None:
    slave = fmu.instantiate("me")
    slave.setup(parameters={"wall": 0.5, "tick": 0.25}, outputs=["count"])
    assert slave.last_event().next_time == 0.25
    x = np.zeros(slave.n_states)
    half = slave.n_states // 2
    x[0], x[half] = 0.4, 2.0
    assert slave.event_indicators(0.1, x)[0] == pytest.approx(-0.1)
    x[0] = 0.5
    update = slave.event_update(0.1, x)
    assert update.states_changed
    assert update.next_time == 0.25
    assert slave.states()[half] == -2.0
    assert slave.outputs(0.1, None)[0] == 0.0
    assert slave.event_update(0.25).next_time == 0.5
    assert slave.outputs(0.25, None)[0] == 1.0


def test_discrete_inputs_of_model_exchange_are_set_at_events(fmu: Fmu) -> None:
    slave = fmu.instantiate("me")
    slave.setup(inputs=["u", "enabled"], outputs=["y"])
    n, half = slave.n_states, slave.n_states // 2
    u = np.append(np.full(half, 7.0), 0.0)
    assert slave.derivatives(0.0, np.zeros(n), u)[half] == 7.0  # still enabled
    slave.event_update(0.0, np.zeros(n), u)
    assert slave.derivatives(0.0, np.zeros(n), u)[half] == 0.0


def test_states_are_saved_and_restored(fmu: Fmu) -> None:
    slave = fmu.instantiate("cs")
    slave.setup(outputs=["y"])
    slave.exchange(None, 0.0, 0.1)
    saved = slave.save_state()
    first = [slave.exchange(None, 0.1 + 0.1 * k, 0.1) for k in range(5)]
    slave.restore_state(saved)
    again = [slave.exchange(None, 0.1 + 0.1 * k, 0.1) for k in range(5)]
    assert np.array_equal(first, again)
    data = slave.serialise_state(saved)
    slave.restore_state(slave.deserialise_state(data))
    assert np.array_equal(slave.exchange(None, 0.1, 0.1), first[0])
    slave.free_state(saved)
    with pytest.raises(FmuError, match="there is no such saved state"):
        slave.restore_state(saved)


def test_directional_derivatives(fmu: Fmu) -> None:
    slave = fmu.instantiate("me")
    slave.setup(outputs=["y"])
    if fmu.description.version == "2.0":
        assert slave.jacobian(["der(x)", "der(v)"], ["x", "v", "u"]).tolist() == [[0, 1, 0], [-100, -0.5, 1]]
        assert slave.directional(["der(v)"], ["x", "u"], np.array([0.01, 5.0])).tolist() == [4.0]
    else:
        assert slave.jacobian(["der(v)"], ["x"]).tolist() == [[-100, 0], [0, -100]]
        assert slave.jacobian(["der(v)[2]"], ["u[2]", "u[1]"]).tolist() == [[1, 0]]
        assert slave.directional(["der(v)"], ["v"], np.array([2.0, 4.0])).tolist() == [-1.0, -2.0]
        assert slave.jacobian(["der(v)"], ["x"], "adjoint").tolist() == [[-100, 0], [0, -100]]
        assert slave.jacobian(["der(v)[2]"], ["u[2]", "u[1]"], "adjoint").tolist() == [[1, 0]]


def test_derivatives_of_outputs_and_inputs(fmu: Fmu) -> None:
    slave = fmu.instantiate("cs")
    slave.setup(inputs=["u"], outputs=["y"])
    n = len(slave.input_names)
    slave.exchange(np.zeros(n), 0.0, 0.1)
    assert slave.output_derivatives(1)[0] == slave.get(["v"])[0]
    with pytest.raises(FmuError, match="of order 2 are not offered: the highest is 1"):
        slave.output_derivatives(2)
    if fmu.description.version == "2.0":
        slave.exchange(np.zeros(n), 0.1, 0.1, np.full((1, n), 3.0))
        assert slave.get(["label"]) == ["3one"]  # the plant notes that it was 3
    else:
        with pytest.raises(FmuError, match="derivatives of inputs of order 1 cannot be set: the highest is 0"):
            slave.exchange(np.zeros(n), 0.1, 0.1, np.full((1, n), 3.0))


def test_values_of_all_types(fmu: Fmu) -> None:
    slave = fmu.instantiate("cs")
    slave.setup(parameters={"label": "rotor ä", "stiffness": 1, "enabled": False}, outputs=["y"])
    assert slave.get(["label", "stiffness", "enabled", "count"]) == ["rotor ä", 1.0, False, 0]
    slave.set(["stiffness", "enabled"], [2.5, True])
    assert slave.get(["stiffness", "enabled"]) == [2.5, True]


def test_whole_numbers_and_flags_in_a_step(fmu: Fmu) -> None:
    slave = fmu.instantiate("cs")
    slave.setup(parameters={"tick": 0.1}, inputs=["enabled", "u"], outputs=["count", "y"])
    u = np.zeros(len(slave.input_names))
    u[0] = 1.0
    assert slave.exchange(u, 0.0, 0.25)[0] == 2.0
    assert slave.get(["enabled"]) == [True]


def test_parts_of_an_array_leave_the_rest(plants: dict[str, Path]) -> None:
    with open_fmu(plants["3.0"], in_process=True) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(parameters={"u": [0.0, 5.0]}, inputs=["u[1]"], outputs=["y[2]", "x[1]"])
        slave.exchange(np.array([3.0]), 0.0)
        assert slave.get(["u"]) == [3.0, 5.0]
        slave.set(["u[2]"], [6.0])
        assert slave.get(["u", "u[2]"]) == [3.0, 6.0, 6.0]
        assert slave.input_names == ("u[1]",)
        assert slave.output_names == ("y[2]", "x[1]")
        with pytest.raises(RotorsimError, match="3 values for an array of shape \\[2\\]"):
            slave.set(["u"], [[1.0, 2.0, 3.0]])


def test_whole_numbers_are_never_cut(plants: dict[str, Path]) -> None:
    with open_fmu(plants["2.0"]) as fmu:
        slave = fmu.instantiate("cs")
        slave.setup(inputs=["level"])
        slave.exchange(np.array([-3.0]), 0.0)
        assert slave.get(["level"]) == [-3]
        for value, what in ((2.5, "2.5 is not a whole number"), (math.nan, "nan is not"), (2.0**31, "32 bits")):
            with pytest.raises(FmuError, match=what):
                slave.exchange(np.array([value]), 0.0)


def test_reset_begins_anew(fmu: Fmu) -> None:
    slave = fmu.instantiate("cs")
    slave.setup(outputs=["y"])
    first = slave.exchange(None, 0.0, 0.1)
    slave.terminate()
    slave.reset()
    slave.setup(outputs=["y"])
    assert np.array_equal(slave.exchange(None, 0.0, 0.1), first)


def test_several_instances_do_not_meet(fmu: Fmu) -> None:
    slaves = [fmu.instantiate("cs", f"plant {k}") for k in range(3)]
    for k, slave in enumerate(slaves):
        slave.setup(parameters={"stiffness": 10.0 * k}, outputs=["y"])
    found = [slave.exchange(None, 0.0, 0.1)[0] for slave in slaves]
    assert found[0] > found[1] > found[2]


def test_what_cannot_be_set_up(plants: dict[str, Path]) -> None:
    with open_fmu(plants["2.0"]) as fmu:
        slave = fmu.instantiate("cs")
        cases = [
            ({"inputs": ["uu"]}, "plant2.fmu/modelDescription.xml: error: plant: no input 'uu'"),
            ({"inputs": ["y"]}, "is of causality output, not an input"),
            ({"inputs": ["u", "u"]}, "u: is an input twice"),
            ({"outputs": ["label"]}, "label: is of type String: only numbers can be exchanged"),
            ({"parameters": {"stiffness": "soft"}}, "stiffness: 'soft' is not a value of type Float64"),
            ({"parameters": {"fault": 1.5, "gian": 1}}, "fault: 1.5 is not a value of type Int32"),
            ({"parameters": {"time": 1.0}}, "time: is of causality independent: it cannot be set"),
            ({"parameters": {"gain": math.nan}}, "gain: nan is not a value of type Float64"),
        ]
        for arguments, what in cases:
            with pytest.raises(RotorsimError) as caught:
                slave.setup(**arguments)  # type: ignore[arg-type]
            assert what in str(caught.value)
        with pytest.raises(FmuError, match=r"fmi2Set of y returned fmi2Error\n  it said: Error: reference 0, 6 \(\?\)"):
            slave.setup(parameters={"stiffness": 1.0, "y": 2.0})


def test_phases(plants: dict[str, Path]) -> None:
    with open_fmu(plants["2.0"], in_process=True) as fmu:
        slave = fmu.instantiate("cs")
        with pytest.raises(FmuError, match="the FMU is not set up"):
            slave.exchange(None, 0.0, 0.1)
        slave.setup()
        with pytest.raises(FmuError, match="the instance is set up already"):
            slave.setup()
        slave.free()
        slave.free()
        with pytest.raises(FmuError, match="the instance is freed"):
            slave.get(["x"])
        with pytest.raises(FmuError, match="the instance is freed"):
            slave.exchange(None, 0.0, 0.1)
