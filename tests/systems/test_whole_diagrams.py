"""Whole diagrams against independent programs, exact solutions, and one analysis against another."""

from __future__ import annotations

import numpy as np
import pytest

from rotorsim.simulation.run import simulate
from tests.reference.jeffcott import Jeffcott
from tests.reference.rotor import Rotor
from tests.systems import figures
from tests.systems.references import fe_flexible, fe_rigid, offset_disc
from tests.systems.shipped import shipped


def test_elementary_blocks_give_the_same_signals() -> None:
    assert figures.elementary(stop=1.0) <= 1e-9


@pytest.mark.slow
def test_jeffcott_against_independent_integration() -> None:
    """RK4 at the diagram's step errs by 1e-6, so the step is refined until the equations are what is compared."""
    displacement, current = figures.independent(stop=0.5, step=2e-5)
    assert displacement <= 1e-8
    assert current <= 1e-8


def test_rk4_is_of_order_four() -> None:
    for order in figures.orders([2e-4, 1e-4, 5e-5, 2.5e-5], stop=0.5):
        assert order == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize("power", [1, 2, 3])
def test_rk4_integrates_a_cubic_exactly(power: int) -> None:
    assert figures.polynomial_error(power) <= 4e-16 * 8


def test_rk4_does_not_integrate_a_quartic_exactly() -> None:
    errors = [figures.polynomial_error(4, step) for step in (0.25, 0.125)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize(
    ("name", "reference", "node", "step"),
    [
        ("offset_disc", offset_disc, None, 2e-5),
        pytest.param("fe_rigid", fe_rigid, 3, 5e-6, marks=pytest.mark.slow),
        pytest.param("fe_flexible", fe_flexible, 4, 2e-6, marks=pytest.mark.slow),
    ],
)
def test_rotors_against_exact_solution(name: str, reference: object, node: int | None, step: float) -> None:
    """The start shakes every mode, so the step resolves the fastest one (2.7e5 rad/s in fe_flexible)."""
    rotor: Rotor = reference()  # type: ignore[operator]
    signal = "rotor.displacement" + (f"[{node}]" if node else "")
    model = shipped(name)
    result = simulate(
        model, stop=0.2, step=step, record_every=round(1e-4 / step), record=[signal, "controller.current"]
    )
    y = rotor.exact(result.time)
    dof = rotor.translations[0] if node is None else figures.dof_of(rotor, node)
    assert figures.relative(figures.as_complex(result[signal]), rotor.displacement(y, dof)) <= 1e-8
    assert figures.relative(figures.as_complex(result["controller.current"]), rotor.current(y)) <= 1e-8


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n.startswith("fe") else n for n in figures.SETTLED]
)
def test_periodic_equals_settled_simulation(name: str) -> None:
    """With a hundred times the integral gain, so that 3 s settle; benchmarks.evidence has the thesis' own gain."""
    signals, _, step = figures.SETTLED[name]
    found = figures.settled_difference(shipped(name), signals, 3.0, step, figures.QUICK_INTEGRAL)
    assert max(found.values()) <= 1e-6, found


@pytest.mark.slow
@pytest.mark.parametrize("name", list(figures.NONLINEAR))
def test_periodic_equals_settled_simulation_of_nonlinear_models(name: str) -> None:
    model = figures.nonlinear_model(name)
    found = figures.settled_difference(model, figures.JEFFCOTT_SIGNALS, 3.0, 1e-4, figures.QUICK_INTEGRAL)
    assert max(found.values()) <= 1e-4, found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "reference"),
    [
        ("nonlinear AMB", Jeffcott(bias_current=1.0, gap=42.1 / 105210)),
        ("breathing crack", Jeffcott(breathing_width=2e-6)),
    ],
)
def test_nonlinear_models_against_independent_integration(name: str, reference: Jeffcott) -> None:
    result = simulate(figures.nonlinear_model(name), stop=0.2, step=1e-5, record_every=10)
    y = reference.solve(result.time)
    displacement = figures.as_complex(result["rotor.displacement"])
    assert figures.relative(displacement, y[:, 2] + 1j * y[:, 3]) <= 1e-8
    assert figures.relative(figures.as_complex(result["controller.current"]), reference.current(y)) <= 1e-8


def test_a_small_error_would_be_seen() -> None:
    """The comparison has teeth: 0.1 % of one parameter is a thousand times the tolerance."""
    result = simulate(shipped("jeffcott"), stop=0.2, step=2e-5, record_every=5, parameters={"viscous_damping": 76.076})
    exact, _ = Jeffcott().exact(result.time)
    assert figures.relative(figures.as_complex(result["rotor.displacement"]), exact) > 1e-5
