"""Wrong diagrams: every mistake at once, with its place, in these very words, and the cure."""

from typing import Any

import pytest

from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from tests.diagram.helpers import block, diagram, mistakes, written

DOCS = "docs/diagrams.md describes the format; `rotorsim blocks TYPE` lists ports and parameters"


def test_the_keys_of_a_document() -> None:
    text = """{
  "blocks": {"c": {"type": "constant", "vlaue": 1, "parameter": {}}},
  "wire": [],
  "schema_version": 2,
  "algebraic_loops": "maybe",
  "name": 3,
  "layout": {"d": [0, 0], "c": [1]}
}"""
    assert mistakes(text) == [
        "2:40: c: unknown key 'vlaue' | parameters of the block go into \"parameters\": {...}",
        "2:52: c: unknown key 'parameter' | did you mean 'parameters'?",
        "3:3: : unknown key 'wire' | did you mean 'wires'?",
        "4:21: : schema_version 2 is not known | this version of rotorsim reads schema_version 1",
        "5:22: : algebraic_loops is 'maybe' | it is 'refuse' or 'solve'",
        f"6:11: name: must be a text | {DOCS}",
        "7:14: warning: layout.d: no block 'd' | known: c",
        "7:32: layout.c: must be two numbers | write [column, row]",
    ]


def test_the_form_and_names_of_blocks() -> None:
    text = """{"blocks": {
  "1a": {"type": "constant"},
  "solver": {"type": "constant"},
  "b": [],
  "c": {},
  "d": {"type": 3},
  "e": {"type": "constent"}
}, "wires": [["b.output", "c.input"], ["d.output", "e.input"]]}"""
    assert mistakes(text) == [
        "2:3: blocks: '1a' is not a name | names are letters, digits and _, and do not start with a digit",
        "3:3: solver: 'solver' is reserved | 'solver' would not be told from the settings in --set solver.step=...",
        '4:8: b: must be an object {"type": ...} | for example {"type": "gain"}',
        '5:8: c: key \'type\' is missing | "type": "gain"; `rotorsim blocks` lists the types',
        f"6:17: d: 'type' must be a text | {DOCS}",
        "7:17: e: unknown block type 'constent' | did you mean 'constant'?",
    ]


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ({}, [': : key \'blocks\' is missing | "blocks": {"name": {"type": "..."}}']),
        ({"blocks": {}}, [": : the diagram has no blocks | see `rotorsim blocks`"]),
        ("[1]", [f"1:1: : a diagram is a JSON object {{...}} | {DOCS}"]),
        ("", ['1:1: : file is empty | a diagram is a JSON object: {"blocks": {...}, "wires": [...]}']),
        ("{", ["1:2: : not valid JSON: file ends too early | a bracket is not closed"]),
    ],
)
def test_a_document_without_a_diagram(document: Any, expected: list[str]) -> None:
    assert mistakes(document) == expected


def test_what_is_no_document_at_all() -> None:
    with pytest.raises(RotorsimError, match="a diagram is a file, a name or a mapping, not list"):
        load([])  # type: ignore[arg-type]
    with pytest.raises(RotorsimError, match="did you mean 'jeffcott'"):
        load("jefcott")
    with pytest.raises(RotorsimError, match="file does not exist"):
        load("nothing.json")


def test_parameters_of_blocks() -> None:
    document = diagram(
        {
            "r": block("rotor_2dof", mas="1 kg", stiffness="5 N", viscous_damping=1.0),
            "k": block("constant", value=[[1, "2"], [3]]),
            "e": block("constant", value=[]),
            "q": block("constant", value=None),
            "b": block("constant", value=True),
            "s": block("sum", signs=3),
            "t": block("trigonometric", function="sine"),
            "c": block("clock", speed="1500 rmp"),
        }
    )
    found = [text for text in mistakes(document) if "not wired" not in text]
    assert found == [
        ": r: unknown parameter 'mas' | did you mean 'mass'?",
        ": r.stiffness: unit 'N' does not fit 'N/m' | give it in N/m",
        f": k.value: the rows of the list differ in length | {DOCS}",
        f": e.value: the list is empty | {DOCS}",
        ": q.value: must be a number, not null | write a number",
        ": b.value: must be a number, not true | write a number",
        f": s.signs: must be a text, not the number 3 | {DOCS}",
        ": t.function: 'sine' is not a choice | did you mean 'sin' or 'arcsin'?",
        ": c.speed: unknown unit 'rmp' | did you mean 'rpm'?",
    ]


