"""The machine from a drawing: what its description says of damping, margins, critical speeds and weight."""

import json
from functools import cache

import numpy as np
import pytest

from rotorsim.linear.control.margins import margins
from rotorsim.linear.linearisation import as_model
from rotorsim.linear.modes.eigenmodes import modes
from rotorsim.model.load import load
from rotorsim.report.figures.shaft import shaft_of
from rotorsim.settled.periodic import periodic
from tests.docs.pages import blocks
from tests.systems.shipped import document


@cache
def machine():
    return as_model(load("drawn_rotor"))


@pytest.mark.slow
def test_all_modes_to_2_khz_are_damped_as_its_description_says():
    found = modes(machine())
    assert found.stable
    poles = np.array([mode.eigenvalue for mode in found.modes])
    low = poles[(poles.imag > 1) & (poles.imag < 2 * np.pi * 2000)]
    low = low[np.abs(low.real) < 0.99 * np.abs(low)]  # others hardly oscillate
    decrements = -2 * np.pi * low.real / low.imag
    assert len(low) == 12
    assert decrements.min() >= 0.1
    first = np.sort(low.imag)[:2] / (2 * np.pi)
    assert first == pytest.approx([53.0, 53.0], abs=0.5)
    speed = 9000 / 60
    assert first[1] < speed / 2  # it runs above it
    assert np.abs(np.sort(low.imag) / (2 * np.pi) / speed - 1).min() > 0.2  # no mode near the speed


@pytest.mark.slow
def test_the_peak_sensitivity_is_that_of_zone_a():
    found = margins(machine())
    assert found.stable
    assert [axis.zone for axis in found.axes] == ["A"] * 4
    assert max(axis.peak for axis in found.axes) < 3.0


def test_unbalance_is_that_of_its_discs():
    _, shaft = shaft_of(machine().diagram)
    masses = [float(machine().diagram.nodes[f"unbalance{k}"].values["mass"]) for k in (1, 2)]
    assert masses == pytest.approx([disc.mass for disc in shaft.discs], abs=0.005)


def test_its_probes_stand_20_mm_beside_its_magnets():
    option = machine().diagram.nodes["rotor"].block.option
    at = dict(zip(option.station_names, option.stations, strict=True))
    assert at["magnet A"] - at["probe A"] == pytest.approx(0.02)
    assert at["probe B"] - at["magnet B"] == pytest.approx(0.02)
    wires = document("drawn_rotor")["wires"]
    row = {name: k for k, name in enumerate(option.station_names, 1)}
    for side in ("a", "b"):
        assert [f"rotor.displacement[{row[f'probe {side.upper()}']}]", f"controller_{side}.displacement"] in wires
        assert [f"amb_{side}.force", f"rotor.force[{row[f'magnet {side.upper()}']}]"] in wires


def test_its_bearings_carry_its_weight_by_the_lever_rule():
    """k_s u - k_i i at order 0, in y; the settled motion knows nothing of levers."""
    found = periodic(machine(), speeds=[9000 * np.pi / 30])
    _, shaft = shaft_of(machine().diagram)
    forces = []
    for row, side in ((2, "a"), (5, "b")):
        amb = machine().diagram.nodes[f"amb_{side}"].values
        seen = found.harmonic(f"rotor.displacement[{row}]", 0)[0].imag
        current = found.harmonic(f"controller_{side}.current", 0)[0].imag
        forces.append(float(amb["force_displacement_factor"] * seen - amb["force_current_factor"] * current))
    right = shaft.mass * 9.81 * (shaft.centre_of_gravity - 0.11) / (0.79 - 0.11)
    assert forces == pytest.approx([shaft.mass * 9.81 - right, right], rel=1e-6)


def in_casing(kind: str = "casing") -> dict:
    """Return the machine with a casing of docs/machines.md under its bearing A."""
    fragments = [json.loads(f"{{{text}}}") for text in blocks("docs/machines.md", "json") if '"casing"' in text]
    [added] = [one for one in fragments if "wires" in one]
    [casing] = [found for one in fragments if (found := one.get("blocks", one)["casing"])["type"] == kind]
    made = document("drawn_rotor")
    fed = {target for _, target in added["wires"]}
    kept = [wire for wire in made["wires"] if wire[1] not in fed or wire[1].startswith("rotor.force")]
    wires = [*kept, *(wire for wire in added["wires"] if wire not in kept)]
    return {**made, "blocks": {**made["blocks"], **added["blocks"], "casing": casing}, "wires": wires}


# m per N: a foot; phi_y^2 / (m w^2) of the modes of the page
STATIC = {"casing": 1 / 5e6, "flexible_casing": (1 / (60 * 46**2) + 1 / (18 * 240**2)) / (2 * np.pi) ** 2}


@pytest.mark.slow
@pytest.mark.parametrize("kind", STATIC)
def test_the_casings_of_the_page_give_way_under_the_load_of_their_bearing(kind):
    """The integrator holds the probe: there the shaft moves as the casing, by load / stiffness; the load is static."""
    made = load(in_casing(kind))
    assert modes(made).stable
    found = periodic(made, speeds=[9000 * np.pi / 30])
    probe, magnet = (found.harmonic(f"rotor.displacement[{row}]", 0)[0].imag for row in (1, 2))
    carried = 1.5e6 * (magnet - probe) - 200 * found.harmonic("controller_a.current", 0)[0].imag
    _, shaft = shaft_of(made)
    right = shaft.mass * 9.81 * (shaft.centre_of_gravity - 0.11) / (0.79 - 0.11)
    assert carried == pytest.approx(shaft.mass * 9.81 - right, rel=1e-6)
    assert probe == pytest.approx(-carried * STATIC[kind], rel=1e-6)
