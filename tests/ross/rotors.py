"""Rotors in the layout in which ROSS saves them, written by hand."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

STEEL = {"name": "Steel", "rho": 7810.0, "E": 2.11e11, "G_s": 8.12e10, "color": "#525252"}
BRONZE = {"name": "Bronze", "rho": 8800.0, "E": 1.1e11, "G_s": 4.1e10, "color": "#525252"}
WEIGHTLESS = {"name": "Impellers", "rho": 7000.0, "E": 7e3, "G_s": 7e3, "color": "#525252"}  # mass without stiffness

Tables = dict[str, dict[str, Any]]


def shaft(n: int, L: float, od: float, bore: float = 0.0, layer: str = "", **more: Any) -> Tables:
    """Return a shaft element with the keys of ROSS 2.3; ``more`` replaces values (None takes a key out)."""
    tag = f"Shaft Element {n}{layer}"
    values = {"L": L, "idl": bore, "odl": od, "idr": bore, "odr": od, "n": n, "axial_force": 0, "torque": 0}
    values |= {"shear_effects": True, "rotary_inertia": True, "gyroscopic": True, "shear_method_calc": "cowper"}
    values |= {"tag": tag, "alpha": 0.0, "beta": 0.0, "material": STEEL, **more}
    return {f"ShaftElement_{tag}": {key: value for key, value in values.items() if value is not None}}


def disc(n: int, m: float, Id: float, Ip: float, **more: Any) -> Tables:
    return {f"DiskElement_Disk {n}": {"n": n, "m": m, "Id": Id, "Ip": Ip, "tag": f"Disk {n}", **more}}


def bearing(n: int, kind: str = "BearingElement", tag: str = "", **coefficients: Any) -> Tables:
    tag = tag or f"Bearing {n}"
    return {f"{kind}_{tag}": {"n": n, "tag": tag, "scale_factor": 1, **coefficients}}


def point(n: int, **masses: float) -> Tables:
    return {f"PointMass_Point Mass {n}": {"n": n, "tag": f"Point Mass {n}", **masses}}


def tables(*parts: Tables) -> Tables:
    return {name: dict(values) for part in parts for name, values in part.items()}


def toml(elements: Mapping[str, Mapping[str, Any]], version: str = "2.3.0", **parameters: float) -> str:
    """Return the text that ROSS writes; version "": that of ROSS 1 and 2.0, which do not say theirs."""
    lines = [f'ross_version = "{version}"\n'] if version else []
    lines += ["[parameters]", *(f"{key} = {value!r}" for key, value in parameters.items()), ""]
    for name, values in elements.items():
        lines += [f"[{json.dumps(name)}]"]
        lines += [f"{key} = {_value(value)}" for key, value in values.items() if not isinstance(value, dict)]
        lines += [""]
    for name, values in elements.items():
        for key, value in values.items():
            if isinstance(value, dict):
                lines += [f"[{json.dumps(name)}.{key}]", *(f"{k} = {_value(v)}" for k, v in value.items()), ""]
    return "\n".join(lines)


def _value(value: Any) -> str:
    if isinstance(value, float) and value != value:
        return "nan"
    return json.dumps(value)


SIZES = ((0.1, 0.05, 0.0), (0.12, 0.06, 0.02), (0.15, 0.08, 0.03), (0.15, 0.07, 0.03), (0.1, 0.05, 0.01))
SPEEDS = [100.0, 300.0, 500.0, 700.0, 900.0]


def stepped(**more: Any) -> Tables:
    """Return a hollow stepped shaft of five elements."""
    return tables(*(shaft(n, *size, **more) for n, size in enumerate(SIZES)))


def straight(a: float, b: float) -> list[float]:
    return [a + b * speed for speed in SPEEDS]


DISC = disc(2, 12.0, 0.08, 0.15)
PLAIN = tables(bearing(0, kxx=[2e7], kyy=[1.5e7], cxx=[800.0], cyy=[600.0]), bearing(5, kxx=[1e7], cxx=[500.0]))
OVER_SPEED = bearing(
    0,
    frequency=SPEEDS,
    kxx=straight(2e7, 1e4),
    kxy=straight(1e6, 2e3),
    kyx=straight(-2e6, -3e3),
    kyy=straight(1.5e7, 5e3),
    cxx=straight(9e3, -4.0),
    cxy=straight(100.0, -0.1),
    cyx=straight(50.0, 0.1),
    cyy=straight(8e3, -3.0),
)
ON_SUPPORT = tables(
    bearing(0, n_link=6, kxx=[2e7], kyy=[1.5e7], kxy=[3e5], kyx=[-3e5], cxx=[800.0]),
    bearing(6, tag="Foundation", kxx=[5e7], kyy=[4e7], cxx=[100.0]),
    bearing(5, "SealElement", "Seal 5", kxx=[1e7], cxx=[500.0], mxx=[1.5]),
    point(6, mx=20.0, my=25.0, mz=22.0),
)
ROTORS: dict[str, Tables] = {
    "stepped": tables(stepped(), DISC, PLAIN),
    "slender": tables(stepped(shear_effects=False, rotary_inertia=False, gyroscopic=False), DISC, PLAIN),
    "tables": tables(stepped(), DISC, OVER_SPEED, bearing(5, kxx=[1e7], cxx=[500.0])),
    "cones": tables(
        shaft(0, 0.1, 0.04, odr=0.06),
        shaft(1, 0.2, 0.06, 0.02, odr=0.09, idr=0.03, material=BRONZE),
        shaft(2, 0.15, 0.09, 0.03, odr=0.05, idr=0.01),
        disc(2, 8.0, 0.03, 0.05),
        bearing(0, kxx=[2e7], cxx=[800.0]),
        bearing(3, kxx=[1e7], cxx=[500.0]),
    ),
    "layers": tables(
        stepped(),
        shaft(1, 0.12, 0.1, 0.06, "a", material=BRONZE),
        shaft(2, 0.15, 0.2, 0.08, "a", material=WEIGHTLESS),
        shaft(2, 0.15, 0.22, 0.2, "b", material=WEIGHTLESS),
        DISC,
        PLAIN,
    ),
    "conical layers": tables(
        stepped(),
        shaft(0, 0.1, 0.08, 0.05, "a", odr=0.06, material=BRONZE),
        shaft(3, 0.15, 0.09, 0.07, "a", odr=0.14, material=BRONZE),
        shaft(3, 0.15, 0.16, 0.09, "b", odr=0.17, idr=0.14, material=WEIGHTLESS),
        DISC,
        PLAIN,
    ),
    "support": tables(stepped(alpha=3.0, beta=1e-5), DISC, ON_SUPPORT),
}