def test_a_value_inside_a_list_is_placed() -> None:
    text = '{"blocks": {"c": {"type": "constant", "parameters": {"value": [\n 1,\n "2 x"]}}}}'
    assert [m.split(" | ")[0] for m in mistakes(text)] == ["3:2: c.value: unknown unit 'x'"]


def test_missing_parameters_say_what_is_expected() -> None:
    assert mistakes(diagram({"c": "constant", "s": "linear_system"}, ("c.output", "s.input"))) == [
        ": s: parameter 'A' is missing | write \"A\": a list of rows [[...], ...]",
        ": s: parameter 'B' is missing | write \"B\": a list of rows [[...], ...]",
        ": s: parameter 'C' is missing | write \"C\": a list of rows [[...], ...]",
    ]


def test_references_to_diagram_parameters() -> None:
    document = diagram(
        {
            "c": "constant",
            "g": block("gain", gain="$k"),
            "crack": block("crack", stiffness="$kk"),
            "r": block("rotor_2dof", mass="$kk", stiffness="$kc"),
        },
        ("c.output", "g.input"),
        ("c.output", "crack.theta"),
        parameters={"kk": "3 N/m", "kc": "5 N/mmm", "unused": 3, "chain": "$kk"},
    )
    assert mistakes(document) == [
        ": g.gain: no diagram parameter 'k' | did you mean 'kk' or 'kc'?",
        ": kk: is used in N/m by crack.stiffness and in kg by r.mass | use two diagram parameters",
        ": kc: unknown unit 'mmm' in 'N/mmm' | did you mean 'mm'?",
        ': warning: unused: diagram parameter is not used | refer to it as "$unused"',
        ': warning: chain: diagram parameter is not used | refer to it as "$chain"',
        ": chain: '$kk' is not a quantity | write a number and a unit, such as '24 um' or '1500 rpm'",
    ]


def test_ends_of_wires() -> None:
    text = written(
        diagram(
            {"a": "constant", "g": "gain", "h": "gain", "r": "rotor_2dof", "m": "gain"},
            ("a.output", "g.input"),
            ("a.output", "g.input"),
            ("g.input", "a.output"),
            ("g.outptu", "h.input"),
            ("q.output", "h.input"),
            ("a", "h.input"),
            ("a.output", "h.output"),
            ("r.force", "h.input"),
            ("r.displacement[0]", "g.input"),
            ("a.output", "m.input[1]"),
        )
    ).replace("], [", "],\n [")
    assert mistakes(text) == [
        "3:2: g.input: input is wired twice: from a.output at d.json:2:11, and from a.output "
        "| add the signals with a sum block, or remove one wire",
        "4:2: g.input -> a.output: the wire runs backwards: 'input' is an input and 'output' an output "
        '| write ["a.output", "g.input"]',
        "5:3: g.outptu: block type 'gain' has no output 'outptu' | did you mean 'output'?",
        "6:3: q.output: no block 'q' | known: a, g, h, m, r",
        "7:3: wires[6]: 'a' is not a port | write 'block.port', or 'block.port[i]' counted from 1",
        "8:15: h.output: 'output' is an output | wires run from an output to an input; inputs: input",
        "9:3: r.force: 'force' is an input | wires run from an output to an input; outputs: displacement, velocity",
        "10:3: wires[9]: 'r.displacement[0]' is not a port | write 'block.port', or 'block.port[i]' counted from 1",
        "11:15: m.input[1]: an input that takes one wire cannot be wired by parts "
        "| put the parts together with a mux block",
    ]


