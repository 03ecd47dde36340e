"""Settled periodic motion against closed forms, the thesis, and the settled time solution."""

import math
import re

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rotorsim
from rotorsim.errors import RotorsimError
from rotorsim.settled.periodic import _change, periodic
from tests.reference.handmade import handmade, jeffcott
from tests.reference.jeffcott import Jeffcott
from tests.reference.settle import settled_by_shooting

RPM = math.pi / 30

# computed with two independent programs; thesis Table 2-2 agrees to its printed digits except at +-5
SETTLED_25_HZ = {
    1: (3.178e-6, 7.97, 3.880e-2, 10.15),
    2: (2.004e-6, -3.74, 2.452e-2, 0.67),
    3: (1.133e-6, -7.49, 1.391e-2, -0.88),
    5: (9.640e-7, 67.64, 1.198e-2, 78.57),
    7: (5.590e-8, -169.83, 7.058e-4, -154.88),
    -1: (7.393e-7, 1.64, 9.025e-3, -0.61),
    -3: (2.266e-7, -172.56, 2.783e-3, -179.05),
    -5: (4.133e-7, 112.35, 5.132e-3, 101.44),
}


def test_jeffcott_harmonics_at_25_hz_are_those_of_the_thesis():
    found = periodic(jeffcott())
    assert found.status == ("settled",)
    assert found.stable == (True,)
    assert found.units["rotor.displacement"] == "m"
    for order, (size, phase, current, lag) in SETTLED_25_HZ.items():
        r = found.harmonic("rotor.displacement", order)[0]
        i = found.harmonic("controller.current", order)[0]
        assert abs(r) == pytest.approx(size, rel=2e-3)
        assert math.degrees(np.angle(r)) == pytest.approx(phase, abs=0.1)
        assert abs(i) == pytest.approx(current, rel=2e-3)
        assert math.degrees(np.angle(i)) == pytest.approx(lag, abs=0.1)


@settings(deadline=None, max_examples=25)
@given(speed=st.floats(5.0, 3000.0))
def test_every_harmonic_is_the_closed_form_one_at_any_speed(speed):
    found = periodic(_MODEL, speeds=[speed])
    displacement, current = Jeffcott(speed=speed).settled()
    for signal, expected in (("rotor.displacement", displacement), ("controller.current", current)):
        largest = max(abs(value) for value in expected.values())
        for order in range(int(found.orders[0]), int(found.orders[-1]) + 1):
            value = found.harmonic(signal, order)[0]
            assert abs(value - expected.get(order, 0)) <= 1e-11 * largest


_MODEL = jeffcott()


def test_channels_are_real_signals_and_make_up_the_two_axis_one():
    found = periodic(jeffcott())
    x, y = (found.harmonics[f"rotor.displacement[{k}]"] for k in (1, 2))
    np.testing.assert_allclose(found.harmonics["rotor.displacement"], x + 1j * y, rtol=0, atol=1e-20)
    np.testing.assert_allclose(x, x[:, ::-1].conj(), rtol=0, atol=1e-20)
    times, motion = found.time_history("rotor.displacement[1]", 64)
    _, both = found.time_history("rotor.displacement", 64)
    assert times.shape == motion.shape == (1, 64)
    assert motion.dtype == float
    np.testing.assert_allclose(both.real, motion, rtol=0, atol=1e-18)


@pytest.mark.slow
def test_settled_motion_is_that_of_the_time_simulation():
    model = jeffcott()
    expected = settled_by_shooting(model, 157.0)
    found = periodic(model, speeds=[157.0], signals=["rotor.displacement", "controller.current"])
    H = int(found.orders[-1])
    for k in (1, 2):
        got = found.harmonics[f"rotor.displacement[{k}]"][0, H:]
        np.testing.assert_allclose(got, expected[: H + 1, k - 1], rtol=0, atol=1e-9 * np.abs(expected[:, k - 1]).max())


@pytest.mark.parametrize(
    ("variant", "speed"),
    [
        pytest.param({"nonlinear_amb": True}, 157.0, marks=pytest.mark.slow),
        pytest.param({"nonlinear_amb": True, "unbalance__eccentricity": 60e-6}, 500.0, marks=pytest.mark.slow),
        pytest.param({"opening": "none", "breathing": True, "gravity": 19.6}, 157.0, marks=pytest.mark.slow),
        pytest.param(
            {"opening": "none", "breathing": True, "nonlinear_amb": True, "gravity": 19.6},
            250.0,
            marks=pytest.mark.slow,
        ),
    ],
)
def test_nonlinear_motion_is_that_of_the_settled_time_simulation(variant, speed):
    model = jeffcott(**variant)
    expected = settled_by_shooting(model, speed, 256)
    found = periodic(model, speeds=[speed])
    assert found.status == ("settled",)
    H = int(found.orders[-1])
    for k in (1, 2):
        got = found.harmonics[f"rotor.displacement[{k}]"][0, H:]
        size = np.abs(expected[:, k - 1]).max()
        np.testing.assert_allclose(got, expected[: H + 1, k - 1], rtol=0, atol=1e-7 * size)


