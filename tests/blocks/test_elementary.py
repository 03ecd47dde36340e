"""Memoryless elementary blocks against NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.signal import chirp

from tests.blocks.evaluation import prepare

rng = np.random.default_rng(1)
SHAPES = [(), (3,), (2, 3)]
finite = st.floats(-1e3, 1e3)


def output(type_name: str, parameters: Any = None, options: Any = None, **inputs: Any) -> np.ndarray:
    shapes = {name: np.shape(value) for name, value in inputs.items()}
    result = prepare(type_name, shapes, parameters, options).evaluate(inputs)
    return result.outputs["output"]


@pytest.mark.parametrize("shape", SHAPES)
def test_gain_scales_every_entry(shape: tuple[int, ...]) -> None:
    value = rng.normal(size=shape)
    np.testing.assert_array_equal(output("gain", {"gain": 3.5}, input=value), 3.5 * value)


@pytest.mark.parametrize("shape", SHAPES)
def test_constant_has_the_shape_of_its_value(shape: tuple[int, ...]) -> None:
    value = rng.normal(size=shape)
    result = prepare("constant", parameters={"value": value}).evaluate()
    np.testing.assert_array_equal(result.outputs["output"], value)


def test_constant_takes_the_shape_of_its_wire() -> None:
    result = prepare("constant", parameters={"value": 2.0}, outputs={"output": (2, 2)}).evaluate()
    np.testing.assert_array_equal(result.outputs["output"], np.full((2, 2), 2.0))


def test_matrix_gain_is_a_matrix_product() -> None:
    matrix, vector = rng.normal(size=(3, 4)), rng.normal(size=4)
    np.testing.assert_allclose(output("matrix_gain", {"gain": matrix}, input=vector), matrix @ vector, rtol=1e-14)


@pytest.mark.parametrize("spacing", ["logarithmic", "linear"])
def test_chirp_is_that_of_scipy_and_its_rate_the_derivative(spacing: str) -> None:
    values = {"amplitude": [2.0, 0.0], "first": 2 * np.pi * 3, "last": 2 * np.pi * 70, "start": 0.5, "duration": 4.0}

    def found(time: float, name: str = "output") -> np.ndarray:
        return prepare("chirp", parameters=values, options={"spacing": spacing}).evaluate(time=time).outputs[name]

    for time in (0.7, 1.9, 4.4):
        expected = chirp(time - 0.5, 3.0, 4.0, 70.0, method=spacing, phi=-90)
        np.testing.assert_allclose(found(time), [2 * expected, 0.0], atol=1e-11)
        step = 1e-6
        slope = (found(time + step) - found(time - step)) / (2 * step)
        np.testing.assert_allclose(found(time, "rate"), slope, rtol=1e-6, atol=1e-6)
    for time in (0.49, 4.51):
        np.testing.assert_array_equal([found(time), found(time, "rate")], np.zeros((2, 2)))


def test_a_logarithmic_chirp_may_stay_at_one_frequency() -> None:
    values = {"first": 20.0, "last": 20.0, "duration": 3.0}
    result = prepare("chirp", parameters=values).evaluate(time=1.3)
    np.testing.assert_allclose(result.outputs["output"], np.sin(20.0 * 1.3), rtol=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_sum_takes_the_signs_in_order(shape: tuple[int, ...]) -> None:
    a, b, c = (rng.normal(size=shape) for _ in range(3))
    found = output("sum", options={"signs": "-+-"}, input1=a, input2=b, input3=c)
    np.testing.assert_array_equal(found, -a + b - c)


@pytest.mark.parametrize("shape", SHAPES)
def test_product_multiplies_and_divides_in_order(shape: tuple[int, ...]) -> None:
    a, b, c = (1 + rng.uniform(size=shape) for _ in range(3))
    found = output("product", options={"operations": "/*/"}, input1=a, input2=b, input3=c)
    np.testing.assert_allclose(found, b / (a * c), rtol=1e-15)


@pytest.mark.parametrize(("type_name", "option", "bad"), [("sum", "signs", "+x"), ("product", "operations", "")])
def test_wrong_signs_are_refused(type_name: str, option: str, bad: str) -> None:
    block = prepare(type_name, {"input1": (), "input2": ()}).block
    setattr(block.option, option, bad)
    words = {"signs": "+ and -", "operations": "* and /"}[option]
    assert block.check({}) == [f"{option} must be one or more of {words}, got '{bad}'"]


@pytest.mark.parametrize("function", ["sin", "cos", "tan", "arctan"])
@pytest.mark.parametrize("multiple", [1, 0, -5, 7])
def test_trigonometric_functions_of_a_multiple(function: str, multiple: int) -> None:
    angle = rng.uniform(-3, 3, size=(2, 3))
    found = output("trigonometric", options={"function": function, "multiple": multiple}, input=angle)
    np.testing.assert_allclose(found, getattr(np, function)(multiple * angle), rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("function", ["arcsin", "arccos"])
def test_inverse_functions_keep_all_digits_near_one(function: str) -> None:
    ratio = np.array([-1.0, -1 + 1e-12, -0.3, 0.0, 0.7, 1 - 1e-12, 1.0])
    found = output("trigonometric", options={"function": function}, input=ratio)
    np.testing.assert_allclose(found, getattr(np, function)(ratio), rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        ("square", np.square),
        ("sqrt", np.sqrt),
        ("exp", np.exp),
        ("log", np.log),
        ("reciprocal", np.reciprocal),
        ("tanh", np.tanh),
        ("floor", np.floor),
    ],
)
def test_mathematical_functions(function: str, expected: Any) -> None:
    value = np.array([0.2, 1.0, 2.5])
    np.testing.assert_allclose(output("math_function", options={"function": function}, input=value), expected(value))


@given(value=arrays(float, 4, elements=finite), limits=st.tuples(finite, finite).map(sorted))
@settings(max_examples=25, deadline=None)
def test_saturation_clips(value: np.ndarray, limits: list[float]) -> None:
    found = output("saturation", {"lower": limits[0], "upper": limits[1]}, input=value)
    np.testing.assert_array_equal(found, np.clip(value, *limits))


def test_saturation_refuses_limits_in_the_wrong_order() -> None:
    block = prepare("saturation", {"input": ()}).block
    values = {"lower": np.array(2.0), "upper": np.array(-1.0)}
    assert block.check(values) == ["lower = 2 is above upper = -1"]


@given(value=finite, width=st.floats(0, 100))
@settings(max_examples=25, deadline=None)
def test_dead_zone_returns_the_excess(value: float, width: float) -> None:
    expected = np.sign(value) * max(abs(value) - width / 2, 0.0)
    assert output("dead_zone", {"width": width}, input=value) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@given(value=arrays(float, 5, elements=st.floats(-3, 6)))
@settings(max_examples=25, deadline=None)
def test_lookup_table_clamps_like_numpy_interp(value: np.ndarray) -> None:
    xs, ys = [-1.0, 0.0, 0.5, 4.0], [2.0, -1.0, 3.0, 3.5]
    found = output("lookup_table", {"breakpoints": xs, "values": ys}, input=value)
    np.testing.assert_allclose(found, np.interp(value, xs, ys), rtol=1e-13, atol=1e-13)


def test_lookup_table_prolongs_its_end_segments() -> None:
    table = {"breakpoints": [0.0, 1.0, 3.0], "values": [0.0, 2.0, 0.0]}
    found = output("lookup_table", table, {"outside": "extrapolate"}, input=np.array([-2.0, 0.5, 5.0]))
    np.testing.assert_allclose(found, [-4.0, 1.0, -2.0])


def test_lookup_table_of_two_points_has_no_kink_when_prolonged() -> None:
    prepared = prepare("lookup_table", {"input": ()}, options={"outside": "extrapolate"})
    assert prepared.evaluate({"input": 7.0}).outputs["output"] == 7.0
    assert prepared.evaluate().events == {}


@pytest.mark.parametrize(
    ("breakpoints", "message"),
    [
        ([0.0], "the table needs at least two breakpoints, got 1"),
        ([0.0, 2.0, 1.0], "breakpoints must increase, but breakpoint 3 = 1 follows 2"),
    ],
)
def test_lookup_table_refuses_bad_tables(breakpoints: list[float], message: str) -> None:
    block = prepare("lookup_table", {"input": ()}).block
    assert block.check({"breakpoints": np.array(breakpoints), "values": np.array(breakpoints)}) == [message]


@given(value=finite, interval=st.sampled_from([0.25, 0.1, 3.0]))
@settings(max_examples=25, deadline=None)
def test_quantiser_gives_the_nearest_level(value: float, interval: float) -> None:
    level = output("quantiser", {"interval": interval}, input=value)
    assert abs(level - value) <= interval / 2 * (1 + 1e-12)
    assert level / interval == pytest.approx(round(float(level / interval)), abs=1e-9)


@given(value=st.floats(-20, 20), interval=st.sampled_from([0.25, 3.0]))
@settings(max_examples=25, deadline=None)
def test_smooth_edges_are_the_fourier_series_of_rounding(value: float, interval: float) -> None:
    """v - round(v) = sum_k (-1)^(k+1) sin(2 pi k v) / (pi k), its terms smaller by r^k: Abel's sum."""
    k = np.arange(1, 2000)
    for edges, r in (("steep", 0.99), ("smooth", 0.9)):
        series = -((-r) ** k) * np.sin(2 * np.pi * k * value / interval) / (np.pi * k)
        smooth = output("quantiser", {"interval": interval}, {"edges": edges}, input=value)
        assert smooth == pytest.approx(value - interval * series.sum(), abs=1e-7)


