"""What an FMU holds, for people and as data: platforms, kinds, variables, and what of it is supported here."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rotorsim.fmi.description.model import FMU_KINDS, FmuUnit, FmuVariable, Kind, ModelDescription
from rotorsim.fmi.description.platforms import folders, this_platform

_GROUPS = (
    ("inputs", ("input",)),
    ("outputs", ("output",)),
    ("parameters", ("parameter", "structuralParameter")),
    ("calculated parameters", ("calculatedParameter",)),
    ("local variables", ("local", "independent")),
)
_USUAL = 3  # groups shown unless all are wanted
_MOST = 40  # variables of a group shown as text unless all are wanted


def information(description: ModelDescription, *, every: bool = False) -> dict[str, Any]:
    """Return what ``rotorsim fmu info --json`` prints; every: local variables too."""
    groups = _GROUPS if every else _GROUPS[:_USUAL]
    here = [folder for folder in folders(description.version) if folder in description.platforms]
    return {
        "name": description.name,
        "fmi": description.version,
        "description": description.description,
        "tool": description.tool,
        "date": description.date,
        "platforms": list(description.platforms),
        "this_platform": this_platform(),
        "runs_here": bool(here),
        "kinds": {name: _kind(kind) for name, kind in description.kinds.items()},
        "states": len(description.states),
        "event_indicators": description.n_events,
        "experiment": {
            "start": description.experiment.start,
            "stop": description.experiment.stop,
            "tolerance": description.experiment.tolerance,
            "step": description.experiment.step,
        },
        "counts": {name: len(description.by_causality(*which)) for name, which in _GROUPS},
        "variables": {
            name: [_variable(v, description) for v in description.by_causality(*which)] for name, which in groups
        },
        "units": {name: unit.unit.si if unit.unit else None for name, unit in description.units.items()},
        "not_supported": _not_supported(description),
    }


def _kind(kind: Kind) -> dict[str, Any]:
    common: dict[str, Any] = {
        "identifier": kind.identifier,
        "get_set_state": kind.can_get_set_state,
        "serialise_state": kind.can_serialise_state,
        "directional_derivatives": kind.directional_derivatives,
        "adjoint_derivatives": kind.adjoint_derivatives,
        "once_per_process": kind.once_per_process,
        "needs_tool": kind.needs_tool,
    }
    if kind.name != "cs":
        return common
    return common | {
        "variable_step": kind.can_vary_step,
        "interpolates_inputs": kind.can_interpolate_inputs,
        "output_derivatives": kind.max_output_derivative_order,
        "internal_step": kind.fixed_step,
    }


def _variable(variable: FmuVariable, description: ModelDescription) -> dict[str, Any]:
    unit = description.unit_of(variable)
    start = list(variable.start) if isinstance(variable.start, tuple) else variable.start
    return {
        "name": variable.name,
        "type": variable.type,
        "shape": list(variable.dimensions),
        "unit": variable.unit,
        "start": start,
        "causality": variable.causality,
        "variability": variable.variability,
        "description": variable.description,
        "si_unit": unit.si if unit else None,
        "si_factor": unit.factor if unit else None,
        "si_offset": unit.offset if unit else None,
        "display": _display(variable, unit),
    }


def _display(variable: FmuVariable, unit: FmuUnit | None) -> str:
    """Return the start value of a scalar in its display unit, "" where there is none."""
    found = unit.display.get(variable.display_unit) if unit else None
    start = variable.start
    if found is None or not isinstance(start, int | float) or (found[2] and not start):
        return ""
    factor, offset, inverse = found
    shown = factor / start if inverse else factor * start + (0.0 if variable.relative else offset)
    return f"{shown:.6g} {variable.display_unit}"


def _not_supported(description: ModelDescription) -> list[str]:
    """Return what of the FMU cannot be used here."""
    binary = [name for name, variable in description.variables.items() if variable.type == "Binary"]
    names = {"clocks": description.clocks, "binary variables": binary}
    found = ["Scheduled Execution"] if "se" in description.kinds else []
    found += ["work that is left to a tool (CoSimulation_Tool)"] if description.is_tool_coupling else []
    return found + [f"{what}: {_some(which)}" for what, which in names.items() if which]


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (f", and {len(names) - 5} more" if len(names) > 5 else "")


def information_text(data: dict[str, Any], *, every: bool = False) -> str:
    """Return `information` for people."""
    made = ", ".join(_line(part) for part in (data["tool"], data["date"]) if part)
    inside = ", ".join(data["platforms"]) or "none (no library inside)"
    here = "one of them fits" if data["runs_here"] else "none fits"
    experiment = {key: value for key, value in data["experiment"].items() if value is not None}
    proposed = [f"{key} {value:g}{'' if key == 'tolerance' else ' s'}" for key, value in experiment.items()]
    lines = [
        f"{data['name']}: FMI {data['fmi']}, {' and '.join(FMU_KINDS[name] for name in data['kinds'])}",
        *([f"  {_line(data['description'])}"] if data["description"] else []),
        *([f"made by     {made}"] if made else []),
        f"platforms   {inside}; this machine is {data['this_platform']}: {here}",
        f"states      {data['states']}, event indicators {data['event_indicators']}",
        *(["experiment  " + ", ".join(proposed)] if proposed else []),
    ]
    for name, kind in data["kinds"].items():
        yes = [key.replace("_", " ") for key, value in kind.items() if value is True]
        more = [
            f"{key.replace('_', ' ')} {value:g}" + (" s" if key == "internal_step" else "")
            for key, value in kind.items()
            if isinstance(value, int | float) and not isinstance(value, bool) and value
        ]
        lines.append(f"{name:<11} " + (", ".join(yes + more) or "no extras"))
    for name, variables in data["variables"].items():
        lines += _group(name, variables, every)
    left = {name: data["counts"][name] for name in data["counts"] if name not in data["variables"]}
    shown = ", ".join(f"{count} {name}" for name, count in left.items() if count)
    lines += ["", f"and {shown} (--all shows them)"] if shown else []
    lines += ["", *(f"not supported here: {what}" for what in data["not_supported"])] if data["not_supported"] else []
    return "\n".join(lines)


def _group(name: str, variables: list[dict[str, Any]], every: bool) -> list[str]:
    if not variables:
        return ["", f"{name}: none"]
    shown = variables if every else variables[:_MOST]
    rows = [("name", "type", "unit", "start", "description")]
    for v in shown:
        shape = f"[{','.join(map(str, v['shape']))}]" if v["shape"] else ""
        start = _start(v["start"]) + (f" ({_line(v['display'])})" if v["display"] else "")
        rows.append((_line(v["name"]), v["type"] + shape, _line(v["unit"]), start, _line(v["description"])))
    widths = [min(40, max(len(row[k]) for row in rows)) for k in range(4)]
    lines = ["", f"{name} ({len(variables)}):"]
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row[:4], widths, strict=True)]
        lines.append("  " + "  ".join([*cells, row[4]]).rstrip())
    if len(shown) < len(variables):
        lines.append(f"  ... and {len(variables) - len(shown)} more (--all shows them)")
    return lines


def _start(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return " ".join(_start(entry) for entry in value[:4]) + (" ..." if len(value) > 4 else "")
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else _line(str(value))


def _line(text: str) -> str:
    """Return foreign text on one line, without control characters, not too long."""
    plain = "".join(c if c.isprintable() else " " for c in text)
    return plain if len(plain) <= 100 else plain[:97] + "..."
