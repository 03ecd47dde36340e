"""Critical speed map, mode shapes and unbalance response: closed forms, and numbers that ROSS 2.3.0 gave."""

from __future__ import annotations

import numpy as np
import pytest

from rotorsim import RotorsimError, load
from rotorsim.linear.modes.collocation import collocation
from rotorsim.linear.modes.critical_speed_map import critical_speed_map
from rotorsim.linear.modes.free_rotor import free_rotor
from rotorsim.linear.modes.unbalance_response import unbalance_response
from tests.acceptance.machines import jeffcott, stepped, stiff_rotor, uniform

# ROSS 2.3.0, matrices M, K, G of its rotor (Euler-Bernoulli, rotary inertia, gyroscopic), scipy.linalg.eig(K, M - i G)
ROSS_CRITICAL = {
    1e5: (174.38401833863279, 315.2233543682469),
    1e6: (447.70540564271687, 933.9758982660354),
    1e8: (693.6476951443339, 2005.2209613493064),
}
# the same, k = 1e6 N/m, d = 200 N s/m, run_unbalance_response(3, 1e-5 kg m, 0): x at nodes 1 and 7, 100 and 400 rad/s
ROSS_RESPONSE = {
    (2, 0): 7.831410911154245e-08 - 1.6073463867002757e-09j,
    (2, 1): 4.4316470460051794e-06 - 1.1369530825712203e-06j,
    (8, 0): 2.7060761933423326e-08 - 5.699420595955043e-10j,
    (8, 1): 3.1625646570293616e-06 - 9.50761157244177e-07j,
}


def test_the_critical_speeds_are_those_of_ross() -> None:
    found = critical_speed_map(load(stepped(1e6)), stiffness=list(ROSS_CRITICAL))
    assert found.speeds[:, :2] == pytest.approx(np.array(list(ROSS_CRITICAL.values())), rel=1e-8)


def test_a_disc_on_a_spring() -> None:
    found = critical_speed_map(load(jeffcott(4e5, 100.0)), stiffness=[1e3, 1e5, 1e7])
    assert found.speeds[:, 0] == pytest.approx(np.sqrt((1e6 + found.stiffness) / 2.0), rel=1e-12)
    assert found.speeds.shape == (3, 1)


@pytest.mark.parametrize(("polar", "conical"), [(0.01, True), (0.05, False)])
def test_a_rigid_rotor_on_two_springs(polar: float, conical: bool) -> None:
    """m W^2 = 2 k; (I_d - I_p) W^2 = 2 k a^2, which I_p > I_d never meets in forward whirl; the shaft bends by 1e-5."""
    k = np.array([1e4, 1e5])
    found = critical_speed_map(load(stiff_rotor(polar, 0.02, 1e6)), stiffness=k, highest=1e4)
    shaft = 785 * np.pi / 4 * 0.05**2 * 0.4
    assert found.speeds[:, 0] == pytest.approx(np.sqrt(2 * k / (4.0 + shaft)), rel=2e-5)
    if conical:
        tilting = 0.02 + shaft * 0.4**2 / 12 - polar
        assert found.speeds[:, 1] == pytest.approx(np.sqrt(2 * k * 0.2**2 / tilting), rel=2e-5)
    else:
        assert found.speeds.shape[1] == 1


@pytest.mark.slow
def test_damping_changes_nothing() -> None:
    with_damping = critical_speed_map(load(stepped(1e6, damping=500.0)), stiffness=[1e6])
    assert with_damping.speeds == pytest.approx(
        critical_speed_map(load(stepped(1e6)), stiffness=[1e6]).speeds, rel=1e-9
    )
    rotor = stepped(1e6)
    rotor["blocks"]["rotor"]["parameters"] |= {"mass_damping": "5 1/s", "stiffness_damping": "1e-5 s"}
    assert critical_speed_map(load(rotor), stiffness=[1e6]).speeds == pytest.approx(with_damping.speeds, rel=1e-7)


