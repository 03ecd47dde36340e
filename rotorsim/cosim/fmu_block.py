"""The participant that a block of type fmu stands for."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from rotorsim.cosim.fmu_participant import CoSimulationFmu, FmuParticipant, ModelExchangeFmu
from rotorsim.diagram.diagram import Node
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.description.model import ModelDescription
from rotorsim.fmi.runtime.slave import Slave, open_fmu


def fmu_participant(
    name: str,
    node: Node,
    wired: Collection[str],
    stop: float,
    internal: float,
    *,
    tolerance: float | None = None,
    log: Callable[[str, float, str, str, str], None] | None = None,
) -> FmuParticipant:
    """Open the FMU of a block and return it as a participant.

    wired: its input ports that something feeds; the others keep the values that the block gives them. tolerance: told
    to the FMU, None: the one that it proposes for its own solver. log: gets block, time, status, category and text of
    every message.
    Raises RotorsimError.
    """
    block: Any = node.block
    option = block.option
    own: list[Slave] = []

    def hear(status: str, category: str, text: str) -> None:
        if log is not None:
            log(name, own[0].time if own else 0.0, status, category, text)

    fmu = open_fmu(
        block.fmu_path,
        in_process=bool(option.in_process),
        timeout=float(option.timeout),
        log=hear if log is not None else None,
        sizes=block.fmu_description.sizes,
    )
    with contextlib.ExitStack() as opened:
        opened.callback(fmu.close)
        kind = _kind(name, node, fmu.description, str(option.interface))
        own.append(fmu.instantiate(kind, name))
        opened.pop_all()
    proposed = fmu.description.experiment.tolerance if kind == "cs" else None  # of its own solver
    return _KINDS[kind](
        name=name,
        fmu=fmu,
        slave=own[0],
        input_ports={key: port for key, port in block.fmu_inputs.items() if key in wired},
        output_ports=block.fmu_outputs,
        parameters=_given(node, wired),
        stop=stop,
        internal=internal,
        tolerance=proposed if tolerance is None else tolerance,
    )


_KINDS: dict[str, type[FmuParticipant]] = {"cs": CoSimulationFmu, "me": ModelExchangeFmu}


def _kind(name: str, node: Node, description: ModelDescription, interface: str) -> str:
    """Return which of its kinds an FMU is to be. Raises RotorsimError where it does not offer that."""
    kinds = description.kinds
    kind = interface if interface != "any" else "cs" if "cs" in kinds else "me"
    if kind in kinds:
        return kind
    what, hint = f"the FMU offers no interface '{kind}'", f"it offers {', '.join(kinds) or 'neither'}"
    if list(kinds) == ["se"]:
        clocks = ", ".join(description.clocks[:5])
        what = "the FMU offers Scheduled Execution only, which is driven by clocks: not supported"
        hint = f"its clocks are {clocks}" if clocks else ""
    raise RotorsimError(Problem(what, name, node.place, hint))


def _given(node: Node, wired: Collection[str]) -> dict[str, Any]:
    """Return the values that a block gives to variables of its FMU: those that are not the start values."""
    block: Any = node.block
    ports = {**block.fmu_parameters, **{key: port for key, port in block.fmu_inputs.items() if key not in wired}}
    given: dict[str, Any] = {}
    for key in (key for key in ports if key in node.values):
        port, values = ports[key], np.ravel(node.values[key])
        starts = [None] * len(port.entries) if port.start is None else np.ravel(port.start)
        rows = zip(port.entries, values, port.of_fmu(values), starts, strict=True)
        given |= {entry: float(raw) for entry, value, raw, start in rows if value != start}
    for key, chosen in block.fmu_options.items():
        settable = chosen.variable.causality != "structuralParameter" and key not in wired
        if settable and getattr(block.option, key) != chosen.default:
            given[chosen.variable.name] = chosen.of_fmu(getattr(block.option, key))
    return given
