"""What a block is: declared ports, parameters and states, and equations written once.

A block is a class whose attributes declare what it has and whose ``equations`` say what it does.
The equations are traced with CasADi symbols; numbers, C code, Jacobians and FMUs all come from
that one trace. This module imports nothing else of rotorsim, so that a block file needs only it.

Contract for whoever writes a block:

1. ``equations`` is pure: it reads ``p``, ``u``, ``x``, ``t`` and returns `Equations`; no state is kept.
2. Scalars are 1x1 symbols, shape ``(n,)`` is an n x 1 column, shape ``(n, m)`` an n x m matrix.
3. Decisions on numbers use `where`, never ``if``; decisions on options and on wiring may use ``if``.
4. SI units inside; units are declared, never part of a name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from types import SimpleNamespace
from typing import Any, ClassVar

import casadi as ca
import numpy as np

Symbol = Any  # a CasADi SX expression; CasADi has no type information
Shape = tuple[int, ...]
ShapeDeclaration = int | str | tuple[Any, ...] | Callable[[Any], Shape]

sin, cos, tan, exp, log, sqrt, tanh = ca.sin, ca.cos, ca.tan, ca.exp, ca.log, ca.sqrt, ca.tanh
absolute, sign, floor, mod = ca.fabs, ca.sign, ca.floor, ca.fmod
minimum, maximum, arctan2, where = ca.fmin, ca.fmax, ca.atan2, ca.if_else


def vec(*items: Symbol) -> Symbol:
    """Stack scalars or columns into one column."""
    return ca.vertcat(*items)


def concatenate(items: list[Symbol]) -> Symbol:
    """Stack the row-major entries of every item into one column."""
    return ca.vertcat(*[flatten(ca.SX(item)) for item in items])


def matrix(table: Any) -> Symbol:
    """Return a nested list of scalar expressions as a matrix, shape (rows, columns)."""
    return ca.vertcat(*[ca.horzcat(*row) for row in table])


def rows(value: Symbol) -> list[Symbol]:
    """Return the rows of a column or matrix as a list (scalars for a column)."""
    return list(ca.vertsplit(ca.SX(value)))


def sum_of(value: Symbol) -> Symbol:
    """Return the sum of all entries, shape ()."""
    return ca.sum1(ca.sum2(value))


def solve(a: Symbol, b: Symbol) -> Symbol:
    """Return the solution y of the small dense system a y = b."""
    return ca.solve(a, b)


def zeros(*shape: int) -> Symbol:
    """Return zeros of shape (), (n,) or (n, m)."""
    return ca.SX(np.zeros(matrix_shape(tuple(shape))))


def matrix_shape(shape: Shape) -> tuple[int, int]:
    """Return the rows and columns of the symbol that holds a value of this shape."""
    padded = (*shape, 1, 1)[:2]
    return int(padded[0]), int(padded[1])


def size_of(shape: Shape) -> int:
    """Return the number of entries of a value of this shape."""
    return math.prod(int(n) for n in shape)


def flatten(value: Symbol) -> Symbol:
    """Return the entries in row-major order (the order of names, files and vectors) as one column."""
    return value if value.shape[1] == 1 else ca.vec(value.T)


def unflatten(column: Symbol, shape: Shape) -> Symbol:
    """Invert `flatten`."""
    n_rows, n_columns = matrix_shape(shape)
    return column if n_columns == 1 else ca.reshape(column, n_columns, n_rows).T


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """Common part of every declaration.

    name: the attribute's name, unless given (a parameter and a port may then have one name).

    shape: ``()`` scalar, ``n``, ``(n, m)``; an entry may be the name of an option (its value, or its
    length if a list) or any other word, a dimension found from wires and parameter values; a bare word
    instead of a tuple is a whole shape found in the same way; a function of the options is allowed.
    unit: SI unit text (``"N s/m"``), ``"1"`` for a pure number, ``None`` for whatever is wired.
    """

    shape: ShapeDeclaration = ()
    unit: str | None = "1"
    doc: str = ""
    name: str = ""


@dataclass(frozen=True, kw_only=True)
class In(Declaration):
    """Declare an input port.

    optional: may be left unwired; ``u.<name>`` is then ``None``.
    additive: any number of wires, also none; their sum is the input (forces on a rotor).
    by_parts: wires may lead to its parts, as ``[1]``, each of them one; together they make up all of it.
    conjugate: output port on whose rate this input does work (displacement for a force, tilt for a moment):
    there an equivalent force can be found from measured motion.
    many: name of an option that says how many ports there are: a whole number n (or a text of n letters,
    such as signs "+-") gives name1..namen, a list of strings gives ports of these names; ``u.<name>`` is
    then a list. Words in its shape that end in "*" stand for something else at each of these ports.
    """

    optional: bool = False
    additive: bool = False
    by_parts: bool = False
    conjugate: str | None = None
    many: str | None = None


@dataclass(frozen=True, kw_only=True)
class Out(Declaration):
    """Declare an output port; ``many`` as for `In`."""

    additive: ClassVar[bool] = False
    many: str | None = None


@dataclass(frozen=True)
class Param(Declaration):
    """Declare a numeric parameter: a run-time argument, changed without compiling again.

    default None: must be given. low, high: closed bounds; above: open lower bound. tolerance: standard uncertainty of
    a stated value that nobody measured (damping, as a rule): a diagnosis leaves it free within that. series: of a part
    that others act through, as the stiffness of a support: the larger it is, the less it shows, so that a fit looks for
    its reciprocal; it cannot be negative. Raises ValueError for such a part without a bound that says so.
    """

    default: Any = None
    _: KW_ONLY
    low: float | None = None
    high: float | None = None
    above: float | None = None
    tolerance: float | None = None
    series: bool = False

    def __post_init__(self) -> None:
        lowest = self.low if self.above is None else self.above
        if self.series and (lowest is None or lowest < 0):
            raise ValueError("what is in series cannot be negative: low or above must say so")


@dataclass(frozen=True)
class Option(Declaration):
    """Declare an option that fixes structure (a count, a list of nodes, a law by name); it is compiled in.

    kind: type of the value, or of the entries of a list; choices: allowed values; low, high, above: bounds of a number,
    or of each entry of a list, as of `Param`. unit: of a number (kind float), which may be a text with a unit then.
    listed: it is a list, where no default says so (default None: it must be given).
    """

    default: Any = None
    _: KW_ONLY
    choices: tuple[Any, ...] | None = None
    kind: type | tuple[type, ...] | None = None
    low: float | None = None
    high: float | None = None
    above: float | None = None
    listed: bool = False

    @property
    def is_list(self) -> bool:
        """Whether the value is a list."""
        return self.listed or isinstance(self.default, list | tuple)


@dataclass(frozen=True, kw_only=True)
class State(Declaration):
    """Declare a continuous state; ``init`` is a number or the name of a parameter.

    unless_wired: the state exists only while this optional input is not wired.
    when: function of the options; the state exists only where it returns True.
    fresh: it begins from ``init`` with the first sample of every recorded run, however slow it is.
    begins: the input whose value at the first sample of a recorded run is the first guess of where it begins there, if
    ``init`` is zero: that of a machine at rest, and inside a gap.
    """

    discrete: ClassVar[bool] = False
    init: float | str = 0.0
    unless_wired: str | None = None
    when: Callable[[Any], bool] | None = None
    fresh: bool = False
    begins: str = ""


@dataclass(frozen=True, kw_only=True)
class DiscreteState(State):
    """Declare a state that changes only at the hits of the block's sample time."""

    discrete: ClassVar[bool] = True