@pytest.mark.slow
def test_many_elements_are_projected_on_few_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    fine = load(uniform(40, 9, 9))
    k = [1e4, 1e6, 1e9]
    projected = critical_speed_map(fine, stiffness=k, count=4)
    monkeypatch.setattr("rotorsim.linear.modes.critical_speed_map.MOST_DOF", 10**6)
    whole = critical_speed_map(fine, stiffness=k, count=4)
    assert len(free_rotor(fine).S) == 164
    assert projected.speeds == pytest.approx(whole.speeds, rel=1e-5)


def test_where_the_bearings_stiffness_meets_the_map() -> None:
    found = critical_speed_map(load(jeffcott(4e5, 100.0)))
    assert [name for name, *_ in found.crossings] == ["amb"]
    assert found.crossings[0][1:] == pytest.approx((4e5, np.sqrt(1.4e6 / 2)), rel=1e-9)
    hz, stiffness = found.bearings["amb"]
    assert stiffness == pytest.approx(4e5 + 100j * 2 * np.pi * hz, rel=1e-9)


def test_a_casing_on_feet_moves_along_with_the_rotor_and_is_not_part_of_the_bearing() -> None:
    """Two masses: critical speeds of [k + K, -k; -k, k + K_feet]; the stiffness of the bearing is its own."""
    machine = jeffcott(4e5, 100.0)
    machine["blocks"] |= {
        "casing": {"type": "casing", "parameters": {"mass": 10.0, "stiffness": [[2e6, 2e6]], "damping": [[0.0, 0.0]]}},
        "relative": {"type": "sum", "parameters": {"signs": "+-"}},
        "relative_rate": {"type": "sum", "parameters": {"signs": "+-"}},
        "back": {"type": "gain", "parameters": {"gain": -1.0}},
    }
    moved = {"rotor.displacement": "relative.output", "rotor.velocity": "relative_rate.output"}
    machine["wires"] = [[moved.get(one, one), other] for one, other in machine["wires"]] + [
        ["rotor.displacement", "relative.input1"],
        ["casing.displacement[1]", "relative.input2"],
        ["rotor.velocity", "relative_rate.input1"],
        ["casing.velocity[1]", "relative_rate.input2"],
        ["amb.force", "back.input"],
        ["back.output", "casing.force[1]"],
    ]
    k = 4e5
    found = critical_speed_map(load(machine), stiffness=[1e5, k, 2e6])
    truth = np.sqrt(np.linalg.eigvals(np.array([[(1e6 + k) / 2, -k / 2], [-k / 10, (k + 2e6) / 10]])))
    assert found.speeds[1] == pytest.approx(np.sort(truth), rel=1e-9)
    hz, stiffness = found.bearings["amb"]
    assert stiffness == pytest.approx(4e5 + 100j * 2 * np.pi * hz, rel=1e-9)
    wide = critical_speed_map(load(machine))
    assert sorted(speed for *_, speed in wide.crossings) == pytest.approx(np.sort(truth), rel=1e-9)


@pytest.mark.parametrize("stiffness", [[], [0.0], [2.0, 1.0], [float("nan")]])
def test_stiffnesses_that_cannot_be(stiffness: list[float]) -> None:
    with pytest.raises(RotorsimError) as caught:
        critical_speed_map(load("jeffcott"), stiffness=stiffness)
    assert str(caught.value) == "error: stiffness: stiffnesses must be positive and ascending [N/m]"


def test_no_bearing_no_map() -> None:
    with pytest.raises(RotorsimError) as caught:
        critical_speed_map(load("emps"))
    assert str(caught.value) == (
        "error: emps: no bearing: no block of the category 'bearing' has its force wired\n\n"
        "hint: `rotorsim blocks` lists them: amb, support, ..."
    )