def test_absolute_and_sign() -> None:
    value = np.array([-2.0, 0.0, 3.0])
    np.testing.assert_array_equal(output("absolute", input=value), [2.0, 0.0, 3.0])
    np.testing.assert_array_equal(output("sign", input=value), [-1.0, 0.0, 1.0])


@pytest.mark.parametrize("function", ["minimum", "maximum"])
def test_min_max_over_three_inputs(function: str) -> None:
    values = rng.normal(size=(3, 4))
    inputs = {f"input{k}": value for k, value in enumerate(values, start=1)}
    found = output("min_max", options={"function": function, "count": 3}, **inputs)
    np.testing.assert_array_equal(found, getattr(np, function).reduce(values))


@pytest.mark.parametrize(("control", "expected"), [(2.0, 1.0), (1.5, 1.0), (1.0, -1.0)])
def test_switch_passes_above_from_the_threshold_on(control: float, expected: float) -> None:
    found = output("switch", {"threshold": 1.5}, control=control, above=np.ones(2), below=-np.ones(2))
    np.testing.assert_array_equal(found, [expected, expected])


@pytest.mark.parametrize("shape", SHAPES)
def test_norm_is_euclidean(shape: tuple[int, ...]) -> None:
    value = rng.normal(size=shape)
    assert output("norm", input=value) == pytest.approx(np.linalg.norm(np.ravel(value)), rel=1e-14)


