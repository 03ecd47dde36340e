"""The key "identify" of a diagram: which parameters are free, within which bounds, with which priors."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorsim.diagram.diagram import Free
from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from tests.diagram.helpers import block, diagram, mistakes, written

BLOCKS = {
    "clock": block("clock", speed="$speed"),
    "unbalance": block("unbalance", mass="2 kg", eccentricity="$eccentricity"),
    "rotor": block("rotor_2dof", mass="2 kg", stiffness="7.6e5 N/m", viscous_damping="76 N s/m"),
    "left": block("support", stiffness=["4e8 N/m", "9e8 N/m"]),
}
WIRES = [
    ("clock.theta", "unbalance.theta"),
    ("clock.speed", "unbalance.speed"),
    ("unbalance.force", "rotor.force"),
    ("rotor.displacement", "left.displacement"),
    ("rotor.velocity", "left.velocity"),
    ("left.force", "rotor.force"),
]
PARAMETERS = {"speed": "1500 rpm", "eccentricity": "24 um", "other": "3 N/m", "two": ["1 m", "2 m"]}


def document(identify, **more):
    return diagram(BLOCKS, *WIRES, parameters=PARAMETERS, identify=identify, **more)


def free(identify, **named) -> dict[str, Free]:
    loaded = load(document(identify), folder=".", **named)
    return {item.name: item for item in loaded.free}


def said(identify, **named) -> list[str]:
    """Return the mistakes of a document written as one entry a line, the key identify on a line of its own."""
    return [line for line in mistakes(written(document(identify)), **named) if "identify" in line]


# --- what is free -----------------------------------------------------------------------------------------------------


def test_names_values_units_and_declared_bounds():
    found = free({"eccentricity": {}, "rotor.viscous_damping": {}, "left.stiffness": {}, "two[2]": {}, "other": {}})
    assert [(item.name, item.base, item.entry, item.value, item.low, item.high) for item in found.values()] == [
        ("eccentricity", "eccentricity", 0, 24e-6, 0.0, np.inf),
        ("rotor.viscous_damping", "rotor.viscous_damping", 0, 76.0, -np.inf, np.inf),
        ("left.stiffness[1]", "left.stiffness", 0, 4e8, 0.0, np.inf),
        ("left.stiffness[2]", "left.stiffness", 1, 9e8, 0.0, np.inf),
        ("two[2]", "two", 1, 2.0, -np.inf, np.inf),
        ("other", "other", 0, 3.0, -np.inf, np.inf),
    ]
    assert [item.unit for item in found.values()][:4] == ["m", "N s/m", "N/m", "N/m"]
    assert all(item.prior_mean is None and item.prior_std is None for item in found.values())


def test_nothing_is_free_unless_said():
    assert load(diagram(BLOCKS, *WIRES, parameters=PARAMETERS), folder=".").free == ()
    assert free({}) == {}


@pytest.mark.parametrize("name", ["left.stiffness[2]", "left.stiffness[ 2 ]"])
def test_one_entry_counted_from_one(name):
    (item,) = free({name: {}}).values()
    assert (item.name, item.entry, item.value) == ("left.stiffness[2]", 1, 9e8)


def test_bounds_are_narrowed():
    found = free(
        {
            "eccentricity": {"low": "1 um", "high": 1e-4},
            "unbalance.phase": {"low": "-90 deg", "high": "90 deg"},
            "left.stiffness": {"high": "1e9 N/m", "description": "of the pedestal"},
        }
    )
    assert (found["eccentricity"].low, found["eccentricity"].high) == (1e-6, 1e-4)
    assert found["unbalance.phase"].low == pytest.approx(-np.pi / 2)
    assert found["left.stiffness[2]"].high == 1e9


def test_a_bound_that_excludes_its_end():
    """mass > 0: the search must not reach zero."""
    (item,) = free({"rotor.mass": {}}).values()
    assert 0 < item.low < 0.1


def test_values_come_from_what_was_set():
    found = free(
        {"rotor.mass": {}, "eccentricity": {"prior": {"std": "10 %"}}},
        set={"rotor.mass": "3 kg", "eccentricity": "40 um"},
    )
    assert found["rotor.mass"].value == 3.0
    assert found["eccentricity"].value == 40e-6
    assert (found["eccentricity"].prior_mean, found["eccentricity"].prior_std) == (40e-6, pytest.approx(4e-6))


@pytest.mark.parametrize(
    ("prior", "mean", "std"),
    [
        ({"std": "1 %"}, 2.0, 0.02),
        ({"std": "5%", "mean": "1900 g"}, 1.9, 0.095),
        ({"std": "20 g"}, 2.0, 0.02),
        ({"std": 0.1, "mean": 2.1}, 2.1, 0.1),
        ({"std": "2.5e1 %"}, 2.0, 0.5),
    ],
)
def test_priors(prior, mean, std):
    (item,) = free({"rotor.mass": {"prior": prior}}).values()
    assert (item.prior_mean, item.prior_std) == (pytest.approx(mean), pytest.approx(std))


def test_a_list_takes_one_prior_for_all_entries():
    found = free({"left.stiffness": {"prior": {"std": "10 %"}}})
    assert [item.prior_std for item in found.values()] == [pytest.approx(4e7), pytest.approx(9e7)]


def test_parameters_of_removed_blocks_are_passed_over():
    found = free({"rotor.mass": {}, "eccentricity": {}, "left.stiffness": {}}, without=["left"])
    assert list(found) == ["rotor.mass", "eccentricity"]


def test_a_diagram_parameter_that_only_a_removed_block_uses():
    """FAULT: it stays free, though nothing depends on it any more."""
    assert list(free({"rotor.mass": {}, "eccentricity": {}}, without=["unbalance"])) == ["rotor.mass"]


# --- mistakes ---------------------------------------------------------------------------------------------------------

FORMAT = "docs/diagrams.md describes the format; `rotorsim blocks TYPE` lists ports and parameters"
QUANTITY = "write a number and a unit, such as '24 um' or '1500 rpm'"
LEAVES = '{} leaves it free; {"low": 0, "prior": {"std": "5 %"}} says more'
PRIOR = 'for example {"mean": "2 kg", "std": "1 %"}; the mean is the value in the diagram unless it is given'
M = "identify.rotor.mass"


@pytest.mark.parametrize(
    ("identify", "expected"),
    [
        ([], f"4:13: identify: must be an object {{...}} | {FORMAT}"),
        (None, f"4:13: identify: must be an object {{...}} | {FORMAT}"),
        (
            {"eccentricty": {}},
            "4:14: identify.eccentricty: no such parameter | did you mean 'eccentricity' or 'unbalance.eccentricity'?",
        ),
        ({"rotor.Mass": {}}, "4:14: identify.rotor.Mass: no such parameter | did you mean 'rotor.mass'?"),
        ({"nowhere.width": {}}, f"4:14: identify.nowhere.width: no such parameter | {FORMAT}"),
        (
            {"unbalance.eccentricity": {}},
            "4:14: identify.unbalance.eccentricity: follows the diagram parameter 'eccentricity' | "
            'write "eccentricity" here',
        ),
        ({"rotor.mass": 3}, f"4:28: {M}: must be an object | {LEAVES}"),
        ({"rotor.mass": True}, f"4:28: {M}: must be an object | {LEAVES}"),
        ({"rotor.mass": {"lo": 1}}, f"4:29: {M}: unknown key 'lo' | did you mean 'low'?"),
        ({"rotor.mass": {"low": "1 m"}}, f"4:36: {M}: unit 'm' does not fit 'kg' | give it in kg"),
        ({"rotor.mass": {"low": "abc"}}, f"4:36: {M}: 'abc' is not a quantity | {QUANTITY}"),
        ({"rotor.mass": {"low": [1, 2]}}, f"4:36: {M}: must be one number | {FORMAT}"),
        (
            {"rotor.mass": {"high": None}},
            f"4:37: {M}: must be a number, not null | write a number, or a text such as '1 kg'",
        ),
        ({"rotor.mass": {"low": 1, "high": 1}}, f"4:28: {M}: low 1 is not below high 1 | {FORMAT}"),
        ({"rotor.mass": {"low": "3 kg"}}, f"4:28: {M}: the value 2 kg is outside its bounds 3 .. inf | {FORMAT}"),
        ({"rotor.mass": {"prior": 3}}, f"4:38: {M}: a prior is an object with 'std' | {PRIOR}"),
        ({"rotor.mass": {"prior": {"mean": 2}}}, f"4:38: {M}: a prior is an object with 'std' | {PRIOR}"),
        ({"rotor.mass": {"prior": {"std": "1 %", "men": 2}}}, f"4:53: {M}: unknown key 'men' | did you mean 'mean'?"),
        ({"rotor.mass": {"prior": {"std": "1 m"}}}, f"4:46: {M}: unit 'm' does not fit 'kg' | give it in kg"),
        ({"rotor.mass": {"prior": {"std": "1e %"}}}, f"4:46: {M}: cannot read '1e %' | {PRIOR}"),
        ({"rotor.mass": {"prior": {"std": 0}}}, f"4:46: {M}: the standard deviation must be positive | {FORMAT}"),
        ({"rotor.mass": {"prior": {"std": "-1 %"}}}, f"4:46: {M}: the standard deviation must be positive | {FORMAT}"),
        (
            {"rotor.mass": {"prior": {"std": "1 %", "mean": 0}}},
            f"4:46: {M}: the standard deviation must be positive | {FORMAT}",
        ),
        (
            {"left.stiffness": {}, "left.stiffness[1]": {}},
            f"4:36: identify.left.stiffness[1]: 'left.stiffness[1]' is named twice | {FORMAT}",
        ),
    ],
)
def test_mistakes(identify, expected):
    assert said(identify) == [expected]


@pytest.mark.parametrize("name", ["left.stiffness[0]", "left.stiffness[3]", "left.stiffness[1,1]", "rotor.mass[1]"])
def test_entries_that_there_are_not(name):
    (line,) = said({name: {}})
    assert line.startswith(f"4:14: identify.{name}: no such entry; the parameter is ")


@pytest.mark.parametrize(
    "name",
    [
        "",
        ".",
        "rotor",
        "rotor.",
        "[1]",
        "left.stiffness[]",
        "left.stiffness[a]",
        "rotor.mass\n",
        "clock.profile",
        "left.stiffness[99999999999999999999]",
        "x" * 5000,
    ],
)
def test_names_that_are_none(name):
    (line,) = said({name: {}})
    assert "no such parameter" in line


def test_all_mistakes_at_once():
    lines = said({"rotor.mas": {}, "eccentricity": {"low": "1 kg", "high": "x", "prior": {"sd": 1}}, "other": 3})
    assert [line.partition(" | ")[0].split(": ")[1:] for line in lines] == [
        ["identify.rotor.mas", "no such parameter"],
        ["identify.eccentricity", "unit 'kg' does not fit 'm'"],
        ["identify.eccentricity", "'x' is not a quantity"],
        ["identify.eccentricity", "a prior is an object with 'std'"],
        ["identify.other", "must be an object"],
    ]


def test_mistakes_beside_a_wrong_wire():
    """FAULT: with any mistake in blocks or wires those under identify are not said until it is cured."""
    data = document({"rotor.mas": {}})
    data["wires"].append(["rotor.displacment", "left.displacement"])
    assert any("identify.rotor.mas" in line for line in mistakes(written(data)))


# --- what should be mistakes, too -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "identify", [{"rotor.mass": {"low": -5}}, {"rotor.mass": {"low": 0}}, {"eccentricity": {"low": "-1 um"}}]
)
def test_bounds_cannot_be_wider_than_the_block_allows(identify):
    """FAULT: a mass may be identified as -5 kg: the declared bound is replaced, not narrowed."""
    try:
        (item,) = free(identify).values()
    except RotorsimError:
        return
    assert item.low >= 0
    assert item.low > 0 or item.base != "rotor.mass"


@pytest.mark.parametrize(
    "identify",
    [
        {"rotor.mass": {"prior": {"mean": "-3 kg", "std": "1 kg"}}},
        {"rotor.mass": {"high": "3 kg", "prior": {"mean": "5 kg", "std": "1 %"}}},
        {"rotor.mass": {"prior": {"std": "1e400 %"}}},
        {"rotor.mass": {"prior": {"std": "1e308 %"}}},
        {"rotor.mass": {"description": 3}},
        {"speed": {}},
    ],
)
def test_what_makes_no_sense_is_refused(identify):
    """FAULT: a prior far outside the bounds, one of infinite width, a description that is no text, the speed (which
    is measured) are taken as they are.
    """
    assert said(identify) != []


def test_a_speed_is_what_a_clock_follows_whatever_its_name():
    """FAULT: a belt whose parameter is called speed cannot be identified, and a shaft's speed of another name can."""
    blocks = {"drive": block("constant"), "belt": block("gain", gain="$speed")}
    wire = ("drive.output", "belt.input")
    belt = diagram(blocks, wire, parameters={"speed": 0.5}, identify={"speed": {}})
    assert [item.name for item in load(belt, folder=".").free] == ["speed"]
    turning = {**BLOCKS, "clock": block("clock", speed="$omega")}
    shaft = diagram(turning, *WIRES, parameters={"omega": "1500 rpm", "eccentricity": "24 um"}, identify={"omega": {}})
    [wrong] = [line for line in mistakes(written(shaft)) if "identify" in line]
    assert "identify.omega: is measured, so that it cannot be free" in wrong


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-10, 10)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.sampled_from(["1 kg", "5 %", "x", "", "-3 um", "1e3 N/m", "%", "1 %%"]),
    lambda inner: (
        st.lists(inner, max_size=2)
        | st.dictionaries(
            st.sampled_from(["low", "high", "prior", "std", "mean", "description", "x"]), inner, max_size=3
        )
    ),
    max_leaves=5,
)
names = st.sampled_from(
    ["rotor.mass", "eccentricity", "left.stiffness", "left.stiffness[1]", "two[1]", "rotor.x", "speed"]
)


@pytest.mark.slow
@given(st.dictionaries(names, json_values, max_size=3))
def test_whatever_is_written_is_read_or_refused(identify):
    data = json.loads(json.dumps(document(identify)))
    try:
        found = load(data, folder=".").free
    except RotorsimError as error:
        expected = any("identify" in problem.subject for problem in error.problems)
    else:
        expected = all(item.low <= item.value <= item.high and item.low < item.high for item in found)
    assert expected
