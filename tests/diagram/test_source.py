"""Reading JSON: limits, exact messages with their places, and positions of every key and value."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorsim.diagram.parse.source import MAX_DEPTH, MAX_DIAGRAM_BYTES, parse_document, read_document
from rotorsim.errors import Place, RotorsimError


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", '1:1: error: file is empty | a diagram is a JSON object: {"blocks": {...}, "wires": [...]}'),
        ('{"a": 1,}', "1:8: error: not valid JSON: comma before '}' | remove the comma"),
        ("[1,\n]", "1:3: error: not valid JSON: comma before ']' | remove the comma"),
        ("[1,,2]", "1:4: error: not valid JSON: comma before ',' | remove the comma"),
        ('{"a": 1\n "b": 2}', "1:8: error: not valid JSON: comma or closing bracket expected | a comma is missing?"),
        ("{'a': 1}", '1:2: error: not valid JSON: single quotes | write texts in double quotes "..."'),
        ('{"a": // x\n 1}', '1:7: error: not valid JSON: comment | JSON has no comments; use a "description"'),
        ('{\n  # x\n "a": 1}', '2:3: error: not valid JSON: comment | JSON has no comments; use a "description"'),
        ("{a: 1}", "1:2: error: not valid JSON: key expected | write keys in double quotes"),
        ('{"a": True}', "1:7: error: not valid JSON: value expected, found 'True' | write true"),
        ('{"a": None}', "1:7: error: not valid JSON: value expected, found 'None' | write null"),
        ("[foo]", "1:2: error: not valid JSON: value expected, found 'foo' | write texts in double quotes \"...\""),
        ("[1, 2", "1:6: error: not valid JSON: file ends too early | a bracket is not closed"),
        ('{"a": "x', '1:7: error: not valid JSON: text is not closed | close it with "'),
        (
            '{"a": 1}}',
            "1:9: error: not valid JSON: something follows the end of the document | a bracket is closed too early?",
        ),
        ('{"a" 1}', "1:6: error: not valid JSON: ':' expected after the key | write \"key\": value"),
        (
            '"a\nb"',
            "1:3: error: not valid JSON: line break or control character in a text "
            '| close the text with ", or write \\n',
        ),
        ('{"a": "C:\\x"}', "1:10: error: not valid JSON: wrong escape in a text | write \\\\ for a backslash"),
        ('{"a": 1e400}', "1:7: error: number 1e400 is too large | numbers must be finite"),
        ('{"a": -Infinity}', "1:7: error: -Infinity is not allowed | numbers must be finite"),
        ('{"a": ' + "9" * 400 + "}", "1:7: error: number of 400 digits is too long | numbers must fit a float"),
    ],
)
def test_what_is_no_json_is_refused_with_place_and_cure(text: str, message: str) -> None:
    with pytest.raises(RotorsimError) as error:
        parse_document(text, "d.json")
    assert str(error.value).replace("\n\nhint: ", " | ") == "d.json:" + message


def test_half_a_character_is_refused_and_a_whole_one_is_not() -> None:
    assert parse_document('["\\ud83d\\ude00"]', "f.json").data == ["\N{GRINNING FACE}"]
    with pytest.raises(RotorsimError) as error:
        parse_document('{"a": ["b",\n "\\ud83d"], "\\uDE00": 1}', "f.json")
    assert [str(problem) for problem in error.value.problems] == [
        "f.json:2:2: error: half a character (\\ud800 to \\udfff)\n\nhint: write the character itself",
        "f.json:2:13: error: half a character (\\ud800 to \\udfff)\n\nhint: write the character itself",
    ]


def test_all_doubtful_numbers_and_keys_are_found_at_once() -> None:
    text = '{\n  "a": NaN,\n  "b": {"c": 1, "c": 2},\n  "d": [1, 1e999],\n  "a": 3\n}'
    with pytest.raises(RotorsimError) as error:
        parse_document(text, "d.json")
    assert [(str(p.place), p.what) for p in error.value.problems] == [
        ("d.json:2:8", "NaN is not allowed"),
        ("d.json:3:17", "key 'c' is given twice"),
        ("d.json:4:12", "number 1e999 is too large"),
        ("d.json:5:3", "key 'a' is given twice"),
    ]


def test_nesting_is_limited_before_it_can_harm() -> None:
    fine = "[" * MAX_DEPTH + "]" * MAX_DEPTH
    assert json.dumps(parse_document(fine).data) == fine
    for text in ("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "[" * 2_000_000, '{"a":' * 100_000):
        with pytest.raises(RotorsimError, match="JSON is nested deeper than 64 levels"):
            parse_document(text, "d.json")
    assert parse_document(json.dumps(["[" * 100, '\\"[[' * 100])).data[0] == "[" * 100  # brackets in texts do not count


def test_hostile_quotes_take_linear_time() -> None:
    with pytest.raises(RotorsimError, match="text is not closed"):
        parse_document('{"a": "' + '\\"' * 2_000_000, "d.json")


def test_files_are_read_with_limits(tmp_path: Path) -> None:
    def refused(path: Path) -> str:
        with pytest.raises(RotorsimError) as error:
            read_document(path)
        return str(error.value).replace(str(tmp_path), "T")

    big = tmp_path / "big.json"
    big.write_bytes(b" " * (MAX_DIAGRAM_BYTES + 1))
    assert refused(big) == "T/big.json: error: file is larger than 20 MB\n\nhint: split it by sub-diagrams"
    latin = tmp_path / "latin.json"
    latin.write_bytes(b'{\n "a": "\xe9"}')
    assert refused(latin) == "T/latin.json:2:8: error: file is not UTF-8 text\n\nhint: save it as UTF-8"
    assert refused(tmp_path) == "T: error: file is a folder"
    assert refused(tmp_path / "none.json") == "T/none.json: error: file does not exist"
    assert "T/x" in refused(tmp_path / ("x" * 5000))


def test_a_byte_order_mark_is_no_mistake(tmp_path: Path) -> None:
    file = tmp_path / "bom.json"
    file.write_bytes(b"\xef\xbb\xbf" + b'{"a": 1}')
    assert read_document(file).data == {"a": 1}


TEXT = st.text(st.characters(exclude_categories=("Cc", "Cf", "Cs", "Cn"), include_characters="\n\t"))
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | TEXT,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4),
    max_leaves=25,
)


@pytest.mark.slow
@given(JSON, st.sampled_from([None, 1, 3]), st.booleans())
def test_every_value_and_key_is_found_where_it_is_written(data: Any, indent: int | None, ascii_only: bool) -> None:
    text = json.dumps(data, indent=indent, ensure_ascii=ascii_only)
    source = parse_document(text, "d.json")
    assert source.data == data
    lines = text.split("\n")

    def check(value: Any, path: tuple[Any, ...]) -> None:
        place = source.locate(path)
        rest = "\n".join([lines[place.line - 1][place.column - 1 :], *lines[place.line :]])
        assert json.JSONDecoder().raw_decode(rest)[0] == value
        if path and isinstance(path[-1], str):
            place = source.locate(path, key=True)
            assert json.JSONDecoder().raw_decode(lines[place.line - 1][place.column - 1 :])[0] == path[-1]
        items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, item in items:
            check(item, (*path, key))

    check(data, ())


def test_a_place_looked_up_late_is_a_place() -> None:
    source = parse_document('{\n "a": [1, 2]}', "d.json")
    late = source.place(("a", 1))
    assert late == Place("d.json", 2, 11)
    assert hash(late) == hash(Place("d.json", 2, 11))
    assert Place("d.json", 2, 11) == late
    assert str(late) == "d.json:2:11"
    assert (
        source.locate(("a", 7)) == source.locate(("a",)) == Place("d.json", 2, 7)
    )  # what is missing is where it belongs
