"""Units: known values, exact messages, and properties over many units."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorsim.units import UnitError, compatible, conversion, convert, format_quantity, parse_quantity, parse_unit

SYMBOLS = ["m", "kg", "s", "A", "K", "rad", "N", "Pa", "J", "W", "V", "Ohm", "F", "H", "T", "Wb", "C", "um", "kN", "mm"]
UNIT = st.lists(
    st.tuples(st.sampled_from(["", "/"]), st.sampled_from(SYMBOLS), st.integers(1, 3)), min_size=1, max_size=4
).map(lambda parts: "1" + "".join(f"{sep or ' '}{symbol}^{power}" for sep, symbol, power in parts))


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("24 um", "m", 24e-6),
        ("24um", "m", 24e-6),
        ("24 µm", "m", 24e-6),
        ("24 μm", "m", 24e-6),
        ("1500 rpm", "rad/s", 50 * math.pi),
        ("25 Hz", "rad/s", 50 * math.pi),
        ("1 rev/s", "rad/s", 2 * math.pi),
        ("90 deg/s", "rad/s", math.pi / 2),
        ("0.1 ms", "s", 1e-4),
        ("3e5 N/m", "N/m", 3e5),
        ("105.21 kN/m", "N/m", 105210.0),
        ("30 deg", "rad", math.pi / 6),
        ("30 °", "rad", math.pi / 6),
        ("1 kg/s", "N s/m", 1.0),
        ("3 N s^2/m", "kg", 3.0),
        ("5 g mm", "kg m", 5e-6),
        ("2 N/(A m)", "N/m/A", 2.0),
        ("1 kg m²/s²", "J", 1.0),
        ("1 N**2", "N^2", 1.0),
        ("5 %", "1", 0.05),
        ("5", "1", 5.0),
        ("-.5e1 V", "V", -5.0),
        ("1 mil", "m", 2.54e-5),
        ("1 lbf", "N", 4.4482216152605),
        ("25 Hz", "Hz", 25.0),
        ("1500 rpm", "Hz", 25.0),
        ("3 T", "V s/m^2", 3.0),
        ("2 MPa", "N/mm^2", 2.0),
        ("7 kg", None, 7.0),
        ("7 g", None, 7e-3),
        ("1 h", "s", 3600.0),
    ],
)
def test_a_quantity_is_the_si_value(text: str, unit: str | None, value: float) -> None:
    assert parse_quantity(text, unit) == pytest.approx(value, rel=4e-16)


@pytest.mark.parametrize("text", ["24", "0.1", "7.3", "105.21", "1e-3"])
@pytest.mark.parametrize(("unit", "exponent"), [("um", -6), ("mm", -3), ("nm", -9), ("km", 3)])
def test_a_decimal_prefix_gives_the_same_float_as_writing_the_exponent(text: str, unit: str, exponent: int) -> None:
    exact = Fraction(text) * Fraction(10) ** exponent
    given = parse_quantity(f"{text} {unit}", "m")
    assert abs(Fraction(given) - exact) <= abs(Fraction(math.ulp(given)))


@pytest.mark.parametrize(
    ("text", "unit", "message"),
    [
        ("24 umm", "m", "unknown unit 'umm'; did you mean 'um' or 'mm'?"),
        ("5 Nm", "N m", "unknown unit 'Nm'; did you mean 'N m'? (a space multiplies)"),
        ("1500 RPM", "rad/s", "unknown unit 'RPM'; did you mean 'rpm'?"),
        ("30 degrees", "rad", "unknown unit 'degrees'; did you mean 'deg'?"),
        ("5 kNn/m", "N/m", "unknown unit 'kNn' in 'kNn/m'; did you mean 'kN'?"),
        (
            "1 1/s",
            "rad/s",
            "unit '1/s' does not fit 'rad/s'; give an angular speed in rad/s, rpm or Hz (revolutions per second)",
        ),
        ("3 m", "rad", "unit 'm' does not fit 'rad'; give an angle in rad or deg"),
        ("3 rad", "1", "unit 'rad' does not fit '1'; give a pure number"),
        ("3 kg", "N/m", "unit 'kg' does not fit 'N/m'; give it in N/m"),
        ("5", "m", "'5' has no unit; write '5 m', or a number without quotes (SI)"),
        ("fast", "rad/s", "'fast' is not a quantity; write a number and a unit, such as '24 um' or '1500 rpm'"),
        ("", "m", "'' is not a quantity; write a number and a unit, such as '24 um' or '1500 rpm'"),
        ("nan m", "m", "'nan m' is not a quantity; write a number and a unit, such as '24 um' or '1500 rpm'"),
        ("1e400 m", "m", "'1e400 m' is too large for a number"),
        ("1e308 km", "m", "'1e308 km' is too large for a number"),
        ("3 m/", "m", "'m/' is not a unit: nothing follows '/'"),
        ("3 m//s", "m/s", "'m//s' is not a unit: '/' twice in a row"),
        ("3 N/(A m", "N/A", "'N/(A m' is not a unit: a bracket is not closed"),
        ("3 N)", "N", "'N)' is not a unit: a bracket is not opened, or empty after '/'"),
        ("3 ^2", "m", "'^2' is not a unit: power 2 has no base or is too large"),
        ("3 m^100", "m", "'m^100' is not a unit: power 100 has no base or is too large"),
        ("3 m!", "m", "'m!' is not a unit: unexpected '!'; write units like 'N s/m' or 'kg m^2'"),
    ],
)
def test_a_wrong_quantity_is_refused_with_a_cure(text: str, unit: str, message: str) -> None:
    with pytest.raises(UnitError) as error:
        parse_quantity(text, unit)
    assert str(error.value) == message


def test_a_number_without_unit_is_si_only_where_that_is_allowed() -> None:
    assert parse_quantity("157", "rad/s", bare=True) == 157.0


@pytest.mark.parametrize(
    ("a", "b", "fit"),
    [
        ("m", "m", "same"),
        ("N", "kg m/s^2", "same"),
        ("N m", "J", "same"),
        ("mm", "m", "scaled"),
        ("Hz", "rad/s", "scaled"),
        ("rad", "1", "angle"),
        ("N m/rad", "N m", "angle"),
        ("1/s", "rad/s", "angle"),
        ("m", "m/s", "different"),
        (None, "m", "same"),
        ("rad", None, "same"),
        (None, None, "same"),
    ],
)
def test_two_units_fit_or_not(a: str | None, b: str | None, fit: str) -> None:
    assert compatible(a, b) == fit
    assert compatible(b, a) == fit


@given(UNIT)
def test_a_unit_is_its_factor_times_its_si_unit(text: str) -> None:
    unit = parse_unit(text)
    si = parse_unit(unit.si)
    assert si.factor == 1.0
    assert si.dimension == unit.dimension


@given(UNIT, UNIT)
def test_dimensions_add_and_factors_multiply(a: str, b: str) -> None:
    one, two, product, ratio = parse_unit(a), parse_unit(b), parse_unit(f"{a} {b}"), parse_unit(f"{a}/({b})")
    assert product.dimension == tuple(x + y for x, y in zip(one.dimension, two.dimension, strict=True))
    assert ratio.dimension == tuple(x - y for x, y in zip(one.dimension, two.dimension, strict=True))
    assert product.factor == pytest.approx(one.factor * two.factor, rel=1e-12)
    assert ratio.factor == pytest.approx(one.factor / two.factor, rel=1e-12)


@given(
    st.floats(1e-30, 1e30),
    st.sampled_from([("um", "m"), ("rpm", "rad/s"), ("Hz", "rpm"), ("deg", "rad"), ("kN/mm", "N/m")]),
)
def test_conversion_there_and_back_is_the_identity(value: float, units: tuple[str, str]) -> None:
    a, b = units
    assert convert(convert(value, a, b), b, a) == pytest.approx(value, rel=1e-14)
    assert conversion(a, b) * conversion(b, a) == pytest.approx(1.0, rel=1e-14)


@given(
    st.floats(-1e12, 1e12), st.sampled_from(["m", "N/m", "N s/m", "A", "s", "V", "kg", "rad/s", "rad", "1", "m/s^2"])
)
def test_what_is_displayed_reads_back_as_the_same_value(value: float, unit: str) -> None:
    shown = format_quantity(value, unit, digits=17)
    assert parse_quantity(shown, unit) == pytest.approx(value, rel=1e-15, abs=1e-300)


@given(st.text(max_size=30))
def test_any_text_is_a_quantity_or_a_unit_error(text: str) -> None:
    try:
        value = parse_quantity(text, None)
    except UnitError:
        return
    assert math.isfinite(value)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (24e-6, "m", "24 um"),
        (105210.0, "N/m", "105.21 kN/m"),
        (999.9999999, "m", "1 km"),
        (0.0, "m", "0 m"),
        (3.0, "kg", "3 kg"),
        (157.08, "rad/s", "157.08 rad/s"),
        (1e-4, "s", "100 us"),
        (0.5, "1", "0.5"),
        (0.5, None, "0.5"),
        (2e4, "m^2", "20000 m^2"),
        (-24e-6, "m", "-24 um"),
        (1e20, "N", "1e+11 GN"),
        (math.inf, "m", "inf m"),
    ],
)
def test_display_chooses_a_prefix_that_reads_well(value: float, unit: str | None, text: str) -> None:
    assert format_quantity(value, unit) == text
