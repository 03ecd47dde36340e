"""The law of every fault without memory against the catalogue's formula in complex numbers, written out here."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rotorsim.diagram.resolve.registry import find
from tests.blocks.evaluation import Prepared, prepare

SHAPES: dict[str, tuple[int, ...]] = {"theta": (), "speed": (), "acceleration": ()}
PAIRS = ("displacement", "velocity", "tilt", "tilt_velocity", "current")
SIZES = {"displacement": 3e-5, "velocity": 5e-3, "tilt": 1e-4, "tilt_velocity": 0.1, "current": 0.3, "theta": 9.0}


def c(value: np.ndarray) -> complex:
    return complex(*value)


def e(angle: float) -> complex:
    return complex(np.exp(1j * angle))


def plus(value: float) -> float:
    return value if value > 0 else 0.0


def rub(p: Any, u: Any) -> complex:
    q = u.displacement - (p.centre_x + 1j * p.centre_y)
    rho = abs(q)
    v_t = (np.conj(q) * u.velocity).imag / rho + p.radius * u.speed
    return -(1 + 1j * p.friction * np.sign(v_t)) * p.stiffness * plus(rho - p.gap) * q / rho


def runout(p: Any, u: Any, rate: bool) -> complex:
    total = u.velocity if rate else u.displacement
    for k in (1, 2, 3):
        for order, size, phase in ((k, f"amplitude{k}", f"phase{k}"), (-k, f"backward{k}", f"backward_phase{k}")):
            r = getattr(p, size) * e(getattr(p, phase))
            total += r * e(order * u.theta) * (1j * order * u.speed if rate else 1)
    return total


def cubic(p: Any, u: Any) -> complex:
    r = u.displacement + p.offset
    return -p.stiffness * (abs(r) ** 2 * r - p.offset**3)


def stop(p: Any, u: Any) -> complex:
    n = e(p.direction)
    return -p.stiffness * plus((np.conj(n) * u.displacement).real - p.gap) * n


# type, options -> output -> law of parameters p and inputs u, vectors as complex numbers
Law = Callable[[Any, Any], complex]
LAWS: list[tuple[str, dict[str, Any], dict[str, Law]]] = [
    ("residual_bow", {}, {"force": lambda p, u: p.stiffness * p.amplitude * e(p.phase) * e(u.theta)}),
    (
        "parallel_misalignment",
        {},
        {
            "force": lambda p, u: (
                p.amplitude1 * e(p.phase1) * e(u.theta)
                + p.amplitude2 * e(p.phase2) * e(2 * u.theta)
                + p.backward2 * e(p.backward_phase2) * e(-2 * u.theta)
                + p.amplitude0 * e(p.phase0)
            )
        },
    ),
    (
        "angular_misalignment",
        {},
        {"moment": lambda p, u: p.amplitude1 * e(p.phase1 + u.theta) + p.amplitude2 * e(p.phase2 + 2 * u.theta)},
    ),
    (
        "anisotropic_support",
        {},
        {
            "force": lambda p, u: (
                -p.stiffness_difference / 2 * np.conj(u.displacement) - p.damping_difference / 2 * np.conj(u.velocity)
            )
        },
    ),
    ("support_stiffness", {}, {"force": lambda p, u: -p.stiffness * u.displacement - p.damping * u.velocity}),
    ("magnetic_pull", {}, {"force": lambda p, u: p.stiffness * u.displacement}),
    (
        "asymmetric_shaft",
        {},
        {"force": lambda p, u: -p.asymmetry * e(2 * (u.theta + p.phase)) * np.conj(u.displacement + p.sag)},
    ),
    ("gyroscopic_error", {}, {"moment": lambda p, u: 1j * u.speed * p.inertia * u.tilt_velocity}),
    (
        "moment_unbalance",
        {},
        {
            "moment": lambda p, u: (
                (p.polar_inertia - p.diametral_inertia)
                * p.skew
                * (u.speed**2 - 1j * u.acceleration)
                * e(u.theta + p.phase)
            )
        },
    ),
    ("internal_damping", {}, {"force": lambda p, u: -p.damping * (u.velocity - 1j * u.speed * u.displacement)}),
    (
        "seal_cross_coupling",
        {},
        {
            "force": lambda p, u: (
                1j * p.cross_stiffness * u.displacement
                - p.direct_stiffness * u.displacement
                - p.direct_damping * u.velocity
            )
        },
    ),
    ("rub", {}, {"force": rub}),
    (
        "clearance",
        {"law": "radial"},
        {"force": lambda p, u: -p.stiffness * plus(abs(u.displacement) - p.gap) * u.displacement / abs(u.displacement)},
    ),
    ("clearance", {"law": "bilinear"}, {"force": stop}),
    ("cubic_stiffness", {}, {"force": cubic}),
    (
        "blade_pass",
        {"blades": 5},
        {
            "force": lambda p, u: (
                p.amplitude * e(5 * u.theta + p.phase) + p.backward * e(-5 * u.theta - p.backward_phase)
            )
        },
    ),
    (
        "amb_cross_coupling",
        {},
        {
            "effective_current": lambda p, u: (
                u.current + (p.real_coupling + 1j * p.imaginary_coupling) * np.conj(u.current)
            )
        },
    ),
    (
        "controller_gain_error",
        {},
        {
            "weighted_displacement": lambda p, u: (1 + p.displacement_error) * u.displacement,
            "weighted_velocity": lambda p, u: (1 + p.velocity_error) * u.velocity,
        },
    ),
    ("current_gain", {}, {"scaled_current": lambda p, u: (1 + p.gain_error) * u.current}),
    (
        "sensor_gain",
        {},
        {
            "sensed_displacement": lambda p, u: (1 + p.gain_error) * u.displacement,
            "sensed_velocity": lambda p, u: (1 + p.gain_error) * u.velocity,
        },
    ),
    (
        "sensor_gain_mismatch",
        {},
        {
            "sensed_displacement": lambda p, u: u.displacement + (p.mismatch + 1j * p.skew) * np.conj(u.displacement),
            "sensed_velocity": lambda p, u: u.velocity + (p.mismatch + 1j * p.skew) * np.conj(u.velocity),
        },
    ),
    (
        "sensor_rotation",
        {},
        {
            "sensed_displacement": lambda p, u: e(p.angle) * u.displacement,
            "sensed_velocity": lambda p, u: e(p.angle) * u.velocity,
        },
    ),
    (
        "sensor_offset",
        {},
        {
            "sensed_displacement": lambda p, u: u.displacement + p.offset_x + 1j * p.offset_y,
            "sensed_velocity": lambda p, u: u.velocity,
        },
    ),
    (
        "non_collocation",
        {},
        {
            "sensed_displacement": lambda p, u: u.displacement + p.distance * u.tilt,
            "sensed_velocity": lambda p, u: u.velocity + p.distance * u.tilt_velocity,
        },
    ),
    (
        "runout",
        {},
        {"sensed_displacement": lambda p, u: runout(p, u, False), "sensed_velocity": lambda p, u: runout(p, u, True)},
    ),
    (
        "quantisation",
        {},
        {
            "sensed_displacement": lambda p, u: p.interval * complex(*np.rint(np.array([u.x, u.y]) / p.interval)),
            "sensed_velocity": lambda p, u: u.velocity,
        },
    ),
    (
        "current_clipping",
        {"law": "limit"},
        {"limited": lambda p, u: complex(*np.clip([u.current.real, u.current.imag], -p.limit, p.limit))},
    ),
]


def drawn(
    type_name: str, options: dict[str, Any], rng: np.random.Generator, axes: int = 2
) -> tuple[Prepared, Any, Any]:
    """A block with random parameters about its defaults, and inputs; vectors as arrays."""
    cls = find(type_name)
    assert cls is not None
    parameters: dict[str, Any] = {}
    for name, declared in cls.parameters.items():
        size = abs(declared.default) or {"m": 2e-6, "N": 0.5, "rad": 1.0}.get(declared.unit, 0.05)
        value = rng.uniform(0.3, 1.5) * size
        if declared.unit == "rad" or (declared.low is None and declared.above is None):
            value *= rng.choice([-1, 1])
        if declared.unit == "rad" and "phase" in name:
            value = rng.uniform(-4, 4)
        parameters[name] = value
    pair = (2,) if axes == 2 else ()
    inputs = {name: SHAPES.get(name, pair) for name in cls.inputs}
    block = prepare(type_name, inputs, parameters, options)
    values: dict[str, Any] = {}
    for name, shape in inputs.items():
        values[name] = rng.normal(size=shape) * SIZES.get(name, 200.0)
    return block, SimpleNamespace(**parameters), values


def as_complex(values: dict[str, Any]) -> Any:
    """Inputs by attribute, vectors as complex numbers; x and y of the displacement as well."""
    found = {k: c(v) if np.shape(v) == (2,) else float(v) for k, v in values.items()}
    if "displacement" in values and np.shape(values["displacement"]) == (2,):
        found["x"], found["y"] = values["displacement"]
    return SimpleNamespace(**found)


@pytest.mark.parametrize(("name", "options", "laws"), LAWS, ids=[f"{n}{list(o.values())}" for n, o, _ in LAWS])
def test_the_law_is_that_of_the_catalogue(name: str, options: dict[str, Any], laws: dict[str, Law]) -> None:
    rng = np.random.default_rng(5)
    sizes = []
    for _ in range(60):
        block, p, values = drawn(name, options, rng)
        outputs = block.evaluate(values).outputs
        assert outputs.keys() == laws.keys()
        for port, law in laws.items():
            expected = law(p, as_complex(values))
            assert c(outputs[port]) == pytest.approx(expected, rel=1e-12, abs=1e-18), port
            sizes.append(abs(expected))
    assert np.count_nonzero(sizes) > 5


SCALAR: list[tuple[str, dict[str, Any], Callable[[Any, Any], float]]] = [
    ("support_stiffness", {}, lambda p, u: -p.stiffness * u.displacement - p.damping * u.velocity),
    ("magnetic_pull", {}, lambda p, u: p.stiffness * u.displacement),
    ("cubic_stiffness", {}, lambda p, u: -p.stiffness * ((u.displacement + p.offset) ** 3 - p.offset**3)),
    (
        "clearance",
        {"law": "radial"},
        lambda p, u: -p.stiffness * (plus(u.displacement - p.gap) - plus(-u.displacement - p.gap)),
    ),
    (
        "clearance",
        {"law": "bilinear"},
        lambda p, u: (
            -p.stiffness * np.sign(np.cos(p.direction)) * plus(np.sign(np.cos(p.direction)) * u.displacement - p.gap)
        ),
    ),
    ("coulomb_friction", {"law": "axes"}, lambda p, u: -p.friction * np.tanh(u.velocity / p.width) - p.offset),
    ("coulomb_friction", {"law": "resultant"}, lambda p, u: -p.friction * np.tanh(u.velocity / p.width) - p.offset),
]


@pytest.mark.parametrize(("name", "options", "law"), SCALAR, ids=[f"{n}{list(o.values())}" for n, o, _ in SCALAR])
def test_what_moves_in_a_line_has_the_same_law(name: str, options: dict[str, Any], law: Any) -> None:
    rng = np.random.default_rng(6)
    sizes = []
    for _ in range(30):
        block, p, values = drawn(name, options, rng, axes=1)
        expected = law(p, as_complex(values))
        force = block.evaluate(values).outputs["force"]
        assert force.shape == ()
        assert float(force) == pytest.approx(expected, rel=1e-12, abs=1e-18)
        sizes.append(abs(expected))
    assert np.count_nonzero(sizes) > 5


def test_friction_opposes_the_velocity_and_is_full_beyond_three_widths() -> None:
    values = {"friction": 0.7, "width": 1e-4, "offset": 0.0}
    resultant, axes = (
        prepare("coulomb_friction", {"velocity": (2,)}, values, {"law": law}) for law in ("resultant", "axes")
    )
    rng = np.random.default_rng(10)
    for size in (3e-4, 1e-2):
        v = size * c(rng.normal(size=2)) / 0.5
        found = c(resultant.evaluate({"velocity": [v.real, v.imag]}).outputs["force"])
        assert found == pytest.approx(-0.7 * v / abs(v) * np.tanh(abs(v) / 1e-4), rel=1e-12)
        found = c(axes.evaluate({"velocity": [v.real, v.imag]}).outputs["force"])
        assert found == pytest.approx(-0.7 * complex(np.tanh(v.real / 1e-4), np.tanh(v.imag / 1e-4)), rel=1e-12)
    assert 1 - np.tanh(3.0) < 0.005  # as its page says
    assert c(resultant.evaluate({"velocity": [0.0, 0.0]}).outputs["force"]) == 0


@pytest.mark.parametrize("driving", ["unipolar", "bipolar"])
def test_the_magnets_pull_with_the_square_of_the_current_over_the_gap(driving: str) -> None:
    """K [((i0 + i) / (g0 - x))^2 - ((i0 - i) / (g0 + x))^2] of the catalogue, with i towards the rotor's excursion."""
    k_i, k_s, i0 = 40.0, 1.1e5, 0.35
    g0 = k_i * i0 / k_s
    K = k_i * g0**2 / (4 * i0)
    parameters = {"force_current_factor": k_i, "force_displacement_factor": k_s, "bias_current": i0}
    inputs = {"displacement": (2,), "current": (2,)}
    block = prepare("amb_nonlinear", inputs, parameters, {"driving": driving})
    rng = np.random.default_rng(11)
    for size in (0.1, 0.8):
        x, i = rng.uniform(-0.3, 0.3, 2) * g0, np.array([1.0, -1.0]) * size
        force = block.evaluate({"displacement": x, "current": i}).outputs["force"]
        first, second = i0 - i, i0 + i  # positive control current pulls the rotor back
        if driving == "unipolar":
            first, second = np.clip(first, 0, None), np.clip(second, 0, None)
        assert force == pytest.approx(K * ((first / (g0 - x)) ** 2 - (second / (g0 + x)) ** 2), rel=1e-12)


