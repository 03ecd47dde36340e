"""A loop of a diagram into which a test signal is injected: at a sensor's signal, or at the output of a controller."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial
from typing import Any
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from rotorsim.block import size_of
from rotorsim.diagram.diagram import Diagram, wrong_port
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.linear.exponentials import Exponentials
from rotorsim.linear.linear_model import MOST_HITS, LinearModel, LinearPart
from rotorsim.linear.linearisation import as_model, entry_names, linearise, require_finite
from rotorsim.linear.sampled_data import SampledData
from rotorsim.linear.stability import growing, growing_multipliers
from rotorsim.linear.state_space import StateSpace
from rotorsim.model.compiled import Model
from rotorsim.model.part import open_part
from rotorsim.model.trace.diagram import flat_indices

SENSOR, RATE = "displacement", "velocity"  # input ports of a controller: one sensor's signal, and what is made of it
MANY_SPEEDS = 20  # from which on exp(A h) is interpolated: it is computed at 9, or more, for each length h
DELAY_ERROR = 0.01  # of a signal, which a Pade approximation may be off before it is said


@dataclass(frozen=True)
class Injection:
    """One entry of a port where a test signal is added: V2 is the signal that arrives there, of a unit.

    entry: its position in the port. rate_of: position among all of the entry whose rate this is; its test signal is
    dE/dt of that one. None: an axis.
    """

    name: str
    port: str
    signal: str
    unit: str
    entry: int = 0
    rate_of: int | None = None


def open_loop_of(S: Any) -> Any:
    """Return G_o = 1 / S - 1."""
    return 1 / np.asarray(S) - 1


def sensor_ports(diagram: Diagram) -> list[str]:
    """Return the sensors' signals of all controllers: their input ports ``displacement`` that something feeds."""
    fed = {(wire.target.block, wire.target.port) for wire in diagram.wires}
    blocks = [name for name, node in diagram.nodes.items() if node.block.category == "controller"]
    found = [f"{name}.{SENSOR}" for name in blocks if (name, SENSOR) in fed]
    if not found:
        hint = "name the ports of its bearing loops: where a sensor's signal arrives, or the output of a controller"
        raise RotorsimError(Problem("no controller with a wired input 'displacement'", diagram.name, hint=hint))
    return found


def controller_output(diagram: Diagram | Model, controller: str) -> str:
    """Return the output port of a controller block: ``current`` if it has one, else its only output.

    Raises RotorsimError for an unknown block and for several outputs.
    """
    nodes = diagram.diagram.nodes if isinstance(diagram, Model) else diagram.nodes
    if controller not in nodes:
        raise RotorsimError(Problem(what="no such block", subject=controller, hint=near_miss(controller, nodes)))
    ports = list(nodes[controller].outputs)
    if "current" in ports:
        return f"{controller}.current"
    if len(ports) != 1:
        what = f"a controller has an output 'current' or a single one; this block has {', '.join(ports) or 'none'}"
        raise RotorsimError(Problem(what=what, subject=controller))
    return f"{controller}.{ports[0]}"


def injections(diagram: Diagram, ports: Sequence[str]) -> tuple[Injection, ...]:
    """Return where test signals are added for input or output ports, or parts of them (``controller.displacement[1]``).

    Entries of an input that nothing feeds are left out. Raises RotorsimError for all wrong ports.
    """
    found: list[Injection] = []
    problems: list[Problem] = []
    for port in ports:
        try:
            found += _injections(diagram, port, len(found))
        except RotorsimError as error:
            problems += error.problems
    if problems:
        raise RotorsimError(*problems)
    return tuple(found)


def _injections(diagram: Diagram, port: str, count: int) -> list[Injection]:
    """Return those of one port, behind ``count`` others."""
    base, places = part_of_port(diagram, port)
    block, _, name = base.rpartition(".")
    node = diagram.nodes[block]
    declared = node.outputs.get(name) or node.inputs[name]
    names, unit = entry_names(base, declared.shape), declared.unit or "1"
    if name in node.outputs:
        return [Injection(names[k], base, names[k], unit, k) for k in places]
    signals = entering(diagram, block, name)
    if any(signals[k] is None for k in places):
        hint = "each entry of the input needs one wire; or name the output port that feeds it"
        raise RotorsimError(Problem("not every entry of this input is one signal", port, hint=hint))
    fed = [k for k in places if signals[k]]
    if not fed:
        hint = "name a port that a wire comes to, or an output port"
        raise RotorsimError(Problem("nothing is wired to this input: no loop passes", port, hint=hint))
    made = [Injection(names[k], base, signals[k] or "", unit, k) for k in fed]
    rates = entering(diagram, block, RATE) if name == SENSOR and RATE in node.inputs else []
    of_rate = f"{block}.{RATE}"
    pairs = [(at, k, rates[k]) for at, k in enumerate(fed, count) if rates and rates[k]]
    return made + [Injection(of_rate, of_rate, signal or "", "", k, at) for at, k, signal in pairs]


