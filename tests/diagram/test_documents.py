"""Tools on documents: canonical form, differences, swapping, schema, drawing."""

import copy
import json
import xml.etree.ElementTree as ET

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rotorsim.diagram.diff import diff
from rotorsim.diagram.draw import draw_svg
from rotorsim.diagram.edit import fitting_types, swap
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.diagram.resolve.resolution import shipped_diagrams
from rotorsim.diagram.schema import json_schema
from rotorsim.errors import RotorsimError
from rotorsim.model.load import load

DOCUMENTS = {name: json.loads(file.read_text(encoding="utf-8")) for name, file in shipped_diagrams().items()}
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)
KEYS = ["name", "blocks", "wires", "parameters", "layout", "record", "solver", "other"]


@pytest.mark.slow
@settings(max_examples=80, deadline=None)
@given(st.dictionaries(st.sampled_from(KEYS), JSON, max_size=6))
def test_the_canonical_form_keeps_the_meaning_and_is_its_own_canonical_form(data):
    text = format_document(data)
    assert json.loads(text) == data
    assert format_document(json.loads(text)) == text


@pytest.mark.parametrize("name", sorted(DOCUMENTS))
def test_shipped_diagrams_are_canonical(name):
    assert shipped_diagrams()[name].read_text(encoding="utf-8") == format_document(DOCUMENTS[name])


@pytest.mark.parametrize("name", sorted(DOCUMENTS))
def test_a_diagram_does_not_differ_from_itself_in_another_order_and_other_units(name):
    data = DOCUMENTS[name]
    other = copy.deepcopy(data)
    other["wires"].reverse()
    other["blocks"] = dict(reversed(other["blocks"].items()))
    other["layout"] = {}
    other["solver"]["step"] = load(name).solver.step
    assert diff(data, other) == []
    assert [c.where.partition(".")[0] for c in diff(data, other, layout=True)] == ["layout"] * len(data["layout"])


def test_every_change_is_named_by_its_place():
    data = DOCUMENTS["jeffcott"]
    other = copy.deepcopy(data)
    other["blocks"]["rotor"]["parameters"]["mass"] = "3 kg"
    other["blocks"]["crack"]["parameters"]["sag"] = 2.6e-5
    other["blocks"]["amb"]["type"] = "amb_nonlinear"
    other["blocks"]["extra"] = {"type": "gain"}
    del other["blocks"]["reference"]
    other["wires"] = [w for w in other["wires"] if "reference" not in "".join(w)] + [["clock.theta", "extra.input"]]
    other["parameters"]["speed"] = "1600 rpm"
    assert [str(change) for change in diff(data, other)] == [
        "~ parameters.speed: 1500 rpm -> 1600 rpm",
        "~ blocks.rotor.parameters.mass: 2 kg -> 3 kg",
        "~ blocks.amb.type: amb -> amb_nonlinear",
        '- blocks.reference: {"type": "reference", "parameters": {"harmonics": [-5, -3, -1, 0, 1, 2, 3, 5, 7]}}',
        '+ blocks.extra: {"type": "gain"}',
        "- wires: clock.theta -> reference.theta",
        "- wires: reference.signal -> bus.reference",
        "+ wires: clock.theta -> extra.input",
    ]


def test_a_default_written_out_is_no_difference():
    data = DOCUMENTS["jeffcott"]
    other = copy.deepcopy(data)
    other["blocks"]["controller"]["parameters"]["derivative_time_constant"] = "0.1 ms"
    assert diff(data, other) == []


@pytest.mark.parametrize("name", ["jeffcott", "offset_disc", "fe_rigid", "fe_flexible"])
def test_controllers_take_the_place_of_one_another(name):
    fits = fitting_types(DOCUMENTS[name], "controller")
    expected = ["pid", "pd", "lead_lag", "state_feedback", "state_space", "discrete_pid", "notch_pid"]
    assert set(expected) <= set(fits)
    swapped = swap(DOCUMENTS[name], "controller", "pd")
    assert swapped["blocks"]["controller"] == {"type": "pd", "parameters": {"KP": "12200 A/m", "KD": "3 A s/m"}}
    assert swapped["wires"] == DOCUMENTS[name]["wires"]
    load(swapped)


def test_a_swap_that_does_not_fit_says_which_ports_and_what_would_fit():
    with pytest.raises(RotorsimError) as caught:
        swap(DOCUMENTS["jeffcott"], "amb", "unbalance")
    fits = "\n\nhint: types that fit: amb_actuator, amb_nonlinear, magnetic_saturation"
    assert [str(problem) for problem in caught.value.problems] == [
        f"error: amb.displacement: type 'unbalance' has no input 'displacement', which is wired{fits}",
        f"error: amb.current: type 'unbalance' has no input 'current', which is wired{fits}",
        f"error: amb.theta: type 'unbalance' needs input 'theta', which is not wired{fits}",
        f"error: amb.speed: type 'unbalance' needs input 'speed', which is not wired{fits}",
    ]
    with pytest.raises(RotorsimError) as caught:
        swap(DOCUMENTS["jeffcott"], "controler", "pd")
    assert str(caught.value.problems[0]) == (
        "error: controler: no block 'controler'\n\nhint: did you mean 'controller'?"
    )


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if "elementary" in n else n for n in sorted(DOCUMENTS)]
)
def test_shipped_diagrams_fit_the_schema_and_misspelt_ones_do_not(name):
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(json_schema())
    assert list(validator.iter_errors(DOCUMENTS[name])) == []
    for block, content in DOCUMENTS[name]["blocks"].items():  # alone: the schema takes each block by itself
        wrong = {**content, "parameters": {**content.get("parameters", {}), "harmonic": [1]}}
        assert not validator.is_valid({**DOCUMENTS[name], "blocks": {block: wrong}}), block


@pytest.mark.parametrize("name", sorted(DOCUMENTS))
def test_a_drawing_is_well_formed_and_names_every_block_and_index(name):
    text = draw_svg(load(name), highlight={list(DOCUMENTS[name]["blocks"])[-1]: "#ff0000"})
    root = ET.fromstring(text)
    words = [element.text for element in root.iter("{http://www.w3.org/2000/svg}text")]
    for block in DOCUMENTS[name]["blocks"]:
        assert block in words
    indices = sum("[" in end for wire in DOCUMENTS[name]["wires"] for end in wire)
    assert sum(str(word).startswith("[") for word in words) == indices
    assert text.count('stroke="#ff0000"') == 1


def test_signs_and_functions_of_elementary_blocks_are_shown():
    text = draw_svg(load("jeffcott_elementary"))
    words = [element.text for element in ET.fromstring(text).iter("{http://www.w3.org/2000/svg}text")]
    assert words.count("trigonometric: cos") == 7
    blocks = DOCUMENTS["jeffcott_elementary"]["blocks"].values()
    signs = "".join(b["parameters"]["signs"] for b in blocks if b["type"] == "sum")
    assert words.count("\N{MINUS SIGN}") == signs.count("-")
    assert words.count("+") == signs.count("+")


def test_blocks_without_a_layout_are_drawn_apart_and_feedback_goes_back():
    data = {**DOCUMENTS["jeffcott"], "layout": {}, "name": "a < b & c"}
    text = draw_svg(load(data))
    root = ET.fromstring(text)
    boxes = {
        (float(r.get("x", 0)), float(r.get("y", 0)))
        for r in root.iter("{http://www.w3.org/2000/svg}rect")
        if r.get("x") is not None
    }
    assert len(boxes) == len(data["blocks"])
    assert "a &lt; b &amp; c" in text
