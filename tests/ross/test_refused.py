"""What is no rotor, or one that no diagram can be, is refused by name and place, all mistakes at once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from rotorsim.blocks.common import drawn_mistakes

from rotorsim.errors import RotorsimError
from rotorsim.ross import to_diagram
from rotorsim.ross.to_diagram import import_ross
from tests.ross.conftest import Import, Refusal
from tests.ross.rotors import DISC, PLAIN, STEEL, bearing, disc, point, shaft, stepped, tables, toml

GIVE = "give a rotor that ROSS has saved with rotor.save(FILE)"
NO_SHAFT = f"has no shaft element: it is no rotor saved by ROSS\n\nhint: {GIVE}"


def ends_in_words(read: Import, text: str, name: str = "rotor.toml") -> bool:
    """Return whether a text is read, or refused with words."""
    try:
        read(text, name)
    except RotorsimError as error:
        return all(problem.what for problem in error.problems)
    return True


def rotor(*more: Any, **shafts: Any) -> str:
    return toml(tables(stepped(**shafts), *more))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = [1,\nb = 2\n", f"rotor.toml:2:1: error: not valid TOML: invalid value\n\nhint: {GIVE}"),
        (
            "[parameters\n",
            f"rotor.toml:1:12: error: not valid TOML: expected ']' at the end of a table declaration\n\nhint: {GIVE}",
        ),
        ("", f"rotor.toml: error: {NO_SHAFT}"),
        ("[parameters]\n", f"rotor.toml: error: {NO_SHAFT}"),
        ("x = 1\n\n[tool]\ny = 2\n", f"rotor.toml: error: {NO_SHAFT}"),
        (
            'x = 1\n["DiskElement_a"]\nn = 0\n',
            f"rotor.toml:1:1: error: x: is no element: a table named CLASS_TAG is expected\n\nhint: {GIVE}",
        ),
        ('["DiskElement_a"]\nn = 0\n', f"rotor.toml: error: {NO_SHAFT}"),
    ],
)
def test_what_is_no_rotor_is_refused(text: str, said: str, refusal: Refusal) -> None:
    assert refusal(text) == [said]


def test_json_of_diagrams_and_broken_json_are_refused(refusal: Refusal) -> None:
    assert refusal('{"blocks": {}, "wires": []}', "x.json") == [f"x.json: error: {NO_SHAFT}"]
    assert refusal("[1]", "x.json") == [f"x.json: error: is no table of elements\n\nhint: {GIVE}"]
    assert refusal("", "x.json") == [
        "x.json:1:1: error: file is empty\n\nhint: a rotor that ROSS has saved with rotor.save(FILE)"
    ]


def test_layouts_before_version_1_are_refused(refusal: Refusal, tmp_path: Path) -> None:
    hint = "hint: load it with the ROSS that saved it, and save it with ROSS 1.0 or newer"
    assert refusal("[ShaftElement.0]\nL = 1\n") == [
        f"rotor.toml:1:1: error: ShaftElement: is the layout of ROSS before 1.0\n\n{hint}"
    ]
    with pytest.raises(RotorsimError) as caught:
        import_ross(tmp_path)
    hint = "hint: ROSS before 1.0 saved folders: load it with that ROSS, and save it with ROSS 1.0 or newer"
    assert str(caught.value) == f"{tmp_path}: error: is a folder\n\n{hint}"
    with pytest.raises(RotorsimError, match=r"none\.toml: error: file does not exist"):
        import_ross("none.toml")


def test_all_mistakes_come_at_once_each_where_it_is(refusal: Refusal) -> None:
    text = toml(
        tables(
            shaft(0, -0.1, 0.05),
            shaft(1, 0.1, 0.05, 0.06),
            shaft(2, "0.1", float("nan"), material={**STEEL, "E": -1.0}),  # type: ignore[arg-type]
            shaft(3, 0.1, 0.05, material="Steel", gyroscopic=1, shear_method_calc="cowpr"),
            shaft(-3, 0.1, 0.05, material=None),
            {"DiskElement_a": {"n": 1.5, "m": -2.0, "Id": 0.1}},
            bearing(0, cxx=[1.0, 2.0], frequency=[3.0, 3.0]),
            bearing(1, kxx=[1.0, 2.0], cxx=[], n_link="x"),
            {"PointMass_p": {"n": 6, "mx": 3.0}},
            {"BearngElement_q": {"n": 0, "kxx": 1.0}},
            {"CouplingElement_c": {"n": 0}},
        )
    )
    lines = {line: k for k, line in enumerate(text.splitlines(), 1)}

    def at(table: str, key: str = "") -> int:
        """Return the line of a header or, below it, of a key."""
        begin = lines[f'["{table}"]']
        following = text.splitlines()[begin:]
        return begin + 1 + next(k for k, line in enumerate(following) if line.startswith(f"{key} =")) if key else begin

    def said(table: str, key: str, what: str, hint: str, name: str = "") -> str:
        return f"rotor.toml:{at(table, key)}:1: error: {name or table}: {what}\n\nhint: {hint}"

    s = [f"ShaftElement_Shaft Element {n}" for n in (0, 1, 2, 3, -3)]
    assert sorted(refusal(text)) == sorted(
        [
            said(s[0], "L", "L is -0.1", "it must be greater than 0"),
            said(s[1], "idl", "idl is 0.06, odl 0.05", "the inner diameter must be the smaller one"),
            said(s[1], "idr", "idr is 0.06, odr 0.05", "the inner diameter must be the smaller one"),
            said(s[2], "L", "L must be a number, not the text '0.1'", "write a number in SI units"),
            said(s[2], "odl", "odl is nan", "numbers must be finite"),
            said(s[2], "odr", "odr is nan", "numbers must be finite"),
            f"rotor.toml:{at(s[2])}:1: error: {s[2]}.material: E is -1\n\nhint: it must be greater than 0",
            said(s[3], "gyroscopic", "gyroscopic must be true or false, not 1", "write true or false"),
            said(
                s[3],
                "shear_method_calc",
                "shear_method_calc must be cowper or hutchinson, not 'cowpr'",
                "cowper is the default of ROSS",
            ),
            said(s[3], "material", "material must be a table", "a table with rho, E and G_s is expected"),
            said(s[4], "", "material is missing", "a table with rho, E and G_s is expected"),
            said(s[4], "n", "n must be a whole number of at least 0, not -3", "nodes are counted from 0"),
            said("DiskElement_a", "n", "n must be a whole number of at least 0, not 1.5", "nodes are counted from 0"),
            said("DiskElement_a", "m", "m is -2", "it must be at least 0"),
            said("DiskElement_a", "", "Ip is missing", "a number is expected"),
            said("BearingElement_Bearing 0", "", "kxx is missing", "a number or a list of numbers is expected"),
            said(
                "BearingElement_Bearing 0",
                "frequency",
                "frequency must increase, but 3 rad/s follows 3 rad/s",
                "sort the table by speed, each speed once",
            ),
            said("BearingElement_Bearing 1", "cxx", "cxx is an empty list", "numbers are expected"),
            said(
                "BearingElement_Bearing 1",
                "kxx",
                "kxx has 2 values, frequency 1",
                "one value for each frequency is expected",
            ),
            said(
                "BearingElement_Bearing 1",
                "n_link",
                "n_link must be a whole number of at least 0, not the text 'x'",
                "nodes are counted from 0",
            ),
            said("PointMass_p", "", "my is missing", "a number is expected"),
            said(
                "BearngElement_q",
                "",
                "class 'BearngElement' is not known, and has no coefficients kxx and cxx",
                "did you mean 'BearingElement' or 'BearingElement6DoF' or 'BallBearingElement'?",
            ),
            said(
                "CouplingElement_c",
                "",
                "class 'CouplingElement' is not supported",
                "a coupling joins two shafts: save each shaft as a rotor of its own",
            ),
        ]
    )


@pytest.mark.parametrize(
    ("elements", "where", "what", "hint"),
    [
        (
            tables(stepped(), shaft(7, 0.1, 0.05)),
            ("ShaftElement_Shaft Element 7", "n"),
            "begins at node 7, and no element ends there",
            "one shaft without gaps is expected; rotors of several shafts are not supported",
        ),
        (
            tables(stepped(), shaft(5, 0.1, 0.05, rotary_inertia=False)),
            ("ShaftElement_Shaft Element 5", "rotary_inertia"),
            "rotary_inertia is false, that of ShaftElement_Shaft Element 0 true",
            "one value for all elements is expected",
        ),
        (
            tables(stepped(), shaft(5, 0.1, 0.05, beta=1e-5)),
            ("ShaftElement_Shaft Element 5", "beta"),
            "beta is 1e-05, that of ShaftElement_Shaft Element 0 0.0",
            "one value for all elements is expected",
        ),
        (
            tables(stepped(), shaft(2, 0.1, 0.085, 0.08, "a")),
            ("ShaftElement_Shaft Element 2a", "L"),
            "L is 0.1, that of ShaftElement_Shaft Element 2 at the same node 0.15",
            "elements at one node are layers of one length",
        ),
        (
            tables(stepped(), disc(9, 1.0, 0.1, 0.1)),
            ("DiskElement_Disk 9", "n"),
            "n is 9: neither a node of the shaft, 0 to 5, nor of a point mass",
            "a node beside the shaft needs a PointMass",
        ),
        (
            tables(stepped(), bearing(0, kxx=1e6, cxx=1.0, n_link=8)),
            ("BearingElement_Bearing 0", "n_link"),
            "n_link is 8: neither a node of the shaft, 0 to 5, nor of a point mass",
            "a node beside the shaft needs a PointMass",
        ),
        (
            tables(stepped(), bearing(0, kxx=1e6, cxx=1.0, mxx=[2.0], myy=[3.0])),
            ("BearingElement_Bearing 0", "mxx"),
            "mxx, mxy, myx, myy cannot be carried over",
            "only one mass, the same in x and y and at all speeds, to ground, can be; set them to 0 to leave them out",
        ),
        (
            tables(stepped(), point(2, mx=1.0, my=2.0)),
            ("PointMass_Point Mass 2", "mx"),
            "mx is 1, my 2, at a node of the shaft",
            "a mass on the shaft is the same in both directions",
        ),
        (
            tables(stepped(), point(6, m=0.0), bearing(6, kxx=1e6, cxx=1.0)),
            ("PointMass_Point Mass 6", ""),
            "has no mass",
            "a mass beside the shaft must be above 0",
        ),
        (
            stepped(material={**STEEL, "rho": 7.81}),
            ("ShaftElement_Shaft Element 0", ""),
            "rho is 7.81 kg/m^3, the density of no solid",
            "ROSS saves SI units: 7850 is 7.85 g/cm^3",
        ),
        (
            stepped(material={**STEEL, "E": 211.0, "G_s": 81.2}),
            ("ShaftElement_Shaft Element 0", ""),
            "E is 211 N/m^2, softer than any shaft",
            "ROSS saves SI units: 211e9 is 211 GPa",
        ),
        (
            stepped(material={**STEEL, "rho": 0.0}),
            ("ShaftElement_Shaft Element 0", ""),
            "rho is 0: the shaft has no mass here",
            "give a small density, 0.1 kg/m^3 at most",
        ),
    ],
)
def test_what_no_diagram_can_be_is_refused(
    elements: dict[str, Any], where: tuple[str, str], what: str, hint: str, refusal: Refusal
) -> None:
    text = toml(elements)
    before, header, after = text.partition(f'["{where[0]}"]')
    key = [k for k, line in enumerate(after.splitlines()) if line.startswith(f"{where[1]} =")] if where[1] else [0]
    line = before.count("\n") + 1 + key[0]
    assert header
    assert refusal(text)[0] == f"rotor.toml:{line}:1: error: {where[0]}: {what}\n\nhint: {hint}"


def test_a_shear_modulus_that_no_material_has_is_refused(refusal: Refusal) -> None:
    said = refusal(rotor(material={**STEEL, "G_s": 2e10}))[0]
    assert said.split("error: ")[1] == (
        "ShaftElement_Shaft Element 0.material: E and G_s give a Poisson's ratio of 4.275, more than 0.5\n\n"
        "hint: G_s must be at least E / 3"
    )


def test_many_mistakes_are_counted(refusal: Refusal) -> None:
    said = refusal(toml(tables(*(shaft(n, -1.0, 0.05) for n in range(70)))))
    assert len(said) == 51
    assert said[-1] == "error: ... and 20 more mistakes"


@pytest.mark.parametrize("cut", range(0, 3000, 97))
def test_a_file_that_is_cut_off_or_damaged_ends_in_words(cut: int, read: Import) -> None:
    text = rotor(DISC, PLAIN)
    for damaged in (text[:cut], text[:cut] + "\x00" + text[cut:], text[:cut] + text[cut + 5 :]):
        assert ends_in_words(read, damaged)


@pytest.mark.slow
@pytest.mark.parametrize("value", [None, True, "x", [], [[1.0]], {}, {"a": 1}, 1e400, -1, 10**400])
def test_wrong_values_anywhere_end_in_words(value: Any, read: Import) -> None:
    elements = tables(stepped(), DISC, PLAIN, point(6, mx=1.0, my=1.0))
    for name in (
        "ShaftElement_Shaft Element 1",
        "DiskElement_Disk 2",
        "BearingElement_Bearing 0",
        "PointMass_Point Mass 6",
    ):
        for key in elements[name]:
            changed = {**elements, name: {**elements[name], key: value}}
            assert ends_in_words(
                read, json.dumps({"parameters": {}, **changed}).replace("Infinity", "1e300"), "rotor.json"
            )
    for whole in (value, {"n": value}):
        assert ends_in_words(
            read,
            json.dumps({"parameters": value, "ross_version": value, "BearingElement_x": whole, **elements}).replace(
                "Infinity", "1e300"
            ),
            "rotor.json",
        )


def test_materials_are_judged_as_those_of_drawings() -> None:
    for name in ("SOFTEST", "MASSLESS", "LIGHTEST", "HEAVIEST"):
        assert getattr(to_diagram, name) == getattr(drawn_mistakes, name)