def part_of_port(diagram: Diagram, name: str) -> tuple[str, list[int]]:
    """Return the port of a name such as ``rotor.force[3,1]`` or ``rotor.force[3]``, and the positions of its entries.

    Raises RotorsimError for ports and entries that are not there.
    """
    base, bracket, inside = name.partition("[")
    block, _, port = base.rpartition(".")
    node = diagram.nodes.get(block)
    declared = None if node is None else node.outputs.get(port) or node.inputs.get(port)
    if declared is None:
        raise RotorsimError(wrong_port(diagram, name))
    try:
        index = tuple(int(part) - 1 for part in inside.removesuffix("]").split(",")) if bracket else ()
        if min(index, default=0) < 0 or (bracket and not (inside.endswith("]") and declared.shape)):
            raise IndexError
        return base, flat_indices(declared.shape, index).tolist()
    except (ValueError, IndexError):
        raise RotorsimError(wrong_port(diagram, name)) from None


def disturbed(diagram: Diagram | Model, name: str) -> tuple[Model, str, list[int]]:
    """Return the model with a port that a test signal is added to, the port, and the entries of a name of it."""
    if isinstance(diagram, Model) and (given := diagram.trace.external.get(name)) is not None:
        return diagram, name, list(range(size_of(given.shape)))
    port, places = part_of_port(diagram.diagram if isinstance(diagram, Model) else diagram, name)
    return as_model(diagram, (port,)), port, places


def entering(diagram: Diagram, block: str, port: str) -> list[str | None]:
    """Return the name of the signal that arrives at each entry of an input port; "" where none, None where several."""
    shape = diagram.nodes[block].inputs[port].shape
    entries: np.ndarray = np.full(size_of(shape), "", object)
    for wire in diagram.wires:
        if (wire.target.block, wire.target.port) != (block, port):
            continue
        source = diagram.nodes[wire.source.block].outputs[wire.source.port]
        names = np.array(entry_names(f"{wire.source.block}.{wire.source.port}", source.shape), object)
        places = flat_indices(shape, wire.target.index)
        coming = names[flat_indices(source.shape, wire.source.index)]
        entries[places] = np.where(entries[places] == "", coming, None)
    return [None if one is None else str(one) for one in entries]


def arriving(diagram: Diagram, block: str, port: str) -> list[str] | None:
    """Return the name of the signal that arrives at each entry of an input port; None where one has none or several."""
    found = [name for name in entering(diagram, block, port) if name]
    return found if len(found) == size_of(diagram.nodes[block].inputs[port].shape) else None