def test_a_crack_that_switches_is_integrated_between_its_jumps():
    model = jeffcott(opening="exact")
    found = periodic(model, speeds=[157.0], harmonics=60)
    s = {0: 0.5} | {k: math.sin(k * math.pi / 2) / (math.pi * k) for k in range(-70, 71) if k}
    k_total, c = 7.6e5 - 105210 + 42.1 * 12200, 76 + 42.1 * 3
    for order in range(-60, 61):
        w = 1j * order * 157.0
        force = 0.5 * (s[order] + s[order - 2]) * 3e5 * 26e-6
        force += 2 * 24e-6 * 157.0**2 * np.exp(1j * math.radians(30)) if order == 1 else 0
        expected = force / (2 * w**2 + c * w + k_total + 42.1 * 2000 / w) if order else 0.0
        assert abs(found.harmonic("rotor.displacement", order)[0] - expected) < 1e-13 * 3e-6 / 1e-2
    assert 0 < found.truncation[0] < 1e-3


def test_the_number_of_harmonics_can_be_fixed():
    found = periodic(jeffcott(), harmonics=4)
    np.testing.assert_array_equal(found.orders, np.arange(-4, 5))
    full = periodic(jeffcott())
    np.testing.assert_allclose(
        found.harmonic("rotor.displacement", 3), full.harmonic("rotor.displacement", 3), rtol=1e-12
    )
    assert found.truncation[0] > 0.01
    assert full.truncation[0] == 0.0
    more = periodic(jeffcott(), harmonics=40)
    assert more.orders[-1] <= 40
    assert abs(more.harmonic("rotor.displacement", 11) / full.harmonic("rotor.displacement", 11) - 1) < 1e-9


def test_many_speeds_equal_one_by_one():
    speeds = np.array([400.0, 90.0, 250.0])
    model = jeffcott()
    together = periodic(model, speeds=speeds)
    for j, speed in enumerate(speeds):
        alone = periodic(model, speeds=[speed])
        np.testing.assert_allclose(
            together.harmonic("rotor.displacement", 1)[j], alone.harmonic("rotor.displacement", 1)[0], rtol=1e-12
        )


def test_an_integral_that_nothing_uses_drifts_and_the_rest_is_solved():
    found = periodic(jeffcott(with_amb=False))
    assert found.drifting == ("controller.integral[1]", "controller.integral[2]")
    assert found.status == ("settled; drifts: controller.integral[1], controller.integral[2]",)
    mean = 0.5 * (0.5 + 0.0) * 3e5 * 26e-6 / 7.6e5
    assert found.harmonic("rotor.displacement", 0)[0] == pytest.approx(mean, rel=1e-12)
    assert np.isnan(found.harmonic("controller.current", 0)[0])
    r = found.harmonic("rotor.displacement", 1)[0]
    w = 1j * found.speeds[0]
    assert found.harmonic("controller.current", 1)[0] == pytest.approx(r * (12200 + 3 * w + 2000 / w), rel=1e-12)


def test_an_unstable_loop_is_said_to_be_unstable():
    found = periodic(jeffcott(controller__KD=-10.0))
    assert found.stable == (False,)
    assert found.status == ("unstable: this motion is never reached",)
    hard = periodic(jeffcott(nonlinear_amb=True, controller__KD=-10.0))
    assert hard.stable == (False,)


def test_a_motion_that_does_not_exist_is_said_with_how_far_the_search_got():
    """q'' + 0.2 q' + 2.5 q = 3 + 0.3 / (1 - q)^2 + cos t: even at rest the pull is more than the spring holds."""

    def build(t, x, p, v):
        q, w = x["disc.q"], x["disc.v"]
        force = 3.0 + ca.cos(p["clock.speed"] * t) - 0.2 * w - 2.5 * q + 0.3 / (1.0 - q) ** 2
        return {"xdot": {"disc.q": w, "disc.v": force}, "signals": {"disc.y": q}}

    found = periodic(handmade({"disc.q": 1, "disc.v": 1}, {"speed": 1.0}, build, record=("disc.y",)), speeds=[1.0])
    [status] = found.status
    number = r"\d(?:\.\d+)?(?:e[+-]\d+)?\d*"
    assert re.sub(number, "N", status) == (
        "failed: no periodic motion found at N rad/s; Newton's method stalls in a minimum of the residual; N steps at "
        "N harmonics took the residual from N % of the motion to N % of the motion, the most in block 'disc' "
        "(disc.q[N]): a motion may exist all the same; try speeds nearer to one that settled, or `rotorsim run`, which "
        "needs no start"
    )