def _bending(number: int, z: np.ndarray) -> tuple[float, np.ndarray]:
    """Return beta L and the shape of a free-free beam of 1 m, z from its end, one at the ends: Blevins, table 8-1."""
    root = (4.73004074, 7.85320462, 10.9956078)[number - 1]
    sigma = (0.982502215, 1.000777312, 0.999966450)[number - 1]
    shape = np.cosh(root * z) + np.cos(root * z) - sigma * (np.sinh(root * z) + np.sin(root * z))
    return root, shape / 2


@pytest.mark.slow
@pytest.mark.parametrize(("magnet", "probe", "told"), [(9, 9, "in phase"), (9, 11, "opposite phase"), (9, 10, "node")])
def test_a_probe_beyond_a_node_of_the_first_mode(magnet: int, probe: int, told: str) -> None:
    """Nodes of the first mode are at 0.224 and 0.776 of the shaft; the mesh is of 1/40 m."""
    found = collocation(load(uniform(40, magnet, probe)), highest=600.0)
    z = np.linspace(0, 1, 41)
    for shape in found.shapes:
        root, truth = _bending(shape.number, z)
        area, second = np.pi / 4 * 0.02**2, np.pi / 64 * 0.02**4
        frequency = root**2 * np.sqrt(2.1e11 * second / (7850 * area)) / (2 * np.pi)
        assert shape.frequency == pytest.approx(frequency, rel=1e-4)
        assert np.abs(shape.shape) == pytest.approx(np.abs(truth), abs=2e-4)
    first = found.pairs[0]
    truth = _bending(1, z)[1]
    assert (first.controller, first.bearing, first.mode) == ("controller", "amb", 1)
    assert first.product == pytest.approx(truth[probe - 1] * truth[magnet - 1], abs=2e-4)
    assert first.verdict == told


@pytest.mark.slow
def test_slopes_are_those_of_the_shape() -> None:
    shape = collocation(load(uniform(40, 9, 9)), highest=300.0).shapes[0]
    assert np.gradient(shape.shape, 1 / 40)[1:-1] == pytest.approx(shape.slope[1:-1], abs=0.02)


def test_the_unbalance_response_is_that_of_ross() -> None:
    signals = ["rotor.displacement[2]", "rotor.displacement[8]"]
    found = unbalance_response(load(stepped(1e6, 200.0)), ["rotor.force[4]"], signals, speeds=[100.0, 400.0])
    motion = found.to([1e-5])
    for (node, k), truth in ROSS_RESPONSE.items():
        assert motion[k, [2, 8].index(node), 0] == pytest.approx(truth, rel=1e-8)
        assert motion[k, [2, 8].index(node), 1] == pytest.approx(-1j * truth, rel=1e-8)


def test_a_disc_under_pd_control() -> None:
    speeds = np.array([200.0, 800.0, 1500.0])
    found = unbalance_response(load(jeffcott(4e5, 150.0)), ["rotor.force"], ["rotor.displacement"], speeds=speeds)
    truth = 3e-5 * speeds**2 / np.abs(1.4e6 - 2 * speeds**2 + 150j * speeds)
    assert found.major_axis([3e-5])[:, 0] == pytest.approx(truth, rel=1e-12)


@pytest.mark.parametrize(
    ("plane", "text"),
    [
        (
            "rotor.force[9]",
            "error: rotor.force[9]: no plane of unbalance: a force [N] with two axes is one; 'rotor.force' has shape "
            "2, in N\n\nhint: for example rotor.force",
        ),
        ("rotor.forces", "error: rotor.forces: no such input port\n\nhint: did you mean 'force'?"),
        ("rotr.force", "error: rotr: no such block\n\nhint: did you mean 'rotor'?"),
        (
            "controller.displacement",
            "error: controller.displacement: no plane of unbalance: a force [N] with two axes is one; "
            "'controller.displacement' has shape 2, in m\n\nhint: for example controller.displacement",
        ),
    ],
)
def test_planes_that_are_none(plane: str, text: str) -> None:
    with pytest.raises(RotorsimError) as caught:
        unbalance_response(load("jeffcott"), [plane], ["rotor.displacement"], speeds=[100.0])
    assert str(caught.value) == text
