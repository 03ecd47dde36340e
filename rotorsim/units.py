"""Units: quantities as text to SI numbers and back, and whether two units fit.

A unit is a factor and a dimension vector (m, kg, s, A, K, rad, mol, cd). Angle is a dimension of its own, so that an
angle and a pure number are told apart. A revolution is 2 pi rad; hence rpm and Hz (revolutions per second)
convert to rad/s, and ``1/s`` does not.

Grammar: factors separated by a space, ``*`` or ``.``; ``/`` divides by the next factor only; powers as
``^2``, ``**2`` or ``²``; brackets: ``N s/m``, ``kg m^2``, ``N/(A m)``. SI prefixes from n to G (and p, T).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache

from rotorsim.errors import near_miss

Dimension = tuple[int, ...]
BASES = ("m", "kg", "s", "A", "K", "rad", "mol", "cd")
AMPLITUDE_KINDS = {"0-peak": 1.0, "peak-peak": 2.0, "rms": math.sqrt(0.5)}  # of a sinusoid: factor from 0-peak
_NONE: Dimension = (0,) * len(BASES)
_REVOLUTION = 2.0 * math.pi

_KNOWN: dict[str, tuple[float, Dimension]] = {
    "1": (1.0, ()),
    "%": (0.01, ()),
    "m": (1.0, (1, 0, 0, 0, 0, 0)),
    "g": (1e-3, (0, 1, 0, 0, 0, 0)),
    "s": (1.0, (0, 0, 1, 0, 0, 0)),
    "A": (1.0, (0, 0, 0, 1, 0, 0)),
    "K": (1.0, (0, 0, 0, 0, 1, 0)),
    "rad": (1.0, (0, 0, 0, 0, 0, 1)),
    "N": (1.0, (1, 1, -2, 0, 0, 0)),
    "Pa": (1.0, (-1, 1, -2, 0, 0, 0)),
    "bar": (1e5, (-1, 1, -2, 0, 0, 0)),
    "J": (1.0, (2, 1, -2, 0, 0, 0)),
    "W": (1.0, (2, 1, -3, 0, 0, 0)),
    "C": (1.0, (0, 0, 1, 1, 0, 0)),
    "V": (1.0, (2, 1, -3, -1, 0, 0)),
    "Ohm": (1.0, (2, 1, -3, -2, 0, 0)),
    "F": (1.0, (-2, -1, 4, 2, 0, 0)),
    "H": (1.0, (2, 1, -2, -2, 0, 0)),
    "T": (1.0, (0, 1, -2, -1, 0, 0)),
    "Wb": (1.0, (2, 1, -2, -1, 0, 0)),
    "Hz": (_REVOLUTION, (0, 0, -1, 0, 0, 1)),
    "rpm": (_REVOLUTION / 60.0, (0, 0, -1, 0, 0, 1)),
    "rev": (_REVOLUTION, (0, 0, 0, 0, 0, 1)),
    "deg": (math.pi / 180.0, (0, 0, 0, 0, 0, 1)),
    "min": (60.0, (0, 0, 1, 0, 0, 0)),
    "h": (3600.0, (0, 0, 1, 0, 0, 0)),
    "in": (0.0254, (1, 0, 0, 0, 0, 0)),
    "mil": (2.54e-5, (1, 0, 0, 0, 0, 0)),
    "lb": (0.45359237, (0, 1, 0, 0, 0, 0)),
    "lbf": (4.4482216152605, (1, 1, -2, 0, 0, 0)),
    "mol": (1.0, (0, 0, 0, 0, 0, 0, 1)),
    "cd": (1.0, (0, 0, 0, 0, 0, 0, 0, 1)),
}
_PREFIXES = {"p": 1e-12, "n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}
_PREFIXED = {
    "m",
    "g",
    "s",
    "A",
    "K",
    "rad",
    "N",
    "Pa",
    "bar",
    "J",
    "W",
    "C",
    "V",
    "Ohm",
    "F",
    "H",
    "T",
    "Wb",
    "Hz",
    "mol",
}
_ALIASES = {"Ω": "Ohm", "°": "deg", "µ": "u", "μ": "u", "·": " ", "²": "^2", "³": "^3", "⁻": "^-", "¹": "1"}

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.DOTALL)
_TOKEN = re.compile(r"\s*(?:(\*\*|\^)\s*([+-]?\d+)|(/)|(\()|(\))|([*.])|(1(?!\d)|%|[A-Za-z]+)|(\S))")


class UnitError(ValueError):
    """A text is no quantity or no unit, or two units do not fit; ``hint`` says how to cure it."""

    def __init__(self, what: str, hint: str = "") -> None:
        self.what, self.hint = what, hint
        super().__init__(f"{what}; {hint}" if hint else what)


@dataclass(frozen=True)
class Unit:
    """A unit: ``factor`` times the SI unit of ``dimension`` = powers of `BASES`."""

    factor: float
    dimension: Dimension

    def times(self, other: Unit, n: int = 1) -> Unit:
        """Return the product with another unit to the power n."""
        try:
            factor = self.factor * other.factor**n
        except OverflowError:
            factor = math.inf
        return Unit(factor, tuple(a + n * b for a, b in zip(self.dimension, other.dimension, strict=True)))

    @property
    def si(self) -> str:
        """The SI unit of this dimension in base units, e.g. ``"kg m^2/s^2"``; ``"1"`` for a pure number."""
        powers = dict(zip(BASES, self.dimension, strict=True))
        above = " ".join(_power(base, n) for base, n in powers.items() if n > 0)
        below = "".join(f"/{_power(base, -n)}" for base, n in powers.items() if n < 0)
        return (above or "1") + below


def _power(base: str, n: int) -> str:
    return base if n == 1 else f"{base}^{n}"


_ONE = Unit(1.0, _NONE)
_SYMBOLS = {name: Unit(factor, (*powers, *_NONE)[: len(BASES)]) for name, (factor, powers) in _KNOWN.items()}


@lru_cache(maxsize=4096)
def parse_unit(text: str) -> Unit:
    """Return the unit that a text such as ``"N s/m"`` stands for; raise UnitError with a near miss."""
    plain = text
    for alias, standard in _ALIASES.items():
        plain = plain.replace(alias, standard)
    if len(plain) > 100:
        raise UnitError(f"unit of {len(plain)} characters is too long")
    stack: list[tuple[Unit, int]] = []  # outer products, with the sign that the bracket gets
    product, sign = _ONE, 1
    last: tuple[Unit, int] | None = None  # the factor that a power would apply to
    for caret, exponent, slash, opening, closing, _star, symbol, other in _TOKEN.findall(plain):
        if other:
            raise UnitError(f"'{text}' is not a unit: unexpected '{other}'", "write units like 'N s/m' or 'kg m^2'")
        if symbol:
            last = (_symbol(symbol, text), sign)
            product, sign = product.times(*last), 1
        elif caret:
            n = int(exponent)
            if last is None or abs(n) > 99:
                raise UnitError(f"'{text}' is not a unit: power {n} has no base or is too large")
            product, last = product.times(last[0], last[1] * (n - 1)), None
        elif slash:
            if sign < 0:
                raise UnitError(f"'{text}' is not a unit: '/' twice in a row")
            sign, last = -1, None
        elif opening:
            stack.append((product, sign))
            product, sign, last = _ONE, 1, None
        elif closing:
            if not stack or sign < 0:
                raise UnitError(f"'{text}' is not a unit: a bracket is not opened, or empty after '/'")
            outer, outer_sign = stack.pop()
            last = (product, outer_sign)
            product = outer.times(*last)
        else:
            last = None
    if stack or sign < 0:
        raise UnitError(f"'{text}' is not a unit: " + ("a bracket is not closed" if stack else "nothing follows '/'"))
    if not 0.0 < product.factor < math.inf:
        raise UnitError(f"'{text}' is not a unit: its factor is out of range")
    return product


def _symbol(symbol: str, text: str) -> Unit:
    if symbol in _SYMBOLS:
        return _SYMBOLS[symbol]
    if symbol[0] in _PREFIXES and symbol[1:] in _PREFIXED:
        unit = _SYMBOLS[symbol[1:]]
        return Unit(_PREFIXES[symbol[0]] * unit.factor, unit.dimension)
    where = "" if symbol == text else f" in '{text}'"
    raise UnitError(f"unknown unit '{symbol}'{where}", _near_unit(symbol))


_FOREIGN = {
    "-": "1",
    "r": "rev",
    "degree": "deg",
    "°C": "degC",
    "℃": "degC",
    "Nm": "N.m",
    "Nms": "N.m.s",
    "S": "A/V",
    "VA": "V.A",
    "l": "dm^3",
    "L": "dm^3",
    "t": "Mg",
    "ohm": "Ohm",
    "sec": "s",
    "RPM": "rpm",
    "Wh": "W.h",
    "var": "V.A",
}
_OFFSETS = {"degC": (1.0, 273.15), "degF": (1.0 / 1.8, 459.67 / 1.8)}  # K = factor * value + offset
_WORD = re.compile(r"([^\W\d_]+|[°℃]C?|%)([+-]?\d+)?")


def parse_foreign_unit(text: str) -> tuple[Unit, float, str]:
    """Return the unit, its offset [SI] and its spelling here of a unit as other tools write it.

    Read are ``m/s2``, ``kg.m2``, ``min-1``, ``r/min``, ``N.m/rad``, ``degC`` beside what `parse_unit` reads. The value
    in SI units is factor * value + offset. Raises UnitError. Source: Modelica specification 3.6, chapter 19.
    """
    name = _FOREIGN.get(text.strip(), text.strip())
    if name in _OFFSETS:
        factor, offset = _OFFSETS[name]
        return Unit(factor, _SYMBOLS["K"].dimension), offset, "K"
    try:
        return parse_unit(name), 0.0, name
    except UnitError:
        spelled = _WORD.sub(_respelled, name)
    return parse_unit(spelled), 0.0, spelled


def _respelled(match: re.Match[str]) -> str:
    word, power = match.groups()
    word = _FOREIGN.get(word, word)
    word = "K" if word in _OFFSETS else f"({word})" if word != match[1] else word  # in a product, a difference
    return word + (f"^{int(power)}" if power else "")


def _near_unit(symbol: str) -> str:
    known = set(_SYMBOLS) - {"1"}
    known |= {prefix + base for prefix in ("n", "u", "m", "k", "M", "G") for base in _PREFIXED - {"rad", "K", "bar"}}
    known |= {"mrad", "urad", "mbar", "cm"}
    for cut in range(len(symbol) - 1, 0, -1):
        if symbol[:cut] in ("N", "kN", "mN", "MN", "kg", "g", "V", "A", "Pa", "W") and symbol[cut:] in known:
            return f"did you mean '{symbol[:cut]} {symbol[cut:]}'? (a space multiplies)"
    words = {"degree": "deg", "degrees": "deg", "sec": "s", "seconds": "s", "newton": "N", "ohm": "Ohm", "inch": "in"}
    words |= {"radian": "rad", "radians": "rad", "meter": "m", "metre": "m", "micron": "um", "hertz": "Hz", "amp": "A"}
    if symbol.lower() in words:
        return f"did you mean '{words[symbol.lower()]}'?"
    hint = near_miss(symbol, known, list_all=False)
    return hint or "known: " + ", ".join(sorted(set(_SYMBOLS) - {"1"})) + ", with prefixes n u m k M G"


def compatible(a: str | None, b: str | None) -> str:
    """Return how two units fit: ``"same"``, ``"scaled"`` (m, mm), ``"angle"`` (rad, 1) or ``"different"``.

    None stands for whatever is wired and fits everything.
    """
    if a is None or b is None or a == b:
        return "same"
    one, two = parse_unit(a), parse_unit(b)
    if one.dimension == two.dimension:
        return "same" if math.isclose(one.factor, two.factor, rel_tol=1e-12) else "scaled"
    return "angle" if _but_angle(one.dimension) == _but_angle(two.dimension) else "different"


def _but_angle(dimension: Dimension) -> Dimension:
    at = BASES.index("rad")
    return dimension[:at] + dimension[at + 1 :]


@lru_cache(maxsize=4096)
def conversion(given: str, expected: str | None) -> float:
    """Return what a number in ``given`` must be multiplied by to be one in ``expected`` (None: SI).

    Raises UnitError when the dimensions differ.
    """
    have = parse_unit(given)
    if expected is None:
        return have.factor
    want = parse_unit(expected)
    if have.dimension != want.dimension:
        raise UnitError(f"unit '{given}' does not fit '{expected}'", _cure(expected, want))
    return have.factor / want.factor


def _cure(expected: str, want: Unit) -> str:
    cures = {
        _SYMBOLS["rpm"].dimension: "give an angular speed in rad/s, rpm or Hz (revolutions per second)",
        _SYMBOLS["rad"].dimension: "give an angle in rad or deg",
        _NONE: "give a pure number",
    }
    return cures.get(want.dimension, f"give it in {expected}")


def convert(value: float, given: str, expected: str | None = None) -> float:
    """Return ``value`` in unit ``given`` as a number in ``expected`` (None: SI)."""
    return _scaled(value, conversion(given, expected))


def _scaled(value: float, factor: float) -> float:
    inverse = round(1.0 / factor) if 1e-15 < factor < 0.5 else 0
    exact = inverse and abs(inverse * factor - 1.0) < 1e-15
    return value / inverse if exact else value * factor  # 24 / 1e6 is 24e-6 to the last bit, 24 * 1e-6 need not be


def split_quantity(text: str) -> tuple[float, str]:
    """Return the number and the unit text (may be empty) of ``"24 um"``; raise UnitError if there is no number."""
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise UnitError(
            f"'{_short(text)}' is not a quantity", "write a number and a unit, such as '24 um' or '1500 rpm'"
        )
    value = float(match[1])
    if not math.isfinite(value):
        raise UnitError(f"'{_short(text)}' is too large for a number")
    return value, match[2]


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def parse_quantity(text: str, unit: str | None = "1", *, bare: bool = False) -> float:
    """Return the SI value of a text such as ``"24 um"``, ``"30 deg"``, ``"1500 rpm"``.

    unit: the declared unit that the text must fit and that the result is in (None: any, SI).
    bare: a number without a unit counts as one in ``unit``; otherwise only pure numbers may lack a unit.
    Raises UnitError for a bad number, an unknown unit or one that does not fit.
    """
    value, given = split_quantity(text)
    if not given:
        if bare or unit is None or unit == "1" or parse_unit(unit).dimension == _NONE:
            return value
        raise UnitError(
            f"'{_short(text)}' has no unit", f"write '{text.strip()} {unit}', or a number without quotes (SI)"
        )
    result = _scaled(value, conversion(given, unit))
    if not math.isfinite(result):
        raise UnitError(f"'{_short(text)}' is too large for a number")
    return result


def format_quantity(value: float, unit: str | None = "1", digits: int = 6) -> str:
    """Return a value with its unit for display, with an SI prefix where that reads better: ``24 um``."""
    if unit in (None, "", "1"):
        return f"{value:.{digits}g}"
    assert unit is not None
    head = re.match(r"[A-Za-z]+", unit)
    symbol = head[0] if head else ""
    followed = unit[len(symbol) :].startswith(("^", "**", "²", "³"))
    if symbol not in _PREFIXED - {"rad", "K", "g"} or followed or value == 0.0 or not math.isfinite(value):
        return f"{value:.{digits}g} {unit}"
    exponent = min(max(3 * math.floor(math.log10(float(f"{abs(value):.{digits}g}")) / 3), -12), 9)
    prefix = {-12: "p", -9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}[exponent]
    return f"{value / 10.0**exponent:.{digits}g} {prefix}{unit}"