def test_a_sweep_with_a_motion_that_does_not_exist_keeps_the_other_speeds():
    def build(t, x, p, v):
        q, w = x["disc.q"], x["disc.v"]
        pull = 0.3 / (1.0 - q) ** 2  # an electrostatic spring that snaps when pushed too far
        force = p["clock.speed"] ** 2 * 0.08 * ca.cos(p["clock.speed"] * t)
        return {"xdot": {"disc.q": w, "disc.v": force - 0.02 * w - 2.5 * q + pull}, "signals": {"disc.y": q}}

    model = handmade({"disc.q": 1, "disc.v": 1}, {"speed": 0.2}, build, record=("disc.y",))
    found = periodic(model, speeds=[0.2, 1.25, 6.0])
    assert found.status[0] == "settled"
    assert found.status[2] == "settled"
    assert found.status[1] != "settled"
    if found.status[1].startswith("failed"):
        assert "block 'disc'" in found.status[1]
        assert np.isnan(found.harmonics["disc.y"][1]).all()
    assert np.isfinite(found.harmonics["disc.y"][[0, 2]]).all()


def test_harmonic_balance_tells_what_is_done():
    for stability in (True, False):
        shares = []
        speeds = [100.0, 130.0, 160.0]
        periodic(jeffcott(nonlinear_amb=True), speeds=speeds, stability=stability, progress=shares.append)
        assert shares == pytest.approx([k / 6 for k in range(1, 7)] if stability else [k / 3 for k in range(1, 4)])


@pytest.mark.slow
def test_duffing_oscillator_has_the_amplitude_of_its_exact_harmonic_balance():
    """x'' + d x' + x + b x^3 = F cos: the first-harmonic amplitude solves the cubic of one-term balance nearly."""

    def build(t, x, p, v):
        q, w = x["m.q"], x["m.v"]
        force = 0.1 * ca.cos(p["clock.speed"] * t)
        return {"xdot": {"m.q": w, "m.v": force - 0.1 * w - q - 0.1 * q**3}, "signals": {"m.y": q}}

    model = handmade({"m.q": 1, "m.v": 1}, {"speed": 0.5}, build, record=("m.y",))
    found = periodic(model, speeds=[0.5], harmonics=1)
    a = 2 * abs(found.harmonic("m.y", 1)[0])
    assert (1 - 0.25 + 0.075 * a**2) ** 2 * a**2 + (0.05 * a) ** 2 == pytest.approx(0.01, rel=1e-9)
    expected = settled_by_shooting(model, 0.5)
    full = periodic(model, speeds=[0.5])
    assert full.harmonic("m.y", 3)[0] == pytest.approx(expected[3, 0], rel=1e-6)
    assert full.truncation_error == (0.0,)
    off = abs(found.harmonic("m.y", 1) / full.harmonic("m.y", 1) - 1)
    assert found.truncation_error == pytest.approx(off, rel=0.05)  # orders to 3 have nearly all of it


def test_no_motion_has_no_truncation_error_and_none_with_more_orders_an_infinite_one():
    motion = np.array([[[0.0], [2.0]], [[0.0], [np.nan]], [[0.0], [1.0]]]) + 0j
    motion[1] = np.nan
    finer = np.array([[[0.0], [2.5], [0.1], [0.0]]] * 3) + 0j
    finer[1:] = np.nan
    np.testing.assert_array_equal(_change(motion, finer), [0.2, 0.0, np.inf])


@pytest.mark.slow
def test_parametric_excitation_is_solved_and_its_instability_seen():
    """Mathieu: x'' + 0.02 x' + (1 + e cos W t) x = 1 is unstable at W = 2 for e > 0.04."""

    def build(t, x, p, v):
        q, w = x["m.q"], x["m.v"]
        spring = 1 + p["m.e"] * ca.cos(p["clock.speed"] * t)
        return {"xdot": {"m.q": w, "m.v": 1 - 0.02 * w - spring * q}, "signals": {"m.y": q}}

    model = handmade({"m.q": 1, "m.v": 1}, {"speed": 2.0, "m.e": 0.03}, build, record=("m.y",))
    calm = periodic(model)
    assert calm.stable == (True,)
    assert periodic(model, parameters={"m.e": 0.05}).stable == (False,)
    assert periodic(model, parameters={"m.e": 0.5}, speeds=[3.1]).stable == (True,)
    expected = settled_by_shooting(model, 2.0)
    H = int(calm.orders[-1])
    np.testing.assert_allclose(calm.harmonics["m.y"][0, H:], expected[: H + 1, 0], rtol=0, atol=1e-9)


