"""Machines for the tests of the free rotor and of acceptance, as documents."""

from __future__ import annotations

from typing import Any

LENGTHS = ["60 mm", "15 mm", "125 mm", "150 mm", "140 mm", "120 mm", "15 mm", "75 mm"]
DIAMETERS = ["20 mm", "24 mm", "24 mm", "28 mm", "28 mm", "24 mm", "24 mm", "20 mm"]


def wires_of(block: str, node: int) -> list[list[str]]:
    """Return the wires of a support at a node."""
    return [
        [f"rotor.displacement[{node}]", f"{block}.displacement"],
        [f"rotor.velocity[{node}]", f"{block}.velocity"],
        [f"{block}.force", f"rotor.force[{node}]"],
    ]


def on_supports(rotor: dict[str, Any], nodes: list[int], stiffness: float, damping: float = 0.0) -> dict[str, Any]:
    """Return a rotor of beam elements on equal supports."""
    one = {"stiffness": [stiffness] * 2, "damping": [damping] * 2}
    supports: dict[str, Any] = {f"support{node}": {"type": "support", "parameters": one} for node in nodes}
    return {
        "schema_version": 1,
        "name": "shaft",
        "parameters": {"speed": "100 rad/s"},
        "blocks": {
            "clock": {"type": "clock", "parameters": {"speed": "$speed"}},
            "rotor": {"type": "rotor_fe", "parameters": rotor},
            **supports,
        },
        "wires": [
            ["clock.speed", "rotor.speed"],
            *(wire for node in nodes for wire in wires_of(f"support{node}", node)),
        ],
        "solver": {"method": "lsoda", "step": "0.1 ms", "stop": "0.1 s"},
        "record": ["rotor.displacement"],
    }


def stepped(stiffness: float, damping: float = 0.0) -> dict[str, Any]:
    """Return the stepped shaft with two discs that ROSS was given."""
    rotor = {
        "elements": 8,
        "element_length": LENGTHS,
        "outer_diameter": DIAMETERS,
        "rotary_inertia": True,
        "shaft_gyroscopic": True,
        "disc_nodes": [4, 6],
        "disc_mass": ["2 kg", "1.5 kg"],
        "disc_polar_inertia": ["0.0045 kg m^2", "0.0034 kg m^2"],
        "disc_diametral_inertia": ["0.0024 kg m^2", "0.0018 kg m^2"],
    }
    return on_supports(rotor, [2, 8], stiffness, damping)


def stiff_rotor(polar: float, diametral: float, stiffness: float) -> dict[str, Any]:
    """Return a disc of 4 kg in the middle of a stiff shaft of 0.61654 kg, 0.4 m between its two supports."""
    rotor = {
        "elements": 2,
        "element_length": "0.2 m",
        "outer_diameter": "50 mm",
        "young_modulus": "1e14 N/m^2",
        "density": "785 kg/m^3",
        "disc_nodes": [2],
        "disc_mass": ["4 kg"],
        "disc_polar_inertia": [polar],
        "disc_diametral_inertia": [diametral],
    }
    return on_supports(rotor, [1, 3], stiffness)


def uniform(elements: int, magnet: int, probe: int) -> dict[str, Any]:
    """Return a free uniform shaft of 1 m, with one magnet and its probe at nodes."""
    nothing = {"disc_nodes": [1], "disc_mass": [0.0], "disc_polar_inertia": [0.0], "disc_diametral_inertia": [0.0]}
    rotor = {"elements": elements, "element_length": 1.0 / elements, "outer_diameter": "20 mm", **nothing}
    return {
        "schema_version": 1,
        "name": "uniform",
        "parameters": {"speed": "100 rad/s"},
        "blocks": {
            "clock": {"type": "clock", "parameters": {"speed": "$speed"}},
            "rotor": {"type": "rotor_fe", "parameters": rotor},
            "controller": {"type": "pid"},
            "amb": {"type": "amb"},
        },
        "wires": [
            ["clock.speed", "rotor.speed"],
            [f"rotor.displacement[{probe}]", "controller.displacement"],
            [f"rotor.velocity[{probe}]", "controller.velocity"],
            [f"rotor.displacement[{magnet}]", "amb.displacement"],
            ["controller.current", "amb.current"],
            ["amb.force", f"rotor.force[{magnet}]"],
        ],
        "solver": {"method": "lsoda", "step": "0.1 ms", "stop": "0.1 s"},
        "record": ["rotor.displacement"],
    }


def jeffcott(stiffness: float, damping: float, controller: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return a disc of 2 kg in a magnetic bearing under PD control: shaft 1e6 N/m, bearing k and d in all."""
    ks, ki = 1e5, 40.0
    pd = {"type": "pd", "parameters": {"KP": (stiffness + ks) / ki, "KD": damping / ki}}
    return {
        "schema_version": 1,
        "name": "disc",
        "parameters": {"speed": "300 rad/s"},
        "blocks": {
            "clock": {"type": "clock", "parameters": {"speed": "$speed"}},
            "unbalance": {
                "type": "unbalance",
                "parameters": {"mass": "2 kg", "eccentricity": "10 um", "phase": "0 deg"},
            },
            "rotor": {
                "type": "rotor_2dof",
                "parameters": {"mass": "2 kg", "stiffness": "1e6 N/m", "viscous_damping": "0 N s/m"},
            },
            "controller": controller or pd,
            "amb": {"type": "amb", "parameters": {"force_displacement_factor": ks, "force_current_factor": ki}},
        },
        "wires": [
            ["clock.theta", "unbalance.theta"],
            ["clock.speed", "unbalance.speed"],
            ["unbalance.force", "rotor.force"],
            ["rotor.displacement", "controller.displacement"],
            ["rotor.velocity", "controller.velocity"],
            ["rotor.displacement", "amb.displacement"],
            ["controller.current", "amb.current"],
            ["amb.force", "rotor.force"],
        ],
        "solver": {"method": "rk4", "step": "0.1 ms", "stop": "0.1 s"},
        "record": ["rotor.displacement"],
    }