class Loop:
    """A diagram, linear about its operating point, from test signals to the signals that they are added to.

    axes: the injections but for rates. one_unit: of all axes, so that singular values mean something.
    """

    def __init__(
        self,
        diagram: Diagram | Model,
        given: Sequence[Injection],
        parameters: Mapping[str, Any] | None = None,
        at: np.ndarray | None = None,
    ) -> None:
        self.injections = tuple(given)
        self._place = [k for k, one in enumerate(given) if one.rate_of is None]
        self.axes = tuple(given[k] for k in self._place)
        self.one_unit = len({axis.unit for axis in self.axes}) == 1
        ports = tuple(dict.fromkeys(one.port for one in given))
        signals = [one.signal for one in given]
        self.model = as_model(diagram, ports)
        whole, self._notes = linear_system(self.model, ports, signals, parameters, at)
        sizes = [size_of(self.model.trace.external[port].shape) for port in ports]
        first = dict(zip(ports, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))
        self.system = whole.with_inputs([first[one.port] + one.entry for one in given])
        self.is_sampled = isinstance(self.system, SampledData)
        self.fastest_rate = 1 / self.system.shortest if isinstance(self.system, SampledData) else np.inf

    def sensitivity(self, frequencies: Any) -> np.ndarray:
        """Return S (n, m, m) of the axes at frequencies [Hz]: V1 = S E."""
        f = np.atleast_1d(np.asarray(frequencies, float))
        test = np.zeros((len(f), len(self.injections), len(self._place)), complex)
        for k, one in enumerate(self.injections):
            axis = self._place.index(k if one.rate_of is None else one.rate_of)
            test[:, k, axis] = 1.0 if one.rate_of is None else 2j * np.pi * f
        return np.asarray((self.system.response(f) @ test)[:, self._place] + np.eye(len(self._place)))

    def poles(self) -> np.ndarray:
        """Return the poles [1/s] of the closed loop and of those with an axis open; with samples, between hits too.

        Near all of these S or G_o may change within a narrow band.
        """
        loops = [self.system, *(self.amplified(0.0, k) for k in range(len(self.axes)))]
        between = [system.flow for system in loops if isinstance(system, SampledData)]
        return np.concatenate([system.poles() for system in (*loops, *between)])

    def closed_poles(self) -> np.ndarray:
        """Return the poles [1/s] of the closed loop; with samples, between hits too."""
        between = [self.system.flow.poles()] if isinstance(self.system, SampledData) else []
        return np.concatenate([self.system.poles(), *between])

    @cached_property
    def _stable(self) -> bool:
        return not len(growing_poles(self.system))

    def is_stable(self, gain: float = 1.0, axis: int = 0) -> bool:
        """Return whether the closed loop is stable, with the signal of an axis amplified."""
        return self._stable if gain == 1.0 else not len(growing_poles(self.amplified(gain, axis)))

    def amplified(self, gain: float, axis: int) -> StateSpace | SampledData:
        """Return the loop with the signal of an axis, and its rate, amplified."""
        place = self._place[axis]
        wires = [k for k, one in enumerate(self.injections) if place in (k, one.rate_of)]
        return self.system.amplified(gain, wires)

    def notes(self, highest: float) -> tuple[str, ...]:
        """Return what a reader must know of a loop that is looked at up to a frequency [Hz]."""
        return (
            *self._notes,
            *_without_signal(self.model.diagram, {axis.port for axis in self.axes}),
            *undisturbed_rates(self.model.diagram, {axis.port for axis in self.axes}),
            *_delays(self.model.diagram, highest),
        )


def growing_poles(system: StateSpace | SampledData) -> np.ndarray:
    """Return the poles [1/s] that grow, fastest first."""
    if isinstance(system, SampledData):
        return np.asarray(np.log(growing_multipliers(system.monodromy).astype(complex)) / system.period)
    return growing(system.A).poles


def linear_system(
    model: Model,
    ports: Sequence[str],
    signals: Sequence[str],
    parameters: Mapping[str, Any] | None = None,
    at: np.ndarray | None = None,
    told: bool = True,
) -> tuple[StateSpace | SampledData, tuple[str, ...]]:
    """Return a diagram, linear, from signals added at ports to signals, with sampled blocks exactly; and notes.

    told: see `linearise`. Raises RotorsimError as `linearise`, and for sampled blocks in a diagram that is not linear.
    """
    if not model.n_z:
        linear = linearise(model, parameters=parameters, inputs=ports, outputs=signals, at=at, told=told)
        return linear, linear.notes
    part = linear_part(model, ports, signals)
    return sampled_data(part.at(part.part.parameter_vector(parameters)), model), ()


def systems_at(
    model: Model, ports: Sequence[str], signals: Sequence[str], parameters: Mapping[str, Any] | None, speeds: np.ndarray
) -> Callable[[float, bool], tuple[StateSpace | SampledData, tuple[str, ...]]]:
    """Return `linear_system` of a speed between some [rad/s], and told; with samplers the speeds share exp(A h)."""

    def plain(speed: float, told: bool = False) -> tuple[StateSpace | SampledData, tuple[str, ...]]:
        return linear_system(model, ports, signals, {**(parameters or {}), "speed": speed}, told=told)

    if not model.n_z or len(speeds) < MANY_SPEEDS:
        return plain
    first, last = (plain(float(end))[0] for end in (speeds.min(), speeds.max()))
    assert isinstance(first, SampledData)
    assert isinstance(last, SampledData)
    shared = Exponentials(first.flow.A, last.flow.A)

    def sampled(speed: float, told: bool = False) -> tuple[StateSpace | SampledData, tuple[str, ...]]:
        system, notes = plain(speed, told)
        assert isinstance(system, SampledData)
        return replace(system, exponentials=shared), notes

    return sampled