def test_polar_form_and_rotation_agree_with_complex_numbers() -> None:
    z, angle = 3.0 - 4.0j, 0.7
    polar = prepare("polar", {"input": (2,)}).evaluate({"input": [z.real, z.imag]}).outputs
    assert polar["amplitude"] == pytest.approx(abs(z), rel=1e-15)
    assert polar["angle"] == pytest.approx(np.angle(z), rel=1e-15)
    turned = output("rotation", options={"multiple": -2}, input=np.array([z.real, z.imag]), angle=angle)
    expected = z * np.exp(-2j * angle)
    np.testing.assert_allclose(turned, [expected.real, expected.imag], rtol=1e-14)


def test_mux_demux_and_selector_move_entries() -> None:
    found = output("mux", options={"count": 3}, input1=1.0, input2=2.0, input3=3.0)
    np.testing.assert_array_equal(found, [1.0, 2.0, 3.0])
    split = prepare("demux", {"input": (3,)}, options={"count": 3}).evaluate({"input": [4.0, 5.0, 6.0]}).outputs
    assert {name: float(value) for name, value in split.items()} == {"output1": 4.0, "output2": 5.0, "output3": 6.0}
    picked = output("selector", options={"indices": [3, 1, 3]}, input=np.array([7.0, 8.0, 9.0]))
    np.testing.assert_array_equal(picked, [9.0, 7.0, 9.0])