def test_malformed_wires() -> None:
    document = {"blocks": {"a": {"type": "constant"}}, "wires": [["a.output"], "x", [1, 2]]}
    assert mistakes(document) == [
        ': wires[1]: a wire is a list of two ports | write ["block.output", "block.input"]',
        ': wires[2]: a wire is a list of two ports | write ["block.output", "block.input"]',
        ": wires[3]: this is not a port | write 'block.port', or 'block.port[i]' counted from 1",
    ]


def test_indices_of_wires() -> None:
    document = diagram(
        {"a": "constant", "r": "rotor_2dof", "g": "gain", "h": "gain"},
        ("a.output", "r.force[3]"),
        ("r.displacement[1,1]", "g.input"),
        ("r.displacement[7]", "h.input"),
    )
    assert mistakes(document) == [
        ": r.force[3]: index 3 is out of range | shape is (2,), counted from 1",
        ": r.displacement[1,1]: shape is (2,): too many indices | entries count from 1, one index a dimension",
        ": r.displacement[7]: index 7 is out of range | shape is (2,), counted from 1",
    ]


def test_shapes_that_differ_name_both_ends_and_the_cure() -> None:
    document = diagram(
        {
            "v": block("constant", value=[1, 2, 3]),
            "r": "rotor_2dof",
            "fe": "rotor_fe",
            "p": "pid",
            "c": "clock",
            "a": "amb",
            "t": "transfer_function",
            "crack": "crack",
        },
        ("v.output", "r.force"),
        ("c.speed", "fe.speed"),
        ("fe.displacement", "p.displacement"),
        ("a.force", "fe.force"),
        ("r.displacement", "a.displacement"),
        ("p.current", "a.current"),
        ("v.output", "t.input"),
        ("crack.opening", "r.force"),
        ("c.theta", "crack.theta"),
    )
    assert mistakes(document) == [
        ": v.output -> r.force: shapes differ: v.output: (3,), but r.force: (2,) [N] "
        "| take some entries with a selector block, or stack signals with a mux block",
        ": fe.displacement -> p.displacement: shapes differ: fe.displacement: (6, 2) [m], but p.displacement: (2,) [m] "
        '| take a part: "fe.displacement[1]" (counted from 1)',
        ": a.force -> fe.force: shapes differ: a.force: (2,) [N], but fe.force: (6, 2) [N] "
        '| name the part that it adds to: "fe.force[1]" (counted from 1)',
        ": v.output -> t.input: shapes differ: v.output: (3,), but t.input: scalar "
        '| take a part: "v.output[1]" (counted from 1)',
        ": crack.opening -> r.force: shapes differ: crack.opening: scalar, but r.force: (2,) [N] "
        '| name the part that it adds to: "r.force[1]" (counted from 1)',
        ": crack.opening -> r.force: units differ: crack.opening [1], but r.force [N] | crack.force is in N",
    ]


def test_units_that_differ() -> None:
    document = diagram(
        {"r": "rotor_2dof", "a": "amb", "c": "clock", "u": "unbalance"},
        ("r.displacement", "a.displacement"),
        ("r.velocity", "a.current"),
        ("c.speed", "u.theta"),
        ("c.theta", "u.speed"),
        ("a.force", "r.force"),
    )
    assert mistakes(document) == [
        ": r.velocity -> a.current: units differ: r.velocity [m/s], but a.current [A] "
        "| wire a signal in A, or convert it with a gain block",
        ": c.speed -> u.theta: units differ: c.speed [rad/s], but u.theta [rad] | c.theta is in rad",
        ": c.theta -> u.speed: units differ: c.theta [rad], but u.speed [rad/s] | c.speed is in rad/s",
    ]


def test_an_angle_wired_to_a_number_is_a_warning() -> None:
    document = diagram(
        {"k": "crack", "c": "clock", "u": "unbalance"},
        ("c.theta", "k.theta"),
        ("k.opening", "u.theta"),
        ("c.speed", "u.speed"),
    )
    assert mistakes(document) == [
        ": warning: k.opening -> u.theta: units differ: k.opening [1], but u.theta [rad] | convert it with a gain block"
    ]


