"""Mistakes in a drawing: all at once, each where it is written; options that have units."""

import json
from pathlib import Path
from typing import Any

import pytest

from rotorsim.diagram.diff import diff
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.schema import json_schema
from rotorsim.errors import RotorsimError
from rotorsim.linear.modes.eigenmodes import modes
from rotorsim.model.load import load
from rotorsim.simulation.ensemble.many import simulate_many
from tests.diagram.helpers import block, diagram, mistakes

MM = {
    "section_lengths": ["100 mm", "200 mm", "100 mm"],
    "outer_diameter": ["40 mm", "50 mm", "40 mm"],
    "stations": ["50 mm", "300 mm"],
}


def drawn(**parameters: Any) -> dict[str, Any]:
    return diagram(
        {"rest": block("constant", value=0.0), "rotor": block("rotor_drawing", **{**MM, **parameters})},
        ("rest.output", "rotor.speed"),
    )


def written(document: dict[str, Any]) -> list[str]:
    """Return the mistakes of a canonical file, without line and column."""
    found = mistakes(format_document(document))
    assert all(line.partition(": ")[0].count(":") == 1 for line in found), found  # every one has line and column
    return [line.partition(": ")[2] for line in found]


def test_all_mistakes_of_a_drawing_are_told_at_once() -> None:
    assert written(
        drawn(
            inner_diameter=[0, "60 mm", "10 mm"],
            stations=["50 mm", "500 mm"],
            station_names=["probe"],
            disc_positions=["-1 mm", "410 mm"],
            drawn_disc_positions=["0.2 m"],
            drawn_disc_outer_diameter="50 mm",
            drawn_disc_inner_diameter=["50 mm"],
            young_modulus=["210 GPa", "200 GPa"],
            longest_element="2 mm",
            shortest_element="3 mm",
        )
    ) == [
        "rotor.stations: station 2 at 500 mm is right of the shaft | it goes from 0 to 400 mm",
        "rotor.inner_diameter: 60 mm of section 2 must be smaller than its outer diameter, 50 mm | a solid one has 0",
        "rotor.station_names: has 1 entries, but there are 2 stations | give one name for each, or none",
        "rotor.disc_positions: disc_mass is not given | a disc given by mass and inertias needs disc_mass",
        "rotor.disc_positions: disc 1 at -1 mm is left of the shaft | it goes from 0 to 400 mm",
        "rotor.disc_positions: disc 2 at 410 mm is right of the shaft | it goes from 0 to 400 mm",
        "rotor.drawn_disc_positions: drawn_disc_width is not given | a disc by dimensions needs its width",
        "rotor.drawn_disc_inner_diameter: 50 mm of disc 1 must be smaller than its outer diameter, 50 mm"
        " | a solid one has 0",
        "rotor.young_modulus: shape is (2,), expected (3,) | write a list [...]",
        "rotor.shortest_element: is longer than longest_element | or leave both out",
    ]


def test_a_mistake_is_placed_at_the_entry_of_its_list() -> None:
    text = format_document(drawn(stations=["50 mm", "500 mm"]))
    line = next(k for k, row in enumerate(text.splitlines(), 1) if "500 mm" in row)
    column = text.splitlines()[line - 1].index('"500 mm"') + 1
    assert mistakes(text)[0].startswith(f"{line}:{column}: rotor.stations: station 2")


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"stations": []}, "rotor.stations: the list is empty | a rotor has a section, and a station to act on"),
        ({"stations": "50 mm"}, "rotor.stations: must be a list, not the text '50 mm' | write [...]"),
        ({"stations": ["50 kg"]}, "rotor.stations: unit 'kg' does not fit 'm' | give it in m"),
        ({"stations": ["50"]}, "rotor.stations: '50' has no unit | write '50 m', or a number without quotes (SI)"),
        ({"section_lengths": [0.1, 0, 0.1]}, "rotor.section_lengths: 0 m must be greater than 0 m | "),
        (
            {"outer_diameter": ["40 mm", "50 mm"]},
            "rotor.outer_diameter: shape is (2,), expected (3,) | write a list [...]",
        ),
        (
            {"drawn_disc_positions": [0.1], "drawn_disc_outer_diameter": 0.1, "drawn_disc_width": [0.0]},
            "rotor.drawn_disc_width: of disc 1 must be greater than 0 | a disc by dimensions needs its width",
        ),
    ],
)
def test_one_mistake_gives_one_message(parameters: dict[str, Any], expected: str) -> None:
    found = written(drawn(**parameters))
    assert len(found) == 1
    assert found[0].startswith(expected)


