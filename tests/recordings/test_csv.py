"""CSV: what instruments write is read to the last digit; mistakes have their line and column."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rotorsim.errors import Problem, RotorsimError
from rotorsim.recordings.readers.columns import read_columns
from tests.recordings.made import CHANNELS
from tests.recordings.tables import refused, write_csv


@pytest.mark.parametrize(
    "text",
    [
        "x,y\n1,2\n3,4\n",
        "x,y\n1,2\n3,4",
        "x,y\r\n1,2\r\n3,4\r\n",
        "\ufeffx,y\n1,2\n3,4\n",
        " x , y \n 1 , 2\n 3, 4\n",
        '"x","y"\n1,2\n3,4\n',
        'x,"y"\n"1","2"\n3,4\n',
        "# made by an instrument\n\n# 2 channels\nx,y\n# data\n1,2\n\n3,4 # last\n\n",
        "# x, y\n1,2\n3,4\n",
        "# made by np.savetxt\n# x,y\n1,2\n3,4\n",
        "x;y\n1;2\n3;4\n",
        "x;y\n1,0;2,0\n3,0;4e0\n",
        "x\ty\n1\t2\n3\t4\n",
        "x,note,y\n1,good,2\n3,,4\n",
        'x,note,y\n1,"a, b",2\n3,"",4\n',
        "x;note;y\n1,0;a;2\n3;b,c;4\n",
        "x,y,\n1,2,\n3,4,\n",
        "x,y\n1,2,\n3,4,\n",
        "y,z,z,x\n2,0,0,1\n4,0,0,3\n",
        "x,y\n+1.0e0,2.\n.3e1,4\n",
    ],
)
def test_csv_as_instruments_write_it(tmp_path, text):
    path = tmp_path / "a.csv"
    for encoding in ("utf-8", "utf-16"):
        path.write_bytes(text.encode(encoding) if encoding == "utf-8" else text.lstrip("\ufeff").encode(encoding))
        found = read_columns(path, ["x", "y"])
        assert {name: values.tolist() for name, values in found.items()} == {"x": [1, 3], "y": [2, 4]}


def test_csv_of_one_column_and_of_no_rows(tmp_path):
    (tmp_path / "a.csv").write_text("x\n1\n2\n")
    assert read_columns(tmp_path / "a.csv", ["x"])["x"].tolist() == [1, 2]
    for text in ("x,y\n", "x,y", "y,x\n\n", "x,y,speed"):
        (tmp_path / "a.csv").write_text(text)
        assert {name: values.shape for name, values in read_columns(tmp_path / "a.csv", ["x", "y"]).items()} == {
            "x": (0,),
            "y": (0,),
        }


def test_names_with_commas_and_letters_of_all_languages(tmp_path):
    (tmp_path / "a.csv").write_text('"rotor.displacement[3,2]","größe [µm]"\n1,2\n', encoding="utf-8")
    found = read_columns(tmp_path / "a.csv", ["rotor.displacement[3,2]", "größe [µm]"])
    assert [values.tolist() for values in found.values()] == [[1], [2]]
    (tmp_path / "a.csv").write_bytes("größe,x\n1,2\n".encode("latin-1"))
    assert read_columns(tmp_path / "a.csv", ["x"])["x"].tolist() == [2]


HEADER = "hint: the first line names the columns, as in 't,x,y'"
UNITS = "hint: units go into recording.json, remarks behind '#'"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1,2\n3,4\n", [f"data:1:1: error: no line with the names of the columns\n\n{HEADER}"]),
        ("\n\n", [f"data:2:1: error: no line with the names of the columns\n\n{HEADER}"]),
        ("# only remarks\n", [f"data:1:1: error: no line with the names of the columns\n\n{HEADER}"]),
        (
            "x,y\nm,m\n1,2\n",
            [
                f"data:2:1: error: column x: 'm' is not a number\n\n{UNITS}",
                f"data:2:3: error: column y: 'm' is not a number\n\n{UNITS}",
            ],
        ),
        ("# r\nx,y\n1,2\n\n3,four\n", [f"data:5:3: error: column y: 'four' is not a number\n\n{UNITS}"]),
        (
            "x,y\n1,2\n3,\n",
            ["data:3:3: error: column y: the cell is empty\n\nhint: write nan for a sample that is missing"],
        ),
        (
            "x,y\n1,2\n3\n1,2,3\n",
            ["data:3:1: error: 1 cells, but the header names 2", "data:4:1: error: 3 cells, but the header names 2"],
        ),
        ("x;y\n1.000,5;2\n", [f"data:2:1: error: column x: '1.000,5' is not a number\n\n{UNITS}"]),
        (
            "# r\nt,ix,iy\n",
            [f"data:2:1: error: no column '{c}'\n\nhint: did you mean 'i{c}'? the file has t, ix, iy" for c in "xy"],
        ),
        ("p,q\n", [f"data:1:1: error: no column '{c}'\n\nhint: the file has p, q" for c in "xy"]),
        ("x,y,x\n1,2,3\n", ["data:1:1: error: column 'x' is there 2 times\n\nhint: rename one of them"]),
        ("x,y\n1_0,2\n", [f"data:2:1: error: column x: '1_0' is not a number\n\n{UNITS}"]),
    ],
)
def test_mistakes_in_csv_have_line_and_column(tmp_path, text, expected):
    (tmp_path / "a.csv").write_text(text)
    assert refused(tmp_path / "a.csv", ["x", "y"]) == expected


def test_many_mistakes_are_counted(tmp_path):
    (tmp_path / "a.csv").write_text("x\n" + "a\n" * 100)
    found = refused(tmp_path / "a.csv", ["x"])
    assert len(found) == 21
    assert found[-1] == "data: error: 80 more cells are wrong"


def test_a_line_without_end_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("x" * 2_000_000)
    assert refused(tmp_path / "a.csv", ["x"]) == ["data:1:1: error: a line is longer than 1000000 characters"]


LEFT_OUT = (
    "warning: column y: the last line has no line feed, and this number may lack digits: the line is left out\n\n"
    "hint: copy the file again; if this line is whole, end it with a line feed"
)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize(
    ("rows", "left_out"),
    [
        ("1,2.25\n3,4.1", "3:3"),
        ("1,-21.25\n3,4", "3:3"),
        ("1,1001\n3,10", "3:3"),
        ("1,0.123\n3,1.2e-0", "3:3"),  # the first exponent of the column
        ("1,1.2e-05\n3,1.20e-0", "3:3"),
        ("1,2.25\r\n3,4.1", "3:3"),
        ("1,2.25\n3,4.1 # whole", None),
        ('1,2.25\n3,"4.1"', None),
        ("1,2.25\n3,4.1,", None),
        ("1,2.25\n3,4.1\n", None),
        ("1,2.25\n3,4.1\n\n ", None),
        ("1,-2.25\n3,4.12", None),
        ("1,1.2e-05\n3,1.2e-07", None),
        ("1,2\n3,4", None),
        ("1,2", None),
    ],
)
def test_a_last_number_that_may_lack_digits_is_left_out(tmp_path, rows, left_out, encoding):
    (tmp_path / "a.csv").write_bytes(f"x,y\n{rows}".encode(encoding))
    warnings: list[Problem] = []
    found = read_columns(tmp_path / "a.csv", ["x", "y"], shown="data", warnings=warnings)
    cut = left_out is not None
    assert [str(warning) for warning in warnings] == ([f"data:{left_out}: {LEFT_OUT}"] if cut else [])
    assert found["x"].tolist() == ([1, 3] if "3" in rows else [1])[: 1 if cut else None]
    (tmp_path / "a.csv").write_bytes(f"y,note\n{rows}".encode(encoding))  # what nobody wants may be cut
    assert len(read_columns(tmp_path / "a.csv", ["y"])["y"]) == (2 if "3" in rows else 1)


@pytest.mark.parametrize("rows", ["1,2\n3", "1,2.5\n3,4e-", "1,2\n3,"])
def test_a_last_line_that_was_cut_off_is_refused(tmp_path, rows):
    (tmp_path / "a.csv").write_text(f"x,y\n{rows}")
    (text,) = refused(tmp_path / "a.csv", ["x", "y"])
    assert text.endswith("hint: the file ends within this line: it was cut off; copy it again, or delete the line")


@settings(deadline=None)
@given(st.lists(st.integers(-(10**9), 10**9), min_size=2, max_size=20), st.sampled_from([".6e", ".4f"]), st.data())
def test_csv_of_one_format_that_was_cut_off_has_whole_numbers_only(tmp_path_factory, values, form, data):
    path = tmp_path_factory.getbasetemp() / "cut.csv"
    lines = [format(value / 1e4, form) for value in values]
    text = "x\n" + "\n".join(lines)
    path.write_text(text[: data.draw(st.integers(len(text) - len(lines[-1]), len(text)))])
    try:
        found = read_columns(path, ["x"])["x"]
    except RotorsimError:
        return
    assert found.tolist() == [float(line) for line in lines[: len(found)]]


def test_samples_that_are_not_finite_are_warned_of_with_their_place(tmp_path):
    (tmp_path / "a.csv").write_text("# r\nx,y\n1,2\n\nnan,3\n4,inf\n5,-inf\n")
    warnings: list[Problem] = []
    found = read_columns(tmp_path / "a.csv", ["x", "y"], shown="data", warnings=warnings)
    assert math.isnan(found["x"][1])
    assert [str(warning) for warning in warnings] == [
        "data:5:1: warning: column x: 1 of 4 values are not finite, the first is sample 2",
        "data:6:3: warning: column y: 2 of 4 values are not finite, the first is sample 3",
    ]


@pytest.mark.slow
@settings(deadline=None)
@given(arrays(float, st.tuples(st.integers(1, 20), st.just(len(CHANNELS)))), st.sampled_from(",;\t"))
def test_csv_keeps_every_number(tmp_path_factory, values, delimiter):
    path = tmp_path_factory.getbasetemp() / "numbers.csv"
    write_csv(path, dict(zip(CHANNELS, values.T, strict=True)), delimiter)
    found = read_columns(path, list(CHANNELS))
    np.testing.assert_array_equal(np.column_stack(list(found.values())), values)


@settings(deadline=None)
@given(st.text(alphabet="xy,;\t\"'#\n\r 1.5eE+-nainf\x00é\u2028", max_size=60))
def test_csv_of_any_text_ends_with_numbers_or_a_message(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(text.encode())
    mistakes: tuple[Problem, ...] = ()
    found = {}
    try:
        found = read_columns(path, ["x", "y"])
    except RotorsimError as error:
        mistakes = error.problems
    assert mistakes or {values.ndim for values in found.values()} == {1}
