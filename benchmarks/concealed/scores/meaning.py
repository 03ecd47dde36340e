"""What the parameters of a diagnosis mean in terms of the truth: block parameter -> function of the effect's numbers.

Names are those that `rotorsim blocks NAME --json` shows. What is not here is not scored.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi, sin, sqrt

from benchmarks.concealed.machines import SHAFT_STIFFNESS

Effect = dict[str, float]
Reading = Callable[[Effect], float]


def the(key: str, factor: float = 1.0) -> Reading:
    """Return factor times a number of the effect."""
    return lambda effect: factor * effect[key]


def error_of(key: str) -> Reading:
    """Return factor - 1 for a gain that may not be the wrong one."""
    return lambda effect: effect.get(key, 1.0) - 1.0


def if_there(key: str) -> Reading:
    """Return a number of the effect, zero if it is not in it."""
    return lambda effect: effect.get(key, 0.0)


BETWEEN = 4e5  # N/m, bearing_stiffness of the block foundation_mode: of it only its square over the mass is seen

FREE = {
    "viscous_damping": "c",
    "eccentricity": "e",
    "unbalance_phase": "beta",
    "crack_stiffness": "dk",
    "force_displacement_factor": "ks",
    "force_current_factor": "ki",
    "crack_phase": "crack_phase",
}

PHASES = {"phase", "phase1", "phase2", "phase3", "growth_phase", "backward_phase2", "direction"}
HALF_TURN = {("asymmetric_shaft", "phase"), ("base_excitation", "direction")}  # the law repeats after pi

MEANING: dict[str, dict[str, Reading]] = {
    "residual_bow": {"amplitude": the("bow"), "phase": the("bow_phase")},
    "thermal_bow": {
        "amplitude": the("b0"),
        "phase": the("b0_phase"),
        "growth": the("b1"),
        "growth_phase": the("b1_phase"),
        "time_constant": the("tau"),
    },
    "parallel_misalignment": {
        "amplitude1": if_there("mis1"),
        "phase1": the("mis1_phase"),
        "amplitude2": the("mis2"),
        "phase2": the("mis2_phase"),
        "backward2": if_there("mis-2"),
        "backward_phase2": the("mis-2_phase"),
    },
    "angular_misalignment": {
        "amplitude1": the("mom1"),
        "phase1": the("mom1_phase"),
        "amplitude2": the("mom2"),
        "phase2": the("mom2_phase"),
    },
    "rub": {"gap": the("gap"), "stiffness": the("k"), "friction": the("mu")},
    "clearance": {"gap": the("gap"), "stiffness": the("k")},
    "anisotropic_support": {"stiffness_difference": the("dk", 2.0), "damping_difference": the("dc", 2.0)},
    "asymmetric_shaft": {"asymmetry": the("dk"), "phase": the("phase")},
    "second_crack": {"stiffness": the("dk"), "phase": the("phase")},
    "foundation_mode": {
        "mass": the("mass", (BETWEEN / SHAFT_STIFFNESS) ** 2),
        "frequency": lambda e: sqrt(e["stiffness"] / e["mass"]),
        "damping_ratio": lambda e: e["damping"] / 2 / sqrt(e["stiffness"] * e["mass"]),
    },
    "internal_damping": {"damping": the("ci")},
    "hysteretic_damping": {"loss_factor": the("eta")},
    "seal_cross_coupling": {"cross_stiffness": the("kc"), "direct_stiffness": the("kd"), "direct_damping": the("cd")},
    "cubic_stiffness": {"stiffness": the("k3")},
    "coulomb_friction": {"friction": the("Fc")},
    "support_stiffness": {"stiffness": the("dk")},
    "magnetic_pull": {"stiffness": the("km")},
    "mass_error": {"mass": the("dm")},
    "gyroscopic_error": {"inertia": the("dG")},
    "moment_unbalance": {"phase": the("phase")},
    "unbalance_elsewhere": {"phase": the("phase")},
    "magnetic_saturation": {"saturation_current": the("is")},
    "torsion_coupling": {"amplitude": the("phi"), "frequency": the("frequency", 2 * pi)},
    "magnetic_nonlinearity": {"bias_current": the("i0"), "gap": the("g0")},
    "eddy_current_lag": {"time_constant": the("tau"), "share": the("part")},
    "amplifier_bandwidth": {"bandwidth": the("wa")},
    "amb_cross_coupling": {"real_coupling": the("eps")},
    "control_delay": {"delay": the("delay")},
    "controller_gain_error": {"displacement_error": error_of("KP_factor"), "velocity_error": error_of("KD_factor")},
    "current_clipping": {"limit": the("imax")},
    "current_sensor_gain": {"gain_error": the("eps")},
    "sensor_gain": {"gain_error": the("eps")},
    "sensor_gain_mismatch": {"mismatch": the("eps")},
    "sensor_rotation": {"angle": the("angle")},
    "non_collocation": {"distance": the("distance")},
    "runout": {
        "amplitude1": the("run1"),
        "phase1": the("run1_phase"),
        "amplitude2": if_there("run2"),
        "phase2": the("run2_phase"),
        "amplitude3": if_there("run3"),
        "phase3": the("run3_phase"),
    },
    "sensor_offset": {
        "offset_x": lambda e: e["offset"] * cos(e["direction"]),
        "offset_y": lambda e: e["offset"] * sin(e["direction"]),
    },
    "quantisation": {"interval": the("lsb")},
    "base_excitation": {
        "acceleration": the("acceleration"),
        "frequency": the("frequency", 2 * pi),
        "direction": the("direction"),
    },
    "speed_fluctuation": {"amplitude": the("eps"), "frequency": the("frequency", 2 * pi)},
    "blade_pass": {"amplitude": lambda e: e["force"] * (e["N"] > 0), "backward": lambda e: e["force"] * (e["N"] < 0)},
}

ONE_NODE = {"residual_bow", "thermal_bow"}  # their size rests on a stiffness that, on a beam, is a matter of definition


def compare(physics: str, name: str, machine: str, effect: Effect) -> tuple[float, float] | None:
    """Return the true value and the period (0: none) of a parameter, or None where nothing is known."""
    reading = MEANING.get(physics, {}).get(name)
    if reading is None or (physics in ONE_NODE and machine != "jeffcott" and name not in PHASES):
        return None
    try:
        value = reading(effect)
    except KeyError:
        return None
    period = pi if (physics, name) in HALF_TURN else 2 * pi if name in PHASES else 0.0
    return value, period