def test_all_mistakes_of_cones_and_sleeves_are_told_at_once() -> None:
    assert written(
        drawn(
            inner_diameter=[0, "20 mm", 0],
            conical_sections=[2, 4, 2],
            sleeve_begins=["10 mm", "350 mm"],
            sleeve_lengths=["50 mm", "60 mm"],
            sleeve_outer_diameter=["40 mm", "60 mm"],
            sleeve_inner_diameter=["40 mm", "30 mm"],
        )
    ) == [
        "rotor.conical_sections: end_outer_diameter is not given | a cone needs the outer diameter of its right end",
        "rotor.conical_sections: section 2 has a bore of 20 mm, end_inner_diameter is not given"
        " | give the bore at its right end; 0: it ends in a point",
        "rotor.conical_sections: section 4: the shaft has 3 | from 1 on the left",
        "rotor.conical_sections: section 2 is named twice | a section has one right end",
        "rotor.sleeve_begins: sleeve_stiffness_share is not given"
        " | 0: its mass only; 1: as stiff as of one piece with the shaft",
        "rotor.sleeve_lengths: the end of sleeve 2 at 410 mm is right of the shaft | it goes from 0 to 400 mm",
        "rotor.sleeve_inner_diameter: 40 mm of sleeve 1 must be smaller than its outer diameter, 40 mm"
        " | a solid one has 0",
    ]


SLEEVE = {
    "sleeve_begins": ["120 mm"],
    "sleeve_lengths": ["50 mm"],
    "sleeve_outer_diameter": "80 mm",
    "sleeve_inner_diameter": "50 mm",
    "sleeve_stiffness_share": "30 %",
}


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        (
            {"conical_sections": [2], "end_outer_diameter": 0},
            "rotor.end_outer_diameter: of cone 1 must be greater than 0 | a cone needs the outer diameter of its right"
            " end",
        ),
        (
            {"conical_sections": [2], "end_outer_diameter": "30 mm", "end_inner_diameter": ["30 mm"]},
            "rotor.end_inner_diameter: 30 mm of cone 1 must be smaller than its outer diameter, 30 mm"
            " | a solid one has 0",
        ),
        (
            {"conical_sections": [2, 3], "end_outer_diameter": ["30 mm"]},
            "rotor.end_outer_diameter: shape is (1,), expected (2,) | write a list [...]",
        ),
        (
            {**SLEEVE, "sleeve_inner_diameter": 0},
            "rotor.sleeve_begins: the bore of sleeve 1 is 0 mm, and the shaft in it 50 mm"
            " | give the shaft's diameter: its material would count twice",
        ),
        (
            {**SLEEVE, "sleeve_lengths": ["50 mm", "20 mm"]},
            "rotor.sleeve_lengths: 1 sleeves begin, and 2 have a length | give sleeve_lengths, one for each",
        ),
        (
            {**SLEEVE, "sleeve_begins": ["-5 mm"]},
            "rotor.sleeve_begins: sleeve 1 at -5 mm is left of the shaft | it goes from 0 to 400 mm",
        ),
        ({**SLEEVE, "sleeve_stiffness_share": "150 %"}, "rotor.sleeve_stiffness_share: 1.5 must be at most 1 | "),
    ],
)
def test_one_mistake_of_a_cone_or_sleeve_gives_one_message(parameters: dict[str, Any], expected: str) -> None:
    """Also one value that cannot be: it is not said to be missing besides."""
    load(drawn(**SLEEVE))
    found = written(drawn(**parameters))
    assert len(found) == 1
    assert found[0].startswith(expected)


