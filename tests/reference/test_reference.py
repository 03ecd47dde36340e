"""The independent programs agree with published numbers and with one another."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.reference.excitation import RPM, harmonics, participation, switching
from tests.reference.jeffcott import Jeffcott
from tests.reference.published import FE_RIGID_AT_3000_RPM, FE_RIGID_AT_REST, TABLE_2_2, as_printed
from tests.reference.rotor import Rotor, fe_flexible, fe_rigid, offset_disc


def test_table_2_2_by_frequency_domain_and_transient() -> None:
    time = np.arange(40_000, 50_000) * 1e-4
    model = Jeffcott()
    for signal, column in zip(model.exact(time), (0, 2), strict=True):
        found = harmonics(time, signal, model.speed, list(TABLE_2_2))
        for order, numbers in TABLE_2_2.items():
            assert abs(found[order]) == pytest.approx(numbers[column], rel=2e-3), order
            turn = np.exp(-1j * math.radians(numbers[column + 1]))
            assert abs(math.degrees(np.angle(found[order] * turn))) <= 0.1, order


@pytest.mark.slow
def test_time_integration_equals_exact_solution() -> None:
    time = np.linspace(0.0, 0.3, 301)
    model = Jeffcott()
    y = model.solve(time)
    displacement, current = model.exact(time)
    np.testing.assert_allclose(y[:, 2] + 1j * y[:, 3], displacement, atol=1e-9 * abs(displacement).max(), rtol=0)
    np.testing.assert_allclose(model.current(y), current, atol=1e-9 * abs(current).max(), rtol=0)


def test_settled_motion_has_no_mean_displacement() -> None:
    displacement, current = Jeffcott().settled()
    assert abs(displacement[0]) < 1e-20
    assert current[0] == pytest.approx(0.25 * 3e5 * 2.6e-5 / 42.1, rel=1e-12)  # all of p_0 is in the current


def test_participation_factors_are_those_of_the_thesis() -> None:
    p = participation()
    printed = {0: 0.25, 1: 0.319, 2: 0.25, -1: 0.106, 3: 0.106, -3: -0.021, 5: -0.021, -5: 0.009, 7: 0.009}
    for order, value in printed.items():
        assert p[order] == pytest.approx(value, abs=1e-3), order  # one unit of the last printed digit
    theta = 0.7
    force = sum(value * np.exp(1j * order * theta) for order, value in p.items())
    assert force == pytest.approx(switching(theta) * (1 + np.exp(2j * theta)) / 2, rel=1e-12)


def test_natural_frequencies_of_the_pinned_beam() -> None:
    undamped = fe_rigid(a0=0.0, a1=0.0)
    assert as_printed(undamped.at_speed(0.0).frequencies()[::2], FE_RIGID_AT_REST)
    assert as_printed(undamped.at_speed(3000 * RPM).frequencies(), FE_RIGID_AT_3000_RPM)


def test_forward_whirl_rises_with_speed() -> None:
    rotor = fe_rigid(a0=0.0, a1=0.0).at_speed(3000 * RPM)
    whirl = rotor.undamped_whirl()
    forward, backward = np.sort(whirl[whirl > 0]), np.sort(-whirl[whirl < 0])
    assert as_printed(forward, FE_RIGID_AT_3000_RPM[1::2])
    assert as_printed(backward, FE_RIGID_AT_3000_RPM[0::2])


def test_simply_supported_beam_without_disc_against_closed_form() -> None:
    """f_n = (n pi / L)^2 sqrt(E I / rho A) / 2 pi; the error of consistent-mass elements falls as h^4."""
    errors = []
    for elements in (10, 20):
        rotor = _bare_beam(elements)
        found = rotor.frequencies()[0]
        d, length = 0.016, 0.5
        exact = (math.pi / length) ** 2 * math.sqrt(2.1e11 * d**2 / 16 / 7850) / (2 * math.pi)
        errors.append(found / exact - 1)
    assert errors[1] < 1e-6
    assert math.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)


def _bare_beam(elements: int) -> Rotor:
    from tests.reference.rotor import beam

    mass, stiffness = beam(elements)
    keep = [d for d in range(len(mass)) if d not in (0, len(mass) - 2)]
    part = np.ix_(keep, keep)
    zero = np.zeros_like(mass[part])
    return Rotor(mass[part], zero, zero, stiffness[part], 1, 1, 0.0, 0.0, (), speed=0.0)


@pytest.mark.parametrize("model", [offset_disc(), fe_rigid()], ids=["offset_disc", "fe_rigid"])
def test_rotor_time_integration_equals_exact_solution(model: Rotor) -> None:
    time = np.linspace(0.0, 0.02, 21)
    y, expected = model.solve(time), model.exact(time)
    dofs = model.translations
    scale = np.abs(expected[:, 2:]).max()
    for dof in dofs:
        found = model.displacement(y, dof)
        np.testing.assert_allclose(found, model.displacement(expected, dof), atol=1e-8 * scale, rtol=0)


def test_offset_disc_without_coupling_is_the_jeffcott_rotor() -> None:
    decoupled = offset_disc(
        stiffness=np.diag([7.6e5, 2350.0]),
        damping=np.diag([76.0, 6.0]),
        speed=1500 * RPM,  # type: ignore[arg-type]
    )
    displacement, current = Jeffcott().settled()
    found, found_current = decoupled.settled(0), decoupled.settled_current()
    for order, value in displacement.items():
        assert found[order] == pytest.approx(value, rel=1e-9, abs=1e-18)
        assert found_current[order] == pytest.approx(current[order], rel=1e-9, abs=1e-12)


def test_anisotropic_supports_couple_orders_i_and_minus_i() -> None:
    """A crack-free rotor on anisotropic supports answers forward unbalance with backward motion too."""
    rotor = fe_flexible(crack_stiffness=0.0)
    harmonic = rotor.settled(6)
    assert abs(harmonic[-1]) > 1e-4 * abs(harmonic[1])
    alike = tuple((dof, kx, kx, cx, cx) for dof, kx, _, cx, _ in rotor.supports)
    isotropic = fe_flexible(crack_stiffness=0.0, supports=alike)  # type: ignore[arg-type]
    harmonic = isotropic.settled(6)
    assert abs(harmonic[-1]) < 1e-9 * abs(harmonic[1])