_PARTS: WeakKeyDictionary[Model, dict[tuple[tuple[str, ...], tuple[str, ...]], LinearPart]] = WeakKeyDictionary()


def linear_part(model: Model, ports: Sequence[str], signals: Sequence[str]) -> LinearPart:
    """Return a diagram with sampled blocks as a linear part, made once. Raises RotorsimError where it is not linear."""
    known, asked = _PARTS.setdefault(model, {}), (tuple(ports), tuple(signals))
    if asked not in known:
        alike = next((one for (opened, _), one in known.items() if opened == asked[0]), None)
        if alike is None:
            known[asked] = LinearPart(open_part(model.diagram, inputs=ports), model.n_z, signals)
        else:
            known[asked] = alike.reading(signals)
    part = known[asked].part
    if not known[asked].exact:
        moving = ca.vertcat(part.trace.t, part.trace.x, part.trace.z)
        rates = ca.jacobian(part.trace.xdot, ca.vertcat(part.trace.x, part.trace.z))
        curved = {part.block_of_state(k) for k in range(part.n_x) if ca.depends_on(rates[k, :], moving)}
        subject = ", ".join(sorted(curved)) or ", ".join(sampler.block for sampler in part.trace.samplers)
        hint = "take the linear block ('amb' for 'amb_nonlinear'), or `rotorsim swap` a continuous controller in"
        raise RotorsimError(
            Problem("with sampled blocks a diagram must be linear, with constant coefficients", subject, hint=hint)
        )
    return known[asked]


def sampled_data(linear: LinearModel, model: Model) -> SampledData:
    """Return a model with its samplers. Raises RotorsimError without a common period, and where it is not finite."""
    require_finite(model, linear.A[: model.n_x, : model.n_x])
    system = SampledData.of(linear)
    if system is None:
        blocks = ", ".join(sampler.block for sampler in model.trace.samplers)
        what = f"their sample times have no common multiple within {MOST_HITS} hits"
        raise RotorsimError(Problem(what, blocks, hint="round them: 0.1 ms and 0.25 ms, not 0.1 ms and 0.2503 ms"))
    return system


def _without_signal(diagram: Diagram, ports: Collection[str]) -> list[str]:
    """Return the entries of input ports that nothing feeds, since their wires were cut: no loop passes through them."""
    said = []
    for port in sorted(ports):
        block, _, name = port.rpartition(".")
        node = diagram.nodes[block]
        if name in node.inputs:
            names = entry_names(port, node.inputs[name].shape)
            cut = [one for one, signal in zip(names, entering(diagram, block, name), strict=True) if signal == ""]
            said += [f"'{one}' is not wired: no loop passes there" for one in cut]
    return said


def undisturbed_rates(diagram: Diagram, ports: Collection[str]) -> list[str]:
    """Return the rates that pass by a test signal: wired velocities of controllers fed by an output port named."""
    said = []
    for wire in diagram.wires:
        port, end, node = f"{wire.source.block}.{wire.source.port}", wire.target, diagram.nodes[wire.target.block]
        is_sensor = port in ports and node.block.category == "controller" and end.port == SENSOR
        if is_sensor and RATE in node.inputs and arriving(diagram, end.block, RATE):
            rate = f"'{port}' is disturbed, and '{end.block}.{RATE}' is not"
            said.append(f"{rate}: name '{end.block}.{SENSOR}' where one sensor gives both")
    return list(dict.fromkeys(said))


def _delays(diagram: Diagram, highest: float) -> list[str]:
    """Return the delays whose Pade approximation is off by more than 1 % of the signal below a frequency [Hz].

    |H - exp(-j w T)| = (n!)^2 / ((2n)! (2n + 1)!) (w T)^(2n + 1), see the block ``delay``.
    """
    said = []
    for name, node in diagram.nodes.items():
        if "delay" in node.values and hasattr(node.block.option, "order"):
            n, angle = int(node.block.option.order), 2 * np.pi * highest * float(np.max(node.values["delay"]))
            constant = factorial(n) ** 2 / (factorial(2 * n) * factorial(2 * n + 1))
            limit = (DELAY_ERROR / constant) ** (1 / (2 * n + 1))
            if angle > limit:
                said.append(
                    f"'{name}': its Pade approximation is off by more than 1 % above {highest * limit / angle:.0f} Hz"
                )
    return said