@pytest.mark.slow
def test_a_sleeve_on_a_cone_fits_where_the_cone_is_thin_enough() -> None:
    tapers = {"conical_sections": [2], "end_outer_diameter": "30 mm", **SLEEVE, "sleeve_begins": ["200 mm"]}
    load(drawn(**{**tapers, "sleeve_inner_diameter": "35 mm"}))
    assert written(drawn(**{**tapers, "sleeve_inner_diameter": "30 mm"})) == [
        "rotor.sleeve_begins: the bore of sleeve 1 is 30 mm, and the shaft in it 35 mm"
        " | give the shaft's diameter: its material would count twice"
    ]


def test_what_must_be_given_is_asked_for() -> None:
    document = diagram({"rest": block("constant", value=0.0), "rotor": block("rotor_drawing", outer_diameter=0.04)})
    assert [line.partition(": ")[2].partition(" |")[0] for line in mistakes(format_document(document))] == [
        "rotor: parameter 'section_lengths' is missing",
        "rotor: parameter 'stations' is missing",
    ]


@pytest.mark.slow
def test_options_with_units_are_read_in_si_from_file_setting_and_parameter(tmp_path: Path) -> None:
    document = drawn(longest_element="$longest")
    document["parameters"] = {"longest": "25 mm"}
    option = load(document).nodes["rotor"].block.option
    assert (option.stations, option.longest_element) == ([0.05, 0.3], 0.025)
    assert load(document, set={"longest": "2 cm"}).nodes["rotor"].block.option.longest_element == 0.02
    for text in ("30 mm", "0.03", 0.03):
        assert load(drawn(), set={"rotor.longest_element": text}).nodes["rotor"].block.option.longest_element == 0.03
    stations = load(drawn(), set={"rotor.stations": [0.1, "0.2 m"]}).nodes["rotor"].block.option.stations
    assert stations == [0.1, 0.2]
    with pytest.raises(RotorsimError, match="unit 's' does not fit 'm'"):
        load(drawn(), set={"rotor.longest_element": "30 s"})


def test_options_of_one_length_in_two_units_are_no_difference() -> None:
    one, other = drawn(), drawn(stations=[0.05, "30 cm"])
    assert diff(one, other) == []
    assert [change.where for change in diff(one, drawn(stations=[0.05, 0.31]))] == ["blocks.rotor.parameters.stations"]


def test_the_schema_takes_quantities_for_options_and_asks_for_them() -> None:
    [kind] = [
        one
        for one in json_schema()["properties"]["blocks"]["additionalProperties"]["anyOf"]
        if one["properties"]["type"].get("const") == "rotor_drawing"
    ]
    given = kind["properties"]["parameters"]
    stations = given["properties"]["stations"]
    assert stations["description"] == "axial position of each station [m]"
    assert stations["anyOf"][0] == {"type": "array", "items": {"anyOf": [{"type": ["number"]}, {"type": "string"}]}}
    assert set(given["required"]) == {"outer_diameter", "section_lengths", "stations"}
    assert json.dumps(given)


@pytest.mark.slow
def test_a_parameter_that_an_option_follows_does_not_change_in_a_compiled_model() -> None:
    """It would have no effect, and nobody would know."""
    document = drawn(longest_element="$longest")
    document["parameters"] = {"longest": "25 mm"}
    made = load(document)
    assert made.structural == {"longest": "rotor.longest_element"}
    expected = (
        "error: longest: is followed by the option rotor.longest_element: another value makes other equations\n\n"
        "hint: load(..., set={'longest': ...}), or --set longest=..."
    )
    with pytest.raises(RotorsimError) as caught:
        modes(made, parameters={"longest": 0.02})
    assert str(caught.value) == expected
    with pytest.raises(RotorsimError) as caught:
        simulate_many(made, {"longest": [0.02, 0.03]}, stop=1e-3)
    assert str(caught.value) == expected


