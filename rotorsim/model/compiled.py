"""A compiled diagram: its functions as CasADi functions and as a C library, its parameters by name."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from rotorsim.diagram.diagram import Diagram, Endpoint
from rotorsim.diagram.resolve.values import ValueProblem, bounds_problem, numeric
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.model.called import connect, forget_failures, raise_failure
from rotorsim.model.emit.emit import Kernel, build_kernel, emit_c
from rotorsim.model.emit.toolchain import Compiler, CompilerError, compile_c, compiler_error, find_compiler
from rotorsim.model.linearity import is_affine, jacobian
from rotorsim.model.trace.diagram import Signal, Trace, flat_indices, trace_diagram


class Library:
    """The C functions of one diagram (``handle.rs_run`` and others, see runtime.c), and how they came about."""

    def __init__(self, kernel: Kernel, compiler: Compiler) -> None:
        self.kernel = kernel
        self.source = emit_c(kernel)
        self.compiler = compiler.name
        self.handle, self.cached = compile_c(self.source, compiler, "-O3" if kernel.unrolled else "-O2")
        i64, f64, ptr = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
        for name, arguments, result in (
            ("rs_size", [], i64),
            ("rs_prepare", [ptr, ptr], None),
            ("rs_start", [f64, ptr, ptr], None),
            ("rs_sample", [f64, ptr, ptr], None),
            ("rs_derivative", [f64, ptr, ptr, ptr, ptr, ptr], None),
            ("rs_record", [f64, ptr, ptr, ptr, ptr, ptr], None),
            ("rs_derivatives", [i64, ptr, ptr, ptr, ptr, i64, ptr, ptr], None),
            ("rs_run", [ptr, ptr, i64, i64, f64, f64, i64, ptr], i64),
            ("rs_run_stepwise", [ptr, ptr, i64, i64, f64, f64, i64, ptr, ptr, ptr, i64, ptr], i64),
            *([("rs_next", [ptr, ptr], f64)] if kernel.trace.samplers else []),
        ):
            function = getattr(self.handle, name, None)
            if function is None:
                raise compiler_error(compiler.command[0], f"wrote a library without {name}")
            function.argtypes, function.restype = arguments, result
        connect(self.handle, kernel.called)

    def memory(self) -> np.ndarray:
        """Return zeroed memory of one instance."""
        return np.zeros(int(self.handle.rs_size()))


def compiled_in(name: str, option: str) -> Problem:
    """Return why a diagram parameter that an option follows cannot change in a compiled model."""
    what = f"is followed by the option {option}: another value makes other equations"
    return Problem(what, name, hint=f"load(..., set={{'{name}': ...}}), or --set {name}=...")


class Model:
    """A diagram ready to be simulated and analysed.

    Vectors: x (n_x,) continuous states, z (n_z,) discrete states, p parameters, all row-major.
    """

    def __init__(self, diagram: Diagram, trace: Trace) -> None:
        self.diagram = diagram
        self.trace = trace
        self.states: Mapping[str, Signal] = trace.states
        self.signals: Mapping[str, Signal] = trace.ports
        self.parameters = {name: signal.part for name, signal in trace.parameters.items()}
        self.n_x = trace.x.numel()
        self.n_z = trace.z.numel()
        self.n_p = trace.p.numel()
        self._outputs: dict[tuple[str, ...], ca.Function] = {}
        self._selected: dict[str, tuple[Signal, np.ndarray]] = {}
        self._libraries: dict[tuple[str, ...], Library | None] = {}
        self.hidden: tuple[str, ...] = ()  # blocks that are run elsewhere: this model has names and values alone
        self.without = "no C compiler"  # why a run is without one, if it is
        values = (value for node in diagram.nodes.values() for value in node.values.values())
        self.p0 = np.concatenate([np.zeros(0), *map(np.ravel, values)])

    def parameter_vector(self, overrides: Mapping[str, Any] | None = None) -> np.ndarray:
        """Return p with some values replaced; diagram parameters by name set all that refer to them.

        overrides: SI numbers, or texts with a unit ("1800 rpm"), by names or those of entries (``controller.KD[2]``).
        Raises RotorsimError for unknown names and entries, texts that do not fit, values outside the declared bounds
        and wrong shapes.
        """
        p = self.p0.copy()
        problems = []
        for name, value in (overrides or {}).items():
            base = name.partition("[")[0]
            if base in self.diagram.structural:
                problems.append(compiled_in(base, self.diagram.structural[base]))
                continue
            try:
                parts = self.positions(name)
            except RotorsimError as error:
                problems += error.problems
                continue
            if not parts:
                near = near_miss(name, [*self.diagram.parameters, *self.parameters], list_all=False, most=1)
                hint = near or "`rotorsim blocks TYPE` lists parameters"
                problems.append(Problem(what="no such parameter", subject=name, hint=hint))
                continue
            for target, part in parts.items():
                try:
                    given = self._value(target, value)
                except ValueProblem as problem:
                    problems.append(Problem(what=problem.what, subject=name, hint=problem.hint))
                    break
                if given.size not in (1, len(part)):
                    problems.append(Problem(what=f"{given.size} values given, {len(part)} expected", subject=name))
                else:
                    p[part] = given.ravel()
        if problems:
            raise RotorsimError(*problems)
        return p

    def _value(self, name: str, value: Any) -> np.ndarray:
        """Return a value for a parameter of a block ("" for one that no block follows) in SI; raise ValueProblem."""
        block, _, key = name.rpartition(".")
        if not block:
            return numeric(value, None)
        declared = self.diagram.nodes[block].block.parameters[key]
        array = numeric(value, declared.unit)
        outside = bounds_problem(array, declared)
        if outside is not None:
            raise outside
        return array

    def positions(self, name: str) -> dict[str, np.ndarray]:
        """Return the parameters of blocks that a name, or that of an entry, sets, and where in p; {} for unknown ones.

        Raises RotorsimError for an entry that is not there.
        """
        base, bracket, inside = name.partition("[")
        parts = {base: self.parameters[base]} if base in self.parameters else {}
        if base in self.diagram.parameters:
            parts = self._followers.get(base, {}) or {"": slice(0, 0)}
        found = {target: np.arange(part.start, part.stop) for target, part in parts.items()}
        if not bracket:
            return found
        numbers = inside.removesuffix("]").split(",") if inside.endswith("]") else []
        for target in filter(None, found):
            shape = self.trace.parameters[target].shape
            index = tuple(int(part) - 1 for part in numbers if part.strip().isdigit())
            fits = len(index) == len(numbers) == len(shape) > 0
            if not fits or not all(0 <= i < n for i, n in zip(index, shape, strict=True)):
                size = " x ".join(map(str, shape)) or "a single number"
                raise RotorsimError(Problem(f"no such entry; the parameter is {size}, counted from 1", name))
            found[target] = found[target][flat_indices(shape, index)]
        return found

    @cached_property
    def _followers(self) -> dict[str, dict[str, slice]]:
        followers: dict[str, dict[str, slice]] = {}
        for block, node in self.diagram.nodes.items():
            for key, reference in node.references.items():
                followers.setdefault(reference, {})[f"{block}.{key}"] = self.parameters[f"{block}.{key}"]
        return followers

    @cached_property
    def references(self) -> dict[str, list[slice]]:
        """Diagram parameter -> the parts of p that follow it."""
        return {name: list(parts.values()) for name, parts in self._followers.items()}

    @cached_property
    def _initial(self) -> ca.Function:
        return ca.Function("initial", [self.trace.p], [ca.densify(self.trace.x0), ca.densify(self.trace.z0)])

    def initial(self, p: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the initial states x (n_x,) and z (n_z,)."""
        forget_failures()
        x, z = self._initial(self.p0 if p is None else p)
        raise_failure()
        return np.array(x).ravel(), np.array(z).ravel()

    def x0(self, p: np.ndarray | None = None) -> np.ndarray:
        """Return the initial continuous states, shape (n_x,)."""
        return self.initial(p)[0]

    def z0(self, p: np.ndarray | None = None) -> np.ndarray:
        """Return the initial discrete states, shape (n_z,)."""
        return self.initial(p)[1]

    @property
    def _arguments(self) -> list[Any]:
        return [self.trace.t, self.trace.x, self.trace.z, self.trace.p]

    @cached_property
    def rhs(self) -> ca.Function:
        """dx/dt as a CasADi function of (t, x, z, p)."""
        return ca.Function("rhs", self._arguments, [ca.densify(self.closed(self.trace.xdot))])

    @cached_property
    def jacobian_expression(self) -> Any:
        """Sparse d(dx/dt)/dx as an expression of the trace's symbols."""
        return jacobian(self.closed(self.trace.xdot), self.trace.x)

    @cached_property
    def jacobian(self) -> ca.Function:
        """d(dx/dt)/dx, sparse (n_x, n_x), as a CasADi function of (t, x, z, p)."""
        return ca.Function("jacobian", self._arguments, [self.jacobian_expression])

    @cached_property
    def linear(self) -> bool:
        """Whether dx/dt is linear in x with constant coefficients (its Jacobian has neither x nor t)."""
        if not is_affine(self.closed(self.trace.xdot), self.trace.x):
            return False
        return not ca.depends_on(self.jacobian_expression, ca.vertcat(self.trace.x, self.trace.t))

    def closed(self, expression: Any) -> Any:
        """Return an expression with the external inputs (if any were asked for) at zero."""
        v = self.trace.v
        return ca.substitute(expression, v, ca.SX.zeros(*v.shape)) if v.numel() else expression

    def output(self, names: Sequence[str]) -> ca.Function:
        """Return the named signals, stacked row-major, as a CasADi function of (t, x, z, p).

        A name may select a part: ``rotor.displacement[3]`` (counted from 1).
        """
        key = tuple(names)
        if key not in self._outputs:
            column = ca.vertcat(*[self.expression(name) for name in key]) if key else ca.SX(0, 1)
            self._outputs[key] = ca.Function("output", self._arguments, [ca.densify(self.closed(column))])
        return self._outputs[key]

    def expression(self, name: str) -> Any:
        """Return the column of a signal (or of a part of it) as an expression of the trace's symbols."""
        signal, positions = self.select(name)
        column = self.trace.signals[signal.name]
        return column if len(positions) == column.shape[0] else column[positions.tolist()]

    def select(self, name: str) -> tuple[Signal, np.ndarray]:
        """Return the signal of a name such as ``rotor.displacement[3,1]`` and the row-major entries it selects."""
        if name not in self._selected:
            self._selected[name] = self._select(name)
        return self._selected[name]

    def _select(self, name: str) -> tuple[Signal, np.ndarray]:
        base, bracket, inside = name.partition("[")
        signal = self.signals.get(base)
        if signal is None:
            raise RotorsimError(Problem("no such signal", name, hint=near_miss(base, self.signals, most=1)))
        try:
            index = tuple(int(part) - 1 for part in inside.rstrip("]").split(",")) if bracket else ()
            if any(i < 0 for i in index):
                raise IndexError
            return signal, flat_indices(signal.shape, index)
        except (ValueError, IndexError):
            shape = " x ".join(map(str, signal.shape)) or "scalar"
            raise RotorsimError(
                Problem(what=f"no such entry; '{base}' has shape {shape}, counted from 1", subject=name)
            ) from None

    def record_names(self, record: Iterable[str | Endpoint] | None = None) -> tuple[str, ...]:
        """Return what a run records, by name: what is asked for, else what the diagram says."""
        return tuple(str(item) for item in (self.diagram.record if record is None else record))

    def shape_of(self, name: str) -> tuple[int, ...]:
        """Return the shape of a signal or of the part that a name selects."""
        signal, _ = self.select(name)
        dropped = name.count(",") + 1 if "[" in name else 0
        return signal.shape[dropped:]

    def kernel(self, record: Sequence[str]) -> Kernel:
        """Return the scalar programs that record the named signals."""
        recorded = [self.closed(self.expression(name)) for name in record]
        trace = self.trace
        if trace.v.numel():
            columns = ("xdot", "z_next", "events", "loop_residuals")
            trace = replace(trace, **{name: self.closed(getattr(trace, name)) for name in columns})
        return build_kernel(trace, recorded)

    def library(self, record: Sequence[str] = ()) -> Library | None:
        """Return the compiled C functions that record the named signals, or None without a compiler that works."""
        key = tuple(record)
        if key not in self._libraries:
            self._libraries[key] = self._compiled(key)
        return self._libraries[key]

    def _compiled(self, record: Sequence[str]) -> Library | None:
        compiler = find_compiler()
        if compiler is None:
            return None
        try:
            return Library(self.kernel(record), compiler)
        except CompilerError as failure:
            self.without = "the C compiler failed"
            failure.warn("the model runs on CasADi's virtual machine: the same numbers, several times slower")
            return None

    def rhs_batch(self, t: np.ndarray, x: np.ndarray, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return dx/dt of n instants: t (n,), x (n, n_x), z (n_z,), p (n, n_p) -> (n, n_x)."""
        forget_failures()
        t, x, p, z = (np.ascontiguousarray(a, float) for a in (t, x, p, z))
        compiled = (library for library in self._libraries.values() if library is not None)
        library = next(compiled, None) or self.library()  # whatever it records
        if library is None:
            columns = self.rhs(t[None, :], x.T, np.repeat(z[:, None], len(t), 1), p.T)
            raise_failure()
            return np.array(columns).T
        out = np.empty((len(t), self.n_x))
        m = library.memory()
        addresses = [a.ctypes.data for a in (t, x, z, p)]
        library.handle.rs_derivatives(len(t), *addresses, self.n_p, m.ctypes.data, out.ctypes.data)
        raise_failure()
        return out

    def block_of_state(self, position: int) -> str:
        """Return the name of the block that owns an entry of x."""
        return self.trace.state_blocks[position]


def compile_diagram(
    diagram: Diagram, *, inject: Iterable[str] = (), replace: Iterable[str] = (), called: bool = False
) -> Model:
    """Trace a diagram and return its model; C is generated and compiled when first needed.

    inject, replace, called: see `trace_diagram`. Raises RotorsimError.
    """
    return Model(diagram, trace_diagram(diagram, inject, replace, called=called))


def model_for_runs(diagram: Diagram | Model, *, called: bool = True) -> Model:
    """Return the model of a diagram, or one of names and values alone where a part hides its equations.

    called: opaque parts as they are at every instant, though they are said to be linear. Raises RotorsimError.
    """
    if isinstance(diagram, Model):
        return diagram
    opaque = {name: node for name, node in diagram.nodes.items() if node.block.opaque}
    hidden = tuple(name for name, node in opaque.items() if node.block.untraced()[0])
    if not hidden:
        return compile_diagram(diagram, called=called)
    theirs = [str(port) for node in opaque.values() for port in node.outputs.values()]
    model = Model(diagram, trace_diagram(diagram, replace=theirs, foreign=opaque))
    model.hidden = hidden
    return model