def test_selector_refuses_an_index_outside_the_input() -> None:
    with pytest.raises(ValueError) as caught:
        prepare("selector", {"input": (3,)}, options={"indices": [4]})
    assert str(caught.value) == "index 4 of indices is outside the input, which has 3 entries"


def test_reference_turns_at_whole_multiples_of_the_angle() -> None:
    harmonics = [-5, -3, -1, 0, 1, 2, 3, 5, 7]
    theta = 0.9
    found = prepare("reference", {"theta": ()}).evaluate({"theta": theta}).outputs["signal"]
    expected = np.exp(1j * np.array(harmonics) * theta)
    assert found.shape == (9, 2)
    np.testing.assert_allclose(found[:, 0] + 1j * found[:, 1], expected, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("time", [-0.5, 0.999, 1.0, 3.0])
def test_sources_follow_their_formulas(time: float) -> None:
    step = prepare("step", parameters={"time": 1.0, "initial": 2.0, "final": [5.0, 7.0]}).evaluate(time=time)
    np.testing.assert_array_equal(step.outputs["output"], [5.0, 7.0] if time >= 1.0 else [2.0, 2.0])
    ramp = prepare("ramp", parameters={"time": 1.0, "initial": 2.0, "slope": -3.0}).evaluate(time=time)
    assert ramp.outputs["output"] == 2.0 - 3.0 * max(time - 1.0, 0.0)
    values = {"amplitude": 2.0, "frequency": 3.0, "phase": [0.0, 0.4], "offset": -1.0}
    sine = prepare("sine", parameters=values).evaluate(time=time)
    np.testing.assert_allclose(sine.outputs["output"], -1 + 2 * np.sin(3 * time + np.array([0.0, 0.4])), rtol=1e-14)


@pytest.mark.parametrize(
    ("type_name", "parameters", "options", "kinks"),
    [
        ("saturation", {"lower": -1.0, "upper": 2.0}, {}, [-1.0, 2.0]),
        ("dead_zone", {"width": 3.0}, {}, [-1.5, 1.5]),
        ("lookup_table", {"breakpoints": [0.0, 1.0, 4.0], "values": [0.0, 1.0, 0.0]}, {}, [0.0, 1.0, 4.0]),
        ("quantiser", {"interval": 0.5}, {}, [-0.25, 0.25, 1.75]),
        ("absolute", {}, {}, [0.0]),
        ("sign", {}, {}, [0.0]),
    ],
)
def test_events_cross_zero_where_the_output_has_a_kink(
    type_name: str, parameters: dict[str, Any], options: dict[str, Any], kinks: list[float]
) -> None:
    prepared = prepare(type_name, {"input": ()}, parameters, options)
    for kink in kinks:
        before, after = (
            np.concatenate([e.ravel() for e in prepared.evaluate({"input": kink + d}).events.values()])
            for d in (-1e-6, 1e-6)
        )
        assert np.any(before * after < 0), kink


def test_bus_puts_signals_of_any_shape_in_one_vector() -> None:
    displacement, current, theta = rng.normal(size=(3, 2)), rng.normal(size=2), 0.5
    options = {"names": ["displacement", "current", "theta"]}
    found = output("bus", options=options, displacement=displacement, current=current, theta=theta)
    np.testing.assert_array_equal(found, [*displacement.ravel(), *current, theta])


@pytest.mark.parametrize("type_name", ["scope", "to_file"])
def test_recording_blocks_take_any_shapes_and_have_no_output(type_name: str) -> None:
    prepared = prepare(type_name, {"a": (3, 2), "b": ()}, options={"names": ["a", "b"]})
    assert prepared.evaluate().outputs == {}


@pytest.mark.parametrize("type_name", ["bus", "scope", "to_file"])
def test_names_of_inputs_are_checked(type_name: str) -> None:
    block = prepare(type_name, {"a": ()}, options={"names": ["a"]}).block
    block.option.names = ["a", "b", "a"]
    assert block.check({}) == ["name 'a' is given twice"]
    block.option.names = []
    [message] = block.check({})
    assert message.startswith("names is empty: a ")


@pytest.mark.parametrize(
    ("file", "messages"),
    [
        ("run/signals.h5", []),
        ("signals.txt", ["file 'signals.txt' must end in one of .csv, .h5, .npz"]),
        ("../out.csv", ["file '../out.csv' must be a relative name inside the folder of the diagram"]),
        ("/tmp/out.csv", ["file '/tmp/out.csv' must be a relative name inside the folder of the diagram"]),
        ("C:\\out.csv", ["file 'C:\\out.csv' must be a relative name inside the folder of the diagram"]),
    ],
)
def test_to_file_stays_in_the_folder_of_the_diagram(file: str, messages: list[str]) -> None:
    block = prepare("to_file").block
    block.option.file = file
    assert block.check({}) == messages


@pytest.mark.parametrize(
    ("law", "parameters", "added"),
    [
        ("linear", {"linear": 0.3}, lambda o: 0.3 * o),
        ("polynomial", {"linear": 0.3, "quadratic": -0.2, "cubic": 0.1}, lambda o: 0.3 * o - 0.2 * o**2 + 0.1 * o**3),
        (
            "periodic",
            {"sine": 2.0, "cosine": 0.5, "wave_number": 3.0},
            lambda o: 2 * np.sin(3 * o) + np.cos(3 * o) / 2 - 0.5,
        ),
        ("stop", {"slope": -2.0, "gap": 0.5}, lambda o: np.array([0.0, 0.0, -0.4])),
        ("stop", {"slope": 2.0, "gap": 0.5, "side": -1.0}, lambda o: np.array([2.0, 0.0, 0.0])),
    ],
)
def test_coupling_adds_a_function_of_another_signal(law: str, parameters: dict[str, float], added: Any) -> None:
    value, other = np.array([0.2, -1.0, 4.0]), np.array([-1.5, 0.0, 0.7])
    found = output("coupling", parameters, {"law": law}, input=value, other=other)
    np.testing.assert_allclose(found, value + added(other), rtol=1e-13)


def test_a_scheduled_gain_follows_another_signal() -> None:
    value, other = np.array([0.2, -1.0, 4.0]), np.array([-1.5, 0.0, 0.7])
    found = output("scheduled_gain", {"slope": 0.3}, {"law": "linear"}, input=value, other=other)
    np.testing.assert_allclose(found, value * (1 + 0.3 * other), rtol=1e-13)
    found = output("scheduled_gain", {"curvature": -0.1}, {"law": "square"}, input=value, other=other)
    np.testing.assert_allclose(found, value * (1 - 0.1 * other**2), rtol=1e-13)


@pytest.mark.parametrize(("law", "power"), [("knee", 1), ("divisor", -1)])
def test_a_scheduled_gain_changes_about_its_knee(law: str, power: int) -> None:
    parameters = {"change": -0.8, "knee": 5.0, "width": 0.5}
    other = np.array([-5.0, 5.0, 6.0, 5000.0])
    expected = (1 - 0.8 * (1 + np.tanh((np.abs(other) - 5.0) / 0.5)) / 2) ** power
    found = output("scheduled_gain", parameters, {"law": law}, input=np.full(4, 2.0), other=other)
    np.testing.assert_allclose(found, 2 * expected, rtol=1e-12)