def test_a_disc_whose_bore_is_narrower_than_the_shaft_would_count_it_twice() -> None:
    disc = {"drawn_disc_positions": ["0.2 m"], "drawn_disc_outer_diameter": "150 mm", "drawn_disc_width": "40 mm"}
    assert written(drawn(**disc)) == [
        "rotor.drawn_disc_positions: the bore of disc 1 is 0 mm, and the shaft in it 50 mm | "
        "give the shaft's diameter: its material would count twice"
    ]
    load(drawn(**disc, drawn_disc_inner_diameter="50 mm"))


def test_a_mesh_of_very_many_beams_is_refused() -> None:
    assert written(drawn(longest_element="0.1 mm")) == [
        "rotor.longest_element: makes more than 500 beams of 400 mm | a twelfth of the shaft is the default"
    ]


def test_a_parameter_that_an_option_follows_cannot_be_free() -> None:
    document = drawn(longest_element="$longest")
    document |= {"parameters": {"longest": "25 mm"}, "identify": {"longest": {}}}
    with pytest.raises(RotorsimError) as caught:
        load(document)
    assert str(caught.value) == (
        "error: identify.longest: is followed by the option rotor.longest_element\n\n"
        "hint: free a parameter of the block: options stay as they are"
    )


def test_discs_that_share_material_or_hang_in_the_air_are_mistakes() -> None:
    """A hub and a rim that it carries are none."""
    sizes = {"drawn_disc_width": ["50 mm", "55 mm"], "drawn_disc_outer_diameter": "200 mm"}
    assert written(drawn(drawn_disc_positions=["200 mm", "240 mm"], drawn_disc_inner_diameter="50 mm", **sizes)) == [
        "rotor.drawn_disc_positions: disc 2 and disc 1 share 12.5 mm of the axis | their material would count twice"
    ]
    assert written(drawn(drawn_disc_positions=["150 mm", "250 mm"], drawn_disc_inner_diameter="61 mm", **sizes)) == [
        f"rotor.drawn_disc_positions: the bore of disc {k} is 61 mm, and what is in it 50 mm | "
        "nothing would carry it: give the shaft's diameter, or a sleeve"
        for k in (1, 2)
    ]
    assert load(drawn(drawn_disc_positions=["150 mm", "250 mm"], drawn_disc_inner_diameter="59 mm", **sizes))
    rim = {"drawn_disc_inner_diameter": ["50 mm", "120 mm"], "drawn_disc_outer_diameter": ["120 mm", "200 mm"]}
    assert load(drawn(drawn_disc_positions=["200 mm", "200 mm"], drawn_disc_width="50 mm", **rim))


def test_a_modulus_and_a_density_without_their_units_are_mistakes() -> None:
    """FAULT: a shaft of 210 N/m^2 had natural frequencies, and no word was said. Massless shafts and tungsten are."""
    units = {"young_modulus": [210.0, 2.1e11, 2.1e11], "density": 7.85, "sleeve_density": 7.85e6}
    units["sleeve_young_modulus"] = 210.0
    sleeve = {"sleeve_begins": ["150 mm"], "sleeve_lengths": ["50 mm"], "sleeve_outer_diameter": "60 mm"}
    bore = {"sleeve_inner_diameter": "50 mm", "sleeve_stiffness_share": 0.0}
    assert written(drawn(**units, **sleeve, **bore)) == [
        'rotor.young_modulus: 210 N/m^2 is softer than any shaft | give its unit: "210 GPa"',
        'rotor.density: 7.85 kg/m^3 is the density of no solid | give its unit: "7.85 g/cm^3"',
        'rotor.sleeve_density: 7.85e+06 kg/m^3 is the density of no solid | give its unit: "7.85 g/cm^3"',
        'rotor.sleeve_young_modulus: 210 N/m^2 is softer than any shaft | give its unit: "210 GPa"',
    ]
    for modulus, density in (("210 GPa", "7.85 g/cm^3"), (1e8, 100.0), (2.1e11, 0.1), (4e11, 3e4)):
        assert load(drawn(young_modulus=modulus, density=density))
