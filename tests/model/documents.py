"""Small diagrams for the tests of the compiler."""

from typing import Any


def document(blocks: dict[str, Any], wires: list[list[str]], record: list[str], **more: Any) -> dict[str, Any]:
    """Return a diagram document of one-line blocks: name -> (type, parameters)."""
    return {
        "schema_version": 1,
        "name": "test",
        "blocks": {name: {"type": kind, "parameters": values} for name, (kind, values) in blocks.items()},
        "wires": wires,
        "record": record,
        "solver": {"method": "rk4", "step": 1e-3, "stop": 1.0},
        **more,
    }


def oscillator(stiffness: float = 100.0, damping: float = 2.0, **more: Any) -> dict[str, Any]:
    """Return x'' = cos(5 t + 1) - damping x' - stiffness x from elementary blocks."""
    return document(
        {
            "force": ("sine", {"frequency": 5.0, "phase": 1.0 + 1.5707963267948966}),
            "balance": ("sum", {"signs": "+--"}),
            "velocity": ("integrator", {}),
            "position": ("integrator", {"initial": 0.25}),
            "damper": ("gain", {"gain": damping}),
            "spring": ("gain", {"gain": stiffness}),
        },
        [
            ["force.output", "balance.input1"],
            ["damper.output", "balance.input2"],
            ["spring.output", "balance.input3"],
            ["balance.output", "velocity.input"],
            ["velocity.output", "position.input"],
            ["velocity.output", "damper.input"],
            ["position.output", "spring.input"],
        ],
        ["position.output", "velocity.output"],
        **more,
    )


def sampled(period: float, noise_period: float = 2e-3) -> dict[str, Any]:
    """Return a ramp that is sampled and held, with seeded noise added behind it."""
    return document(
        {
            "ramp": ("ramp", {"slope": 1.0}),
            "hold": ("sample_hold", {"sample_time": period}),
            "noise": ("noise", {"sample_time": noise_period, "standard_deviation": 0.5, "seed": 7}),
            "sum": ("sum", {}),
            "state": ("integrator", {}),
        },
        [
            ["ramp.output", "hold.input"],
            ["hold.output", "sum.input1"],
            ["noise.output", "sum.input2"],
            ["sum.output", "state.input"],
        ],
        ["hold.output", "noise.output", "state.output"],
    )