def test_inputs_that_are_not_wired_name_a_wire_that_would_do() -> None:
    assert mistakes(diagram({"r": "rotor_2dof", "a": "amb", "p": "pid", "k": "crack", "g": "gain"})) == [
        ': a.displacement: input is not wired | add the wire ["r.displacement", "a.displacement"]',
        ': a.current: input is not wired | add the wire ["p.current", "a.current"]',
        ': p.displacement: input is not wired | add the wire ["r.displacement", "p.displacement"]',
        ': k.theta: input is not wired | add the wire ["block.output", "k.theta"] from an output in rad',
        ': g.input: input is not wired | add the wire ["block.output", "g.input"]',
    ]


def test_settings_of_the_solver() -> None:
    settings = {"method": "rk5", "step": "0 s", "stop": "1 m", "record_every": 1.5, "rtol": 2, "x": 1}
    assert mistakes(diagram({"c": "constant"}, solver=settings)) == [
        ": solver.method: unknown method 'rk5' | did you mean 'rk45' or 'rk4'?",
        ": solver.step: must be one positive number | the default is 0.0001",
        ": solver.stop: unit 'm' does not fit 's' | give it in s",
        ": solver.record_every: must be a whole number | 1 records every step",
        ": solver.x: unknown key 'x' | known: atol, method, record_every, rtol, step, stop",
        ": solver.rtol: must be at most 0.001 | errors of steps add up; the default is 1e-08",
    ]
    assert mistakes(diagram({"c": "constant"}, solver={"step": "2 s", "stop": "1 s"})) == [
        ": solver: step 2 s is longer than stop 1 s | choose a smaller step"
    ]


def test_recorded_signals() -> None:
    names = ["c.outputt", "x.y", "r.displacement[3]", "r.force", "c", "r.displacement[1,1]", 3, "r.displacement[2]"]
    assert mistakes(diagram({"c": "constant", "r": "rotor_2dof"}, record=names)) == [
        ": record: 'c' is not a signal | write 'block.port'",
        ": record: this is not a signal | write 'block.port'",
        ": c.outputt: block type 'constant' has no output 'outputt' | did you mean 'output'?",
        ": x.y: no block 'x' | known: c, r",
        ": r.displacement[3]: index 3 is out of range | shape is (2,), counted from 1",
        ": r.displacement[1,1]: shape is (2,): too many indices | entries count from 1, one index a dimension",
    ]


def test_names_of_ports_that_options_give() -> None:
    document = diagram({"c": "constant", "b": block("bus", names=["a", "a", "1x"])}, ("c.output", "b.a"))
    assert [m for m in mistakes(document) if "not wired" not in m] == [
        ": b: 'a' cannot be the name of a port | each name once; letters, digits and _, not a digit first",
        ": b: '1x' cannot be the name of a port | each name once; letters, digits and _, not a digit first",
    ]


def test_settings_from_outside() -> None:
    settings = {
        "speedd": "25 Hz",
        "rotorr.mass": 2,
        "rotor.mas": "3",
        "controller.KP": "3 V",
        "solver.stepp": 1,
        "speed": "3 kg",
        "solver.step": "-1 s",
    }
    with pytest.raises(RotorsimError) as error:
        load("jeffcott", set=settings)
    assert [str(problem).replace("\n\nhint: ", " | ") for problem in error.value.problems] == [
        "--set: error: speedd: no diagram parameter 'speedd' | did you mean 'speed'?",
        "--set: error: rotorr: no block 'rotorr' | did you mean 'rotor'?",
        "--set: error: speed: unit 'kg' does not fit 'rad/s' "
        "| give an angular speed in rad/s, rpm or Hz (revolutions per second)",
        "--set: error: rotor: unknown parameter 'mas' | did you mean 'mass'?",
        "--set: error: controller.KP: unit 'V' does not fit 'A/m' | give it in A/m",
        "--set: error: solver.step: must be one positive number | the default is 0.0001",
        "--set: error: solver.stepp: unknown key 'stepp' | did you mean 'step' or 'stop'?",
    ]
    with pytest.raises(RotorsimError) as error:
        load("jeffcott", without=["ambb"])
    assert str(error.value) == "--without: error: ambb: no block 'ambb'\n\nhint: did you mean 'amb'?"