def test_a_period_of_two_turns_is_found_with_subharmonics():
    def build(t, x, p, v):
        force = ca.cos(p["clock.speed"] * t / 2)
        return {"xdot": {"m.q": force - x["m.q"]}, "signals": {"m.y": x["m.q"]}}

    model = handmade({"m.q": 1}, {"speed": 4.0}, build, record=("m.y",))
    with pytest.raises(RotorsimError) as caught:
        periodic(model)
    assert str(caught.value) == (
        "error: m: the forcing at 4 rad/s is not the same one period later: the motion is not periodic\n\n"
        "hint: use a constant speed; for a longer period give its number of turns (subharmonic)"
    )
    found = periodic(model, subharmonic=2)
    assert found.harmonic("m.y", 0.5)[0] == pytest.approx(0.5 / (1 + 2j), rel=1e-12)
    times, motion = found.time_history("m.y", 50)
    assert times[0, -1] == pytest.approx(4 * math.pi / 4 * 49 / 50)
    np.testing.assert_allclose(motion[0], np.real(np.exp(2j * times[0]) / (1 + 2j)), rtol=0, atol=1e-14)


def test_high_orders_in_the_forcing_are_not_aliased():
    def build(t, x, p, v):
        force = ca.cos(30 * p["clock.speed"] * t)
        return {"xdot": {"m.q": force - x["m.q"]}, "signals": {"m.y": x["m.q"]}}

    model = handmade({"m.q": 1}, {"speed": 4.0}, build, record=("m.y",))
    found = periodic(model)
    assert found.orders[-1] == 30
    assert found.harmonic("m.y", 30)[0] == pytest.approx(0.5 / (1 + 120j), rel=1e-12)
    assert abs(found.harmonic("m.y", 2)[0]) < 1e-15


def test_signals_that_are_nonlinear_in_the_motion_are_evaluated_along_it():
    model = jeffcott(nonlinear_amb=True)
    found = periodic(model, signals=["amb.force"])
    r = periodic(model, signals=["rotor.displacement"])
    w = 1j * found.speeds[0]
    order = 2
    crack = 0.25 * 3e5 * 26e-6
    balance = (2 * (2 * w) ** 2 + 76 * 2 * w + 7.6e5) * r.harmonic("rotor.displacement", order)[0] - crack
    assert found.harmonic("amb.force", order)[0] == pytest.approx(balance, rel=1e-8)


def test_table_has_one_row_per_speed_signal_and_order():
    found = periodic(jeffcott(), signals=["rotor.displacement"], harmonics=2)
    rows = found.to_table()
    assert {row["order"] for row in rows} == {-2.0, -1.0, 0.0, 1.0, 2.0} - (
        {0.0} if abs(found.harmonic("rotor.displacement", 0)[0]) == 0 else set()
    )
    assert all(row["unit"] == "m" for row in rows)


def test_wrong_names_and_orders_are_refused():
    found = periodic(jeffcott())
    with pytest.raises(RotorsimError) as caught:
        found.harmonic("rotor.displacment", 1)
    assert "did you mean 'rotor.displacement'" in str(caught.value)
    with pytest.raises(RotorsimError, match="no harmonic of order 99; orders run from -11 to 11"):
        found.harmonic("rotor.displacement", 99)
    with pytest.raises(RotorsimError, match="no such signal"):
        periodic(jeffcott(), signals=["rotor.displacment"])
    with pytest.raises(RotorsimError, match=r"speeds must be finite and positive \[rad/s\]"):
        periodic(jeffcott(), speeds=[0.0])


@pytest.mark.slow
def test_forcing_that_jumps_acts_on_a_nonlinear_bearing_as_its_exact_series():
    """With a bearing that is nearly linear at this amplitude the two routes must agree order by order."""
    hard = periodic(jeffcott(opening="exact", nonlinear_amb=True), speeds=[157.0])
    expected = settled_by_shooting(jeffcott(opening="exact", nonlinear_amb=True), 157.0, 512)
    H = int(hard.orders[-1])
    got = hard.harmonics["rotor.displacement[1]"][0, H : H + 20]
    assert np.abs(got - expected[:20, 0]).max() < 1e-5 * np.abs(expected[:, 0]).max()


def test_orders_that_are_rounding_are_not_solved_for() -> None:
    """Unbalance drives 1X, gravity the mean: two systems of equations a speed, though 512 orders were sampled."""
    found = periodic(rotorsim.load("drawn_rotor"), speeds=["6000 rpm", "7000 rpm", "8000 rpm"])
    assert found.counters["solves"] == 6
    assert found.counters["samples"] == 1024
