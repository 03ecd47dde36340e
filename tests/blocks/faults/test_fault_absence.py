"""A fault whose amplitude is zero is not there: no force, and a signal that passes unchanged."""

from __future__ import annotations

import numpy as np
import pytest

from rotorsim.diagram.resolve.registry import all_types, find
from tests.blocks.evaluation import prepare

SHAPES: dict[str, tuple[int, ...]] = {"acceleration": (), "theta": (), "speed": ()}  # of inputs; all others are pairs

# every amplitude of an effect: where they vanish, so does the effect
AMPLITUDES = {
    "residual_bow": ("amplitude",),
    "thermal_bow": ("amplitude", "growth"),
    "rub": ("stiffness",),
    "parallel_misalignment": ("amplitude0", "amplitude1", "amplitude2", "backward2"),
    "angular_misalignment": ("amplitude1", "amplitude2"),
    "blade_pass": ("amplitude", "backward"),
    "anisotropic_support": ("stiffness_difference", "damping_difference"),
    "asymmetric_shaft": ("asymmetry",),
    "support_stiffness": ("stiffness", "damping"),
    "gyroscopic_error": ("inertia",),
    "moment_unbalance": ("skew",),
    "unbalance": ("eccentricity",),
    "crack": ("stiffness", "tilt_stiffness"),
    "internal_damping": ("damping",),
    "hysteretic_damping": ("loss_factor",),
    "mass_error": ("mass",),
    "magnetic_pull": ("stiffness",),
    "seal_cross_coupling": ("cross_stiffness", "direct_stiffness", "direct_damping"),
    "clearance": ("stiffness",),
    "cubic_stiffness": ("stiffness",),
    "coulomb_friction": ("friction", "offset"),
    "base_excitation": ("acceleration",),
    "torsion_coupling": ("unbalance", "crack_coupling"),
}
# amplitudes of what stands in a wire, and their value when it lets the signal through
NEUTRAL: dict[str, dict[str, float]] = {
    "runout": dict.fromkeys([f"{n}{k}" for n in ("amplitude", "backward") for k in (1, 2, 3)], 0.0),
    "amb_cross_coupling": {"real_coupling": 0.0, "imaginary_coupling": 0.0},
    "controller_gain_error": {"displacement_error": 0.0, "velocity_error": 0.0},
    "current_gain": {"gain_error": 0.0},
    "sensor_gain": {"gain_error": 0.0},
    "sensor_gain_mismatch": {"mismatch": 0.0, "skew": 0.0},
    "sensor_rotation": {"angle": 0.0},
    "sensor_offset": {"offset_x": 0.0, "offset_y": 0.0},
    "non_collocation": {"distance": 0.0},
    "current_clipping": {"limit": 1e9},
    "speed_fluctuation": {"amplitude": 0.0},
}


def test_the_tables_of_what_is_absent_are_complete() -> None:
    forces = {cls.type_name for cls in all_types().values() for f in cls.faults if f.enters == "force"}
    wires = {cls.type_name for cls in all_types().values() for f in cls.faults if f.enters in ("wire", "reading")}
    # a foundation and lags do not vanish at a value of a parameter; test_fault_dynamics.py has their responses
    assert AMPLITUDES.keys() == forces - {"foundation_mode"}
    assert NEUTRAL.keys() == wires - {"control_delay", "amplifier_bandwidth", "eddy_current_lag", "quantisation"}


@pytest.mark.parametrize("name", AMPLITUDES)
def test_a_force_without_amplitude_is_zero(name: str) -> None:
    cls = find(name)
    assert cls is not None
    inputs = {port: SHAPES.get(port, (2,)) for port, d in cls.inputs.items()}
    rng = np.random.default_rng(7)
    values = {port: rng.normal(size=shape) for port, shape in inputs.items()}
    outputs = {"force": (2,)} if "force" in cls.outputs else {}
    for options in {str(f.options): dict(f.options) for f in cls.faults if f.enters == "force"}.values():
        block = prepare(name, inputs, dict.fromkeys(AMPLITUDES[name], 0.0), options, outputs)
        states = {state: rng.normal(size=start.shape) for state, start in block.initial.items()}
        found = block.evaluate(values, states).outputs
        for port in {"force", "moment"} & found.keys():
            np.testing.assert_array_equal(np.abs(found[port]), 0.0)


@pytest.mark.parametrize("name", NEUTRAL)
def test_a_wire_without_a_fault_lets_the_signal_through(name: str) -> None:
    cls = find(name)
    assert cls is not None
    inputs = {port: SHAPES.get(port, (2,)) for port in cls.inputs}
    rng = np.random.default_rng(8)
    values = {port: rng.normal(size=shape) for port, shape in inputs.items()}
    found = prepare(name, inputs, NEUTRAL[name]).evaluate(values).outputs
    for inside, outside in cls.faults[0].through.items():
        np.testing.assert_array_equal(found[outside], values[inside])


@pytest.mark.parametrize("name", ["runout", "sensor_gain", "sensor_offset", "quantisation", "controller_gain_error"])
def test_a_sensor_works_where_the_controller_makes_its_own_velocity(name: str) -> None:
    cls = find(name)
    assert cls is not None
    inputs = {port: SHAPES.get(port, (2,)) for port in cls.inputs if port != "velocity"}
    rng = np.random.default_rng(9)
    values = {port: rng.normal(size=shape) for port, shape in inputs.items()}
    both = prepare(name, {**inputs, "velocity": (2,)}).evaluate({**values, "velocity": np.ones(2)}).outputs
    alone = prepare(name, inputs).evaluate(values).outputs
    displacement, velocity = cls.faults[0].through.values()
    np.testing.assert_array_equal(alone[displacement], both[displacement])
    np.testing.assert_array_equal(alone[velocity], 0.0)