@dataclass(frozen=True, kw_only=True)
class Random(Declaration):
    """Declare independent standard normal draws, new at every hit; ``seed`` names the parameter."""

    seed: str = "seed"


@dataclass(frozen=True)
class Equations:
    """What ``Block.equations`` returns, by declared name.

    outputs: every output port (a list for ``many`` ports). derivatives: every continuous state.
    update: the value after a hit of every discrete state. events: expressions whose zero crossing
    an adaptive solver must locate (the right-hand side has a kink or a jump there).
    """

    outputs: Mapping[str, Symbol] = field(default_factory=dict)
    derivatives: Mapping[str, Symbol] = field(default_factory=dict)
    update: Mapping[str, Symbol] = field(default_factory=dict)
    events: Mapping[str, Symbol] = field(default_factory=dict)


_KINDS = {"inputs": In, "outputs": Out, "parameters": Param, "options": Option, "states": State, "randoms": Random}
_CATEGORIES = {  # folder of built-in block files -> category of its blocks, unless a block says another
    "rotorsim.blocks.rotors": "rotor",
    "rotorsim.blocks.bearings": "bearing",
    "rotorsim.blocks.controllers": "controller",
    "rotorsim.blocks.excitations": "excitation",
    "rotorsim.blocks.faults": "fault",
}

