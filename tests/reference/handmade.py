"""Models written by hand as CasADi expressions: the analyses are tested without any block or diagram file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.block import Block
from rotorsim.diagram.diagram import Endpoint, Wire
from rotorsim.model.compiled import Model
from rotorsim.model.trace.diagram import Signal, Trace

Build = Callable[[Any, Mapping[str, Any], Mapping[str, Any], Mapping[str, Any]], dict[str, Any]]


def handmade(
    states: Mapping[str, int],
    parameters: Mapping[str, float],
    build: Build,
    *,
    external: Mapping[str, int] | None = None,
    initial: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    record: Sequence[str] = ("rotor.displacement", "controller.current"),
    z: int = 0,
    wires: Sequence[tuple[str, str]] = (),
) -> Model:
    """Return a model: ``build(t, x, p, v)`` gives "xdot" (by state), "signals" and perhaps "events".

    parameters: "block.name" -> value; an entry "speed" is the diagram parameter (held by "clock.speed").
    external: ports to which v is added (build does it).
    """
    units = units or {}
    t = ca.SX.sym("t")
    x = {name: ca.SX.sym(name, n) for name, n in states.items()}
    names = ["clock.speed" if name == "speed" else name for name in parameters]
    p = {name: ca.SX.sym(name) for name in names}
    v = {name: ca.SX.sym("v", n) for name, n in (external or {}).items()}
    made = build(t, x, p, v)

    def layout(sizes: Mapping[str, int]) -> dict[str, Signal]:
        out, at = {}, 0
        for name, n in sizes.items():
            out[name] = Signal(name, (n,), units.get(name), slice(at, at + n))
            at += n
        return out

    signals = {name: ca.SX(value) for name, value in made["signals"].items()}
    shapes = {name: (value.shape[0],) if value.shape[0] > 1 else () for name, value in signals.items()}
    trace = Trace(
        t=t,
        x=ca.vertcat(*x.values()),
        z=ca.SX.sym("z", z),
        p=ca.vertcat(*p.values()),
        v=ca.vertcat(*v.values()) if v else ca.SX(0, 1),
        w=ca.SX(0, 1),
        hit=ca.SX(0, 1),
        xdot=ca.vertcat(*[made["xdot"][name] for name in states]),
        z_next=ca.SX.sym("z", z),
        x0=ca.vertcat(*[ca.SX([(initial or {}).get(name, 0.0)] * n) for name, n in states.items()]),
        z0=ca.SX.zeros(z, 1),
        signals=signals,
        events=made.get("events", ca.SX(0, 1)),
        loop_residuals=ca.SX(0, 1),
        states=layout(states),
        discrete_states={"held.value": Signal("held.value", (z,), None, slice(0, z))} if z else {},
        parameters={name: Signal(name, (), None, slice(k, k + 1)) for k, name in enumerate(names)},
        external=layout(external or {}),
        ports={
            name: Signal(name, shapes[name], _unit(name, units), slice(0, value.shape[0]))
            for name, value in signals.items()
        },
        samplers=(),
        state_blocks=tuple(name.rpartition(".")[0] for name, n in states.items() for _ in range(n)),
    )
    nodes: dict[str, Any] = {}
    for name, value in zip(names, parameters.values(), strict=True):
        block, _, key = name.rpartition(".")
        node = nodes.setdefault(block, _node())
        node.values[key] = np.array(value)
        node.block.parameters[key] = SimpleNamespace(unit=None, low=None, above=None, high=None)
        if name == "clock.speed":
            node.references["speed"] = "speed"
    for port in signals:
        block, _, key = port.rpartition(".")
        node = nodes.setdefault(block, _node())
        node.outputs[key] = None
    diagram: Any = SimpleNamespace(
        name="handmade",
        file="",
        nodes=nodes,
        structural={},
        parameters={"speed": np.array(parameters["speed"])} if "speed" in parameters else {},
        record=tuple(record),
        wires=tuple(Wire(_end(source), _end(target)) for source, target in wires),
    )
    return Model(diagram, trace)


def _node() -> SimpleNamespace:
    return SimpleNamespace(values={}, references={}, outputs={}, block=_Bare())


class _Bare(Block):
    """What a handmade model knows of a block: its parameters, to which each model adds its own."""

    def __init__(self) -> None:
        self.parameters = {}  # type: ignore[misc]


def _end(text: str) -> Endpoint:
    block, _, port = text.rpartition(".")
    return Endpoint(block, port)


def _unit(name: str, units: Mapping[str, str]) -> str:
    if name in units:
        return units[name]
    return {"displacement": "m", "tilt": "rad", "current": "A", "force": "N"}.get(name.rpartition(".")[2], "1")


TABLE_2_1 = {
    "speed": 1500 * math.pi / 30,
    "rotor.mass": 2.0,
    "rotor.stiffness": 7.6e5,
    "rotor.viscous_damping": 76.0,
    "crack.stiffness": 3e5,
    "crack.sag": 26e-6,
    "unbalance.eccentricity": 24e-6,
    "unbalance.phase": math.radians(30),
    "amb.force_displacement_factor": 105210.0,
    "amb.force_current_factor": 42.1,
    "controller.KP": 12200.0,
    "controller.KI": 2000.0,
    "controller.KD": 3.0,
}


def jeffcott(
    *,
    opening: str = "switching",
    with_amb: bool = True,
    nonlinear_amb: bool = False,
    breathing: bool = False,
    external: str = "",
    gravity: float = 0.0,
    **changed: float,
) -> Model:
    """Return the cracked Jeffcott rotor of thesis chapter 2 (Table 2-1), or a variant of it."""
    values = {**TABLE_2_1, **{key.replace("__", "."): value for key, value in changed.items()}}

    def build(t: Any, x: Any, p: Any, v: Any) -> dict[str, Any]:
        q, velocity, integral = x["rotor.q"], x["rotor.v"], x["controller.integral"]
        theta = p["clock.speed"] * t
        if opening == "switching":
            s = 0.5 + sum((-1) ** k * 2 / (math.pi * (2 * k + 1)) * ca.cos((2 * k + 1) * theta) for k in range(5))
        elif opening == "exact":
            s = ca.if_else(ca.cos(theta) > 0, 1.0, 0.0)
        else:
            s = ca.SX(0)
        dk = p["crack.stiffness"]
        force = 0.5 * s * dk * p["crack.sag"] * ca.vertcat(1 + ca.cos(2 * theta), ca.sin(2 * theta))
        if breathing:  # stiffness falls by dk along the crack, opened by the displacement in its direction
            e = ca.vertcat(ca.cos(theta), ca.sin(theta))
            along = ca.dot(e, q + ca.vertcat(p["crack.sag"], 0))
            opened = 0.5 * (1 + ca.tanh(along / 5e-6))
            force = opened * dk * along * e
        amplitude = p["rotor.mass"] * p["unbalance.eccentricity"] * p["clock.speed"] ** 2
        angle = theta + p["unbalance.phase"]
        force += amplitude * ca.vertcat(ca.cos(angle), ca.sin(angle)) - ca.vertcat(gravity, 0)
        current = p["controller.KP"] * q + p["controller.KI"] * integral + p["controller.KD"] * velocity
        seen = current
        if external:
            seen = v["controller.current"] + (current if external == "inject" else 0)
        if nonlinear_amb:
            i0, gap = 1.0, 0.4e-3
            constant = p["amb.force_current_factor"] * gap**2 / (4 * i0)
            amb = constant * (((i0 - seen) / (gap - q)) ** 2 - ((i0 + seen) / (gap + q)) ** 2)
        else:
            amb = p["amb.force_displacement_factor"] * q - p["amb.force_current_factor"] * seen
        if with_amb:
            force += amb
        acceleration = (force - p["rotor.viscous_damping"] * velocity - p["rotor.stiffness"] * q) / p["rotor.mass"]
        return {
            "xdot": {"rotor.q": velocity, "rotor.v": acceleration, "controller.integral": q},
            "signals": {"rotor.displacement": q, "controller.current": current, "amb.force": amb},
            "events": ca.cos(theta) if opening == "exact" else ca.SX(0, 1),
        }

    return handmade(
        {"rotor.q": 2, "rotor.v": 2, "controller.integral": 2},
        values,
        build,
        external={"controller.current": 2} if external else None,
        wires=(("rotor.displacement", "controller.displacement"),),
    )


def gyroscopic(*, k_x: float = 1e6, k_y: float = 1e6, **changed: float) -> Model:
    """Return a disc that tilts only: I_d tilt'' - i W I_p tilt' + c tilt' + k tilt = 0, tilt = (t1, t2)."""
    values = {
        "speed": 300.0,
        "rotor.polar": 0.02,
        "rotor.diametral": 0.012,
        "rotor.damping": 0.0,
        "rotor.kx": k_x,
        "rotor.ky": k_y,
    }
    values.update({key.replace("__", "."): value for key, value in changed.items()})

    def build(t: Any, x: Any, p: Any, v: Any) -> dict[str, Any]:
        tilt, rate = x["rotor.tilt"], x["rotor.rate"]
        gyroscopic = p["clock.speed"] * p["rotor.polar"] * ca.vertcat(-rate[1], rate[0])
        spring = ca.vertcat(p["rotor.kx"] * tilt[0], p["rotor.ky"] * tilt[1])
        return {
            "xdot": {
                "rotor.tilt": rate,
                "rotor.rate": (gyroscopic - p["rotor.damping"] * rate - spring) / p["rotor.diametral"],
            },
            "signals": {"rotor.tilt": tilt},
        }

    return handmade({"rotor.tilt": 2, "rotor.rate": 2}, values, build, record=("rotor.tilt",))