def test_saturation_limits_the_flux_of_each_magnet_and_keeps_the_small_signal_factors() -> None:
    k_i, k_s, i0, B = 40.0, 1.1e5, 0.5, 1.7
    parameters = {"force_current_factor": k_i, "force_displacement_factor": k_s, "bias_current": i0}
    inputs = {"displacement": (2,), "current": (2,)}
    block = prepare("magnetic_saturation", inputs, {**parameters, "saturation_flux": B})
    g0 = k_i * i0 / k_s
    x, i = np.array([0.2, -0.1]) * g0, np.array([0.3, 0.1])
    force = block.evaluate({"displacement": x, "current": i}).outputs["force"]
    b1, b2 = (i0 - i) / (g0 - x) * g0 / i0, (i0 + i) / (g0 + x) * g0 / i0
    ratio = (B * np.tanh(b1 / B)) ** 2 - (B * np.tanh(b2 / B)) ** 2
    assert force[0] / force[1] == pytest.approx(ratio[0] / ratio[1], rel=1e-12)

    def at(x: float, i: float) -> float:
        return float(block.evaluate({"displacement": [x, 0.0], "current": [i, 0.0]}).outputs["force"][0])

    assert (at(1e-9, 0) - at(-1e-9, 0)) / 2e-9 == pytest.approx(k_s, rel=1e-7)
    assert (at(0, 1e-6) - at(0, -1e-6)) / 2e-6 == pytest.approx(-k_i, rel=1e-7)
    linear = prepare("amb_nonlinear", inputs, parameters)
    iron = prepare("magnetic_saturation", inputs, {**parameters, "saturation_flux": 1e4})
    values = {"displacement": x, "current": i}
    np.testing.assert_allclose(iron.evaluate(values).outputs["force"], linear.evaluate(values).outputs["force"], 1e-7)


def test_smooth_steps_of_a_converter_approach_those_that_jump() -> None:
    inputs = {"displacement": (2,), "velocity": (2,)}
    at = {"displacement": np.array([3.3e-6, -7.8e-6]), "velocity": np.zeros(2)}
    errors = []
    for width in (0.2, 0.05):
        block = prepare("quantisation", inputs, {"interval": 1e-6, "width": width}, {"law": "smooth"})
        errors.append(np.abs(block.evaluate(at).outputs["sensed_displacement"] - [3e-6, -8e-6]).max())
    assert errors[1] < 1e-8 < errors[0]
    edge = [block.evaluate({**at, "displacement": [s * 1e-6, 0]}).outputs["sensed_displacement"] for s in (1 - 1e-9, 1)]
    np.testing.assert_allclose(edge[0], edge[1], atol=1e-12)
