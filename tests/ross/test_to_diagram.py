"""A rotor of ROSS as a diagram: blocks, wires, values; what is not carried over is said."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorsim import load, modes, simulate
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.ross.to_diagram import import_ross
from tests.ross.conftest import Import
from tests.ross.rotors import (
    BRONZE,
    DISC,
    OVER_SPEED,
    PLAIN,
    ROTORS,
    Tables,
    bearing,
    disc,
    point,
    shaft,
    stepped,
    tables,
    toml,
)

SHIPPED = Path(__file__).parents[2] / "diagrams" / "ross_rotor.toml"
AXIAL = "rotor.toml: warning: axial and torsional motion are not carried over"


def parameters(document: dict[str, Any], block: str = "rotor") -> dict[str, Any]:
    found: dict[str, Any] = document["blocks"][block]["parameters"]
    return found


def said(read: Import, elements: Tables, **more: Any) -> list[str]:
    return [str(problem) for problem in read(toml(elements, **more)).warnings]


@pytest.mark.slow
@pytest.mark.parametrize("name", ROTORS)
def test_what_is_written_is_canonical_and_without_mistakes(name: str, read: Import) -> None:
    done = read(toml(ROTORS[name]))
    text = format_document(done.document)
    assert format_document(json.loads(text)) == text
    again = load(json.loads(text))
    assert list(again.warnings) == []
    assert sorted(again.nodes) == sorted(done.diagram.nodes)


def test_nodes_sizes_and_materials_are_those_of_the_file(read: Import) -> None:
    document = read(toml(tables(stepped(), shaft(5, 0.2, 0.04, material=BRONZE), DISC, PLAIN))).document
    rotor = parameters(document)
    assert rotor["elements"] == 6
    assert rotor["element_length"] == [0.1, 0.12, 0.15, 0.15, 0.1, 0.2]
    assert rotor["outer_diameter"] == [0.05, 0.06, 0.08, 0.07, 0.05, 0.04]
    assert rotor["young_modulus"] == [2.11e11] * 5 + [1.1e11]
    assert rotor["poisson_ratio"][0] == pytest.approx(2.11e11 / (2 * 8.12e10) - 1)
    assert (rotor["theory"], rotor["rotary_inertia"], rotor["shaft_gyroscopic"]) == ("timoshenko", True, True)
    assert (rotor["disc_nodes"], rotor["disc_mass"], rotor["disc_polar_inertia"]) == ([3], [12.0], [0.15])
    assert ["rotor.displacement[6]", "bearing_5.displacement"] in document["wires"]
    assert ["bearing_5.force", "rotor.force[6]"] in document["wires"]
    assert parameters(document, "bearing_5") == {"kxx": 1e7, "kyy": 1e7, "cxx": 500.0, "cyy": 500.0}
    assert parameters(document, "unbalance_disk_2") == {"mass": 12.0, "eccentricity": 0.0}


def test_nodes_may_begin_anywhere(read: Import) -> None:
    shifted = tables(shaft(3, 0.1, 0.05), shaft(4, 0.1, 0.05), disc(4, 1.0, 0.01, 0.02), bearing(3, kxx=1e6, cxx=1.0))
    document = read(toml(shifted)).document
    assert parameters(document)["disc_nodes"] == [2]
    assert ["bearing_3.force", "rotor.force[1]"] in document["wires"]
    assert "node n of ROSS is node n - 2 of block rotor" in document["description"]


def test_the_stiffest_layer_is_the_shaft_and_the_others_are_sleeves(read: Import) -> None:
    thick, thin = shaft(0, 0.1, 0.05), shaft(0, 0.1, 0.06, 0.05, "a", material=BRONZE)
    for order in ((thick, thin), (thin, thick)):
        rotor = parameters(read(toml(tables(*order, shaft(1, 0.1, 0.05)))).document)
        assert (rotor["outer_diameter"], rotor["sleeve_elements"]) == (0.05, [1])
        assert (rotor["sleeve_outer_diameter"], rotor["sleeve_young_modulus"]) == ([0.06], 1.1e11)


def test_a_conical_sleeve_tapers_as_in_the_file(read: Import) -> None:
    straight = shaft(0, 0.1, 0.055, 0.05, "a", material=BRONZE)
    sleeve = shaft(1, 0.12, 0.07, 0.06, "a", odr=0.08, material=BRONZE)
    done = read(toml(tables(stepped(), straight, sleeve)))
    rotor = parameters(done.document)
    assert (rotor["sleeve_elements"], rotor["conical_sleeves"]) == ([1, 2], [2])
    assert (rotor["sleeve_outer_diameter"], rotor["sleeve_end_outer_diameter"]) == ([0.055, 0.07], [0.08])
    assert (rotor["sleeve_inner_diameter"], rotor["sleeve_end_inner_diameter"]) == ([0.05, 0.06], [0.06])
    assert [str(problem) for problem in done.warnings] == [AXIAL]


def test_a_bearing_on_a_pedestal_pushes_both(read: Import) -> None:
    document = read(toml(ROTORS["support"])).document
    assert parameters(document, "point_mass_6") == {"mass": [20.0, 25.0]}
    for wire in (
        ["point_mass_6.displacement", "bearing_0.support_displacement"],
        ["point_mass_6.velocity", "bearing_0.support_velocity"],
        ["bearing_0.reaction", "point_mass_6.force"],
        ["point_mass_6.displacement", "foundation.displacement"],
        ["foundation.force", "point_mass_6.force"],
    ):
        assert wire in document["wires"]
    rotor = parameters(document)
    assert (rotor["mass_damping"], rotor["stiffness_damping"]) == (3.0, 1e-5)
    assert (rotor["disc_nodes"], rotor["disc_mass"]) == ([3, 6], [12.0, 1.5])  # the mass of the seal is a point


def test_tables_keep_every_value_and_constants_are_one(read: Import) -> None:
    over_speed = parameters(read(toml(ROTORS["tables"])).document, "bearing_0")
    table = OVER_SPEED["BearingElement_Bearing 0"]
    assert over_speed == {"speeds": table["frequency"]} | {k: table[k] for k in over_speed if k != "speeds"}
    assert len(over_speed) == 9
    constant = bearing(0, frequency=[1.0, 2.0, 3.0], kxx=[1e6] * 3, cxx=[1.0, 2.0, 4.0])
    values = parameters(read(toml(tables(stepped(), constant))).document, "bearing_0")
    assert (values["kxx"], values["cxx"]) == (1e6, [1.0, 2.0, 4.0])


@pytest.mark.parametrize(
    ("elements", "given", "speed"),
    [
        (PLAIN, {}, 0.0),
        (OVER_SPEED, {}, 500.0),
        (OVER_SPEED, {"rated_w": 600.0, "max_w": 700.0}, 600.0),
        (PLAIN, {"max_w": 700.0}, 700.0),
    ],
)
def test_the_speed_is_rated_or_where_all_tables_hold(
    elements: Tables, given: dict[str, float], speed: float, read: Import
) -> None:
    assert read(toml(tables(stepped(), elements), **given)).document["parameters"] == {"speed": f"{speed} rad/s"}


def test_ross_1_and_2_and_json_give_the_same_diagram(read: Import) -> None:
    """ROSS 1 has neither damping of elements nor axial coefficients, and does not say its version."""
    new = read(toml(ROTORS["stepped"])).document
    old = {
        name: {key: value for key, value in values.items() if key not in ("alpha", "beta")}
        for name, values in ROTORS["stepped"].items()
    }
    done = read(toml(old, version=""))
    assert (done.version, list(done.warnings)) == ("", [])
    six = {name.replace("Element_", "Element6DoF_", 1): values for name, values in old.items()}
    as_json = json.dumps({"_note": "...", "ross_version": "2.3.0", "parameters": {}, **ROTORS["stepped"]})
    for other in (done, read(toml(six, version="")), read(as_json, "rotor.json")):
        assert {**other.document, "description": ""} == {**new, "description": ""}


@pytest.mark.slow
def test_a_step_is_stable_for_the_stiffest_mode(read: Import) -> None:
    done = read(toml(ROTORS["stepped"]))
    solver = done.document["solver"]
    largest = max(abs(mode.eigenvalue) for mode in modes(done.diagram).modes)
    assert solver["method"] == "rk4"
    assert 0.8 <= solver["step"] * largest <= 2.0
    assert solver["step"] * solver.get("record_every", 1) == pytest.approx(1e-4)
    result = simulate(done.diagram, parameters={"speed": 300.0, "unbalance_disk_2.eccentricity": 1e-5}, stop=0.02)
    assert 0 < np.abs(result.signals["rotor.displacement"]).max() < 1e-4


# -- what is said ------------------------------------------------------------------------------------------------------


def test_what_is_not_carried_over_is_said(read: Import) -> None:
    odd = stepped(axial_force=100.0, shear_method_calc="hutchinson")
    odd["ShaftElement_Shaft Element 2"]["torque"] = 5.0
    thrust = {"ThrustPad_Thrust": {"n": 1, "kxx": [0], "cxx": [0], "kzz": [1e8], "czz": [1e5], "tag": "Thrust"}}
    magnetic = bearing(0, "MagneticBearingElement", "AMB 0", kxx=[1e6], cxx=[1e3], g0=1e-3)
    journal = bearing(5, "PlainJournal", "Journal", kxx=[1e7], cxx=[1e4])
    text = toml(tables(odd, thrust, magnetic, journal), alpha=1.0)
    lines = text.splitlines()

    def warning(line: str, subject: str, what: str) -> str:
        return f"rotor.toml:{lines.index(line) + 1}:1: warning: {subject}: {what}"

    first, pad, alone = "ShaftElement_Shaft Element 0", "ThrustPad_Thrust", "is read by its coefficients alone"
    amb, plain = "MagneticBearingElement_AMB 0", "PlainJournal_Journal"
    shear = "shear coefficient 'hutchinson' is not carried over: Cowper's is used"
    law = "is read as stiffness and damping over the speed: its controller is not carried over"
    assert sorted(str(problem) for problem in read(text).warnings) == sorted(
        [
            AXIAL,
            warning(
                "axial_force = 100.0",
                f"{first} (and 4 more)",
                "axial_force is not carried over, which changes the modes",
            ),
            warning(
                "torque = 5.0", "ShaftElement_Shaft Element 2", "torque is not carried over, which changes the modes"
            ),
            warning('shear_method_calc = "hutchinson"', f"{first} (and 4 more)", shear),
            warning(f'["{pad}"]', pad, "acts along the axis only: left out"),
            warning(f'["{pad}"]', pad, f"class 'ThrustPad' {alone}"),
            warning("kzz = [100000000.0]", pad, "kzz, czz are not carried over"),
            warning(f'["{plain}"]', plain, f"class 'PlainJournal' {alone}"),
            warning(f'["{amb}"]', amb, f"{law}\n\nhint: put blocks amb and pid in its place"),
            "rotor.toml: warning: parameters: not carried over: alpha",
        ]
    )


def test_a_rotor_without_bearings_or_discs_is_free(read: Import) -> None:
    done = read(toml(stepped()))
    assert [node.block.type_name for node in done.diagram.nodes.values()] == ["clock", "rotor_fe"]
    assert parameters(done.document)["disc_nodes"] == []
    assert said(read, stepped()) == [AXIAL]


def test_a_point_mass_on_the_shaft_has_no_inertias(read: Import) -> None:
    rotor = parameters(read(toml(tables(stepped(), DISC, point(4, m=3.0)))).document)
    assert (rotor["disc_nodes"], rotor["disc_mass"]) == ([3, 5], [12.0, 3.0])
    assert rotor["disc_polar_inertia"] == [0.15, 0.0]


def test_names_of_blocks_differ_and_are_names(read: Import) -> None:
    twins = tables(bearing(0, tag="7 Ä/b", kxx=1e6, cxx=1.0), bearing(1, tag="7 b", kxx=1e6, cxx=1.0))
    twins |= bearing(2, tag="Rotor", kxx=1e6, cxx=1.0)
    assert list(read(toml(tables(stepped(), twins))).document["blocks"]) == [
        "clock",
        "rotor",
        "element_7_b",
        "element_7_b_2",
        "rotor_2",
    ]


def test_the_shipped_example_says_what_it_lacks() -> None:
    done = import_ross(SHIPPED)
    assert [problem.what for problem in done.warnings] == [
        "axial and torsional motion are not carried over",
        "kzz is not carried over",
    ]
    assert list(done.document["blocks"]) == [
        "clock",
        "rotor",
        "point_mass_5",
        "bearing_0",
        "bearing_4",
        "pedestal",
        "unbalance_disk_2",
    ]