_PORTS_OF_ROLES = (  # role, an input of these names, an output of these
    ("rotor", {"force", "current"}, {"displacement"}),
    ("controller", {"displacement", "velocity"}, {"current"}),
    ("bearing", {"displacement", "velocity"}, {"force"}),
    ("bearing", {"current"}, {"force", "displacement"}),
)


class Block:
    """Base of all blocks: subclasses declare ports, parameters and states and define ``equations``.

    An attribute may also be a tuple of declarations, each with its ``name``: what several blocks share, or a series.
    ``type_name`` (default: the class name in snake_case) is the ``"type"`` of diagram JSON.
    ``sample_time`` names the parameter that holds the sample period [s] of a discrete block; a parameter
    declared as ``sample_time`` is that one.
    ``category`` is that of the folder of a built-in block, "elementary" elsewhere, unless the block says it.
    ``roles`` are the parts of a machine that it may be: its category; of a block without one (an FMU, a user's own)
    those whose inputs and outputs it has, by their names: a plant from current to displacement is rotor and bearing.
    ``source`` cites where the equations are from. Subclasses are final: reuse by functions.
    """

    type_name: ClassVar[str] = ""
    sample_time: ClassVar[Any] = None
    source: ClassVar[str] = ""
    category: ClassVar[str] = "elementary"
    roles: ClassVar[frozenset[str]] = frozenset()
    faults: ClassVar[tuple[Any, ...]] = ()  # rotorsim.fault.Fault: physics that a diagnosis may add by this block
    refinement: ClassVar[str | None] = None  # option that makes the block more exact as it grows (a finer mesh)
    no_signals: ClassVar[Mapping[str, str]] = {}  # names that may be taken for outputs, and what they are
    opaque: ClassVar[bool] = False  # its equations are elsewhere (an FMU): they are called, or co-simulated

    inputs: ClassVar[dict[str, In]] = {}
    outputs: ClassVar[dict[str, Out]] = {}
    parameters: ClassVar[dict[str, Param]] = {}
    options: ClassVar[dict[str, Option]] = {}
    states: ClassVar[dict[str, State]] = {}
    randoms: ClassVar[dict[str, Random]] = {}

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "type_name" not in cls.__dict__:
            cls.type_name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()
        if "category" not in cls.__dict__:
            folder = ".".join(cls.__module__.split(".")[:3])
            cls.category = _CATEGORIES.get(folder, cls.category)
        declared = [
            item if item.name else replace(item, name=name)
            for name, value in vars(cls).items()
            for item in (value if isinstance(value, tuple) else (value,))
            if isinstance(item, Declaration)
        ]
        for kind, type_ in _KINDS.items():
            setattr(cls, kind, {**getattr(cls, kind), **{d.name: d for d in declared if isinstance(d, type_)}})
        if "sample_time" in cls.parameters and not isinstance(cls.sample_time, str):
            cls.sample_time = "sample_time"  # the parameter took the name of this class attribute
        known = cls.category != "elementary" and not cls.opaque
        fitting = {role for role, to, of in _PORTS_OF_ROLES if to & cls.inputs.keys() and of & cls.outputs.keys()}
        cls.roles = frozenset({cls.category} | (set() if known else fitting))

    def __init__(self, option_values: Mapping[str, Any] | None = None, wired: frozenset[str] = frozenset()) -> None:
        """Hold option values (complete, already validated) and the names of the wired inputs."""
        defaults = {name: option.default for name, option in self.options.items()}
        self.option = SimpleNamespace(**{**defaults, **(option_values or {})})
        self.wired = wired

    def equations(self, p: Any, u: Any, x: Any, t: Symbol) -> Equations:
        """Return outputs, derivatives, updates and events as expressions of p, u, x and t.

        p: parameters, u: inputs, x: states (continuous, discrete, random), each by attribute; t: time [s].
        """
        raise NotImplementedError

    def linear_equations(self, p: Any, u: Any, x: Any, t: Symbol) -> Equations | None:
        """Return equations of an opaque block that is said to be linear, its factors written out; None for others.

        Analyses take them in the place of ``equations``, runs do not.
        """
        return None

    def starts(self, p: Any) -> Mapping[str, Symbol]:
        """Return where states begin whose ``init`` does not say it, as expressions of p (default: none)."""
        return {}

    def untraced(self) -> tuple[str, str]:
        """Return why an opaque block has no equations that can be called, with a hint; empty where it has."""
        return "", ""

    def mode(self, p: Any) -> Any:
        """Return what changes the equations of an opaque block at events (`rotorsim.model.mode.Mode`), or None.

        p: parameter values, each by attribute.
        """
        return None

    def check(self, values: Mapping[str, np.ndarray]) -> list[str]:
        """Return messages on options and parameter values that contradict one another (default: none)."""
        return []

    def check_given(self, given: Mapping[str, np.ndarray]) -> list[tuple[str, tuple[int, ...], str, str]]:
        """Return mistakes in options and in the parameters given (default: none), each where it is written.

        A mistake is the name of the option or parameter, the indices in its list, what is wrong, and a hint. They are
        told beside all other mistakes of the diagram. given: SI arrays as written, without defaults, of any shape; NaN
        for what is written, but no such value, which is said already.
        """
        return []

    def holds_below(self, p: Any) -> Mapping[str, float]:
        """Return by input the magnitude [SI] of its entries from which on the equations do not hold (default: none).

        p: parameter values, each by attribute.
        """
        return {}

    def port_names(self, declaration: In | Out) -> list[str]:
        """Return the names of the ports that a declaration stands for under the current options."""
        if declaration.many is None:
            return [declaration.name]
        count = getattr(self.option, declaration.many)
        if isinstance(count, list | tuple):
            return [str(name) for name in count]
        return [f"{declaration.name}{k}" for k in range(1, (len(count) if isinstance(count, str) else count) + 1)]

    def active_states(self) -> dict[str, State]:
        """Return the states that exist under the current options and wiring."""
        return {
            name: state
            for name, state in self.states.items()
            if not (state.unless_wired and state.unless_wired in self.wired)
            and (state.when is None or state.when(self.option))
        }

    def declared_shape(self, declaration: Declaration, port: str = "") -> Any:
        """Return the shape with options filled in: a tuple of whole numbers and words, or one word.

        port: of a declaration of many: words that end in "*" are made its own.
        """
        shape = declaration.shape(self.option) if callable(declaration.shape) else declaration.shape
        if isinstance(shape, str):
            return f"{shape}{port}" if shape.endswith("*") else shape
        return tuple(self._dimension(entry, port) for entry in (shape if isinstance(shape, tuple) else (shape,)))

    def output_shapes(self, inputs: Mapping[str, Shape]) -> dict[str, Shape]:
        """Return shapes of outputs that follow from those of the wired inputs as no word can say (default: none)."""
        return {}

    def _dimension(self, entry: Any, port: str) -> int | str:
        value = getattr(self.option, entry, None) if isinstance(entry, str) else entry
        if value is None:
            return f"{entry}{port}" if entry.endswith("*") else str(entry)
        return int(value) if isinstance(value, int | np.integer) else len(value)
