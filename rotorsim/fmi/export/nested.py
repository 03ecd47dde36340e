"""FMUs inside a diagram that is exported: which of them can be carried, their files, and their tables for nested.h."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.fmi.description.archive import Archive
from rotorsim.fmi.description.model import FLOATS, ModelDescription
from rotorsim.fmi.description.platforms import SUFFIXES, library_folder, platform_of, this_platform
from rotorsim.fmi.export.stepped import Steps, fed_inputs, is_stepped, set_inputs, steps_of
from rotorsim.fmi.export.tables import number, table, text
from rotorsim.fmi.functions import FmuFunctions, digest_of, functions_of, held_inputs, moving_inputs
from rotorsim.fmi.runtime.binding import TYPES
from rotorsim.fmi.runtime.runs import make_runs
from rotorsim.model.part import Part

NESTED = "export the others by --block: what comes from it becomes an input"
FOLDER = "fmus"  # in resources/
WHOLE = 1e-9  # of a number of steps
_LARGEST = 2 << 30  # bytes of one file
_LEFT_OUT = ("sources/", "documentation/")
_LICENCES = "documentation/licenses/"
_CODES = {  # type of FMI 3.0 -> how nested.h keeps it
    "Float64": "RF_DOUBLE",
    "Float32": "RF_FLOAT",
    **{f"{sign}Int{bits}": f"RF_{sign or 'I'}{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)},
    "Enumeration": "RF_I64",
    "Boolean": "RF_BOOL",
    "String": "RF_TEXT",
}
_CODES2 = {**_CODES, "Enumeration": "RF_I32", "Boolean": "RF_I32"}  # C has no bool in FMI 2.0
_SYSTEM = {"linux": "defined(__linux__)", "windows": "defined(_WIN32)", "darwin": "defined(__APPLE__)"}
_PROCESSOR = {
    "x86_64": "(defined(__x86_64__) || defined(_M_X64))",
    "aarch64": "(defined(__aarch64__) || defined(_M_ARM64))",
}


@dataclass(frozen=True, eq=False)
class Nested:
    """An FMU in a block. interface: me or cs. libraries: platform -> path of its library in its archive."""

    block: str
    interface: str
    description: ModelDescription
    functions: FmuFunctions | Steps
    file: Any
    folder: str
    fixed: tuple[str, ...]
    libraries: dict[str, str]

    @property
    def n_events(self) -> int:
        """How many event indicators it has."""
        return self.description.n_events if self.interface == "me" else 0

    @property
    def nominal(self) -> float:
        """The smallest nominal value of its states."""
        found = [entry.variable.nominal for entry in self.description.resolve(self.description.states)]
        return min((abs(value) if value else 1.0 for value in found), default=1.0)

    @property
    def kind(self) -> Any:
        """What it says of its interface."""
        return self.description.kinds[self.interface]

    @property
    def reports(self) -> bool:
        """Whether it is to be told of completed steps."""
        return bool(self.interface == "me" and self.kind.completed_step_needed and self.description.states)


def why_not_nested(diagram: Diagram, blocks: Iterable[str]) -> list[Problem]:
    """Return every reason why FMUs among some blocks cannot be carried inside another one."""
    problems: list[Problem] = []
    once: dict[str, str] = {}
    for name in blocks:
        node, block = diagram.nodes[name], _fmu_block(diagram, name)
        if block is None:
            continue
        what, hint = _why_not(block, diagram.solver.step)
        if not what and block.fmu_description.kinds[interface_of(block)].once_per_process:
            first = once.setdefault(block.fmu_description.token, name)
            what = "" if first == name else f"can be instantiated only once per process, and {first} is the same FMU"
        problems += [Problem(what, name, node.place, hint or NESTED)] if what else []
    return problems or _beside_events(diagram, blocks)


def _beside_events(diagram: Diagram, blocks: Iterable[str]) -> list[Problem]:
    """Refuse FMUs for Co-Simulation beside events within steps, which are taken back to locate them."""
    every = {name: block for name in blocks if (block := _fmu_block(diagram, name)) is not None}
    eventful = [name for name, b in every.items() if interface_of(b) == "me" and b.fmu_description.n_events]
    what = f"is an FMU for Co-Simulation, which cannot step back to the events of {', '.join(eventful)}"
    stepped = [name for name, b in every.items() if eventful and interface_of(b) == "cs"]
    return [Problem(what, name, diagram.nodes[name].place, NESTED) for name in stepped]


def interface_of(block: Any) -> str:
    """Return the interface that a block of type fmu would have inside another: cs where it hides its equations."""
    return "cs" if block.option.interface == "cs" or "me" not in block.fmu_description.kinds else "me"


def _fmu_block(diagram: Diagram, name: str) -> Any:
    """Return the block of type fmu of this name, or None where it is of another type."""
    block = diagram.nodes[name].block
    return block if block.opaque else None


def couples_by_steps(diagram: Diagram) -> bool:
    """Return whether a diagram has FMUs for Co-Simulation that run on this machine."""
    every = [block for name in diagram.nodes if (block := _fmu_block(diagram, name)) is not None]
    hidden = [block.fmu_description for block in every if interface_of(block) == "cs"]
    here = this_platform()
    return bool(hidden) and all(here in map(platform_of, one.platforms) for one in hidden)


def _why_not(block: Any, step: float) -> tuple[str, str]:
    description: ModelDescription = block.fmu_description
    interface = interface_of(block)
    if description.version == "1.0":
        return "is an FMU of FMI 1.0, which is not carried inside another", f"get it as FMI 2.0 or 3.0, or {NESTED}"
    if interface not in description.kinds:
        return f"offers no interface '{interface}'", NESTED
    kind = description.kinds[interface]
    if interface == "me" and (what := block.untraced()[0]):
        return what, NESTED
    parts = step / (kind.fixed_step or step)
    if abs(parts - round(parts)) > WHOLE * parts or parts < 0.5:
        what = f"takes steps of {kind.fixed_step:g} s, of which that of the diagram, {step:g} s, is no multiple"
        return what, '"solver": {"step": ...} of the diagram'
    if kind.needs_tool:
        return "needs the tool that made it (needsExecutionTool), which is not carried", ""
    if not description.platforms:
        return "holds no library, only sources or nothing", "build its library and put it into binaries/"
    if description.sizes:
        return f"has other sizes of arrays ({', '.join(description.sizes)}) than its own, which are not carried", ""
    fed = moving_inputs(block) if interface == "me" else fed_inputs(block)
    moving = [entry for port in fed.values() for entry in description.resolve(port.entries)]
    wrong = next((entry for entry in moving if entry.variable.type != FLOATS[0]), None)
    if wrong is not None:
        return f"has an input of type {wrong.variable.type} ({wrong.name}), which is not carried: Float64 alone is", ""
    return "", ""


def find_nested(part: Part) -> tuple[Nested, ...]:
    """Return the FMUs among the blocks of a part, which `why_not_nested` finds nothing against."""
    found = []
    for name in part.blocks:
        block = _fmu_block(part.diagram, name)
        if block is None:
            continue
        description, interface = block.fmu_description, "cs" if is_stepped(block) else "me"
        identifier = description.kinds[interface].identifier
        folder = f"{FOLDER}/{identifier}_{digest_of(block.fmu_path)[:8]}"
        with Archive(block.fmu_path) as archive:
            libraries = _libraries(description.version, identifier, archive.names)
        once, functions = (
            (set_inputs(block), steps_of(block)) if interface == "cs" else (held_inputs(block), functions_of(block))
        )
        fixed = tuple(f"{name}.{key}" for key in (*block.fmu_parameters, *once))
        found.append(Nested(name, interface, description, functions, block.fmu_path, folder, fixed, libraries))
    return tuple(found)


def _libraries(version: str, identifier: str, names: Iterable[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for name in names:
        first, _, rest = name.partition("/")
        folder, _, file = rest.partition("/")
        platform = platform_of(folder) if first == "binaries" else ""
        processor, _, system = platform.partition("-")
        if processor in _PROCESSOR and file == identifier + SUFFIXES[system]:
            best = folder == library_folder(platform, version)
            found[platform] = name if best or platform not in found else found[platform]
    return found


def check_outputs(part: Part, nested: Sequence[Nested], record: Sequence[str]) -> None:
    """Raise RotorsimError for outputs of nested FMUs that are used and are no Float64, or part of an array."""
    problems = []
    for one in nested:
        used = {str(w.source).partition("[")[0] for w in part.diagram.wires} | {r.partition("[")[0] for r in record}
        ports = _fmu_block(part.diagram, one.block).fmu_outputs
        for key, port in ports.items():
            kinds = {entry.variable.type for entry in one.description.resolve(port.entries)} - {FLOATS[0]}
            if kinds and f"{one.block}.{key}" in used:
                what = f"is of type {kinds.pop()}: of an FMU inside another, Float64 alone is read"
                problems.append(Problem(what, f"{one.block}.{key}", hint="leave out what uses it, --output others"))
        shown = _shown(one)
        for names in (one.functions.equations.u_names, shown):
            runs = make_runs(one.description.resolve(names), "") if names else []
            if len(runs) > 1 or any(run["index"] is not None for run in runs):
                problems.append(Problem("has ports that are a part of an array, which are not carried", one.block))
    if problems:
        raise RotorsimError(*problems)


def check_platforms(nested: Sequence[Nested], platforms: Iterable[str]) -> None:
    """Raise RotorsimError for platforms for which a nested FMU holds no library."""
    problems = [
        Problem(
            f"holds no library for {platform}, which the exported FMU would need",
            one.block,
            hint=f"it holds {', '.join(sorted(one.libraries)) or 'none that can be exported'}: --platform names these",
        )
        for platform in platforms
        for one in nested
        if platform not in one.libraries
    ]
    if problems:
        raise RotorsimError(*problems)


def carried_files(nested: Iterable[Nested]) -> dict[str, bytes]:
    """Return the files of nested FMUs, each once, by their path in the archive of the outer one."""
    files = {}
    for one in {one.folder: one for one in nested}.values():
        with Archive(one.file) as archive:
            for name in archive.names:
                if not name.startswith(_LEFT_OUT) or name.startswith(_LICENCES):
                    files[f"resources/{one.folder}/{name}"] = archive.read(name, _LARGEST)
    return files


def _shown(one: Nested) -> list[str]:
    """Return the outputs that C reads."""
    names = one.functions.equations.y_names
    return [e.name for e in one.description.resolve(names) if e.variable.type == FLOATS[0]]


# ---- tables ----


def nested_tables(part: Part, nested: Sequence[Nested], called: Sequence[str]) -> list[str]:
    """Return the tables of nested FMUs; called: names of the functions that the generated code calls, by number."""
    if not nested:
        return ["#define RF_NESTED 0"]
    reports = any(one.reports for one in nested)
    lines = [
        f"#define RF_NESTED {len(nested)}",
        f"#define RF_NESTED_Z {sum(one.n_events for one in nested)}",
        f"#define RF_NESTED_P {sum(len(one.functions.equations.instances.parameters) for one in nested)}",
        f"#define RF_REPORTS {int(reports)}",
        f"#define RF_SAVES {int(all(one.kind.can_get_set_state for one in nested))}",
        f"#define RF_CALLED {len(called)}",
        '#include "nested_types.h"',
        *_places(nested),
    ]
    models, at_z = [], 0
    for k, one in enumerate(nested):
        states = part.states.get(f"{one.block}.states")
        more, model = _model(k, one, part.diagram.solver.step, states.part.start if states else 0, at_z)
        lines += more
        models.append(model)
        at_z += one.n_events
    rows: list[int] = []
    calls = []
    known = {name: (k, made) for k, one in enumerate(nested) for name, made in one.functions.named().items()}
    for name in called:
        if name not in known:
            block = next(nested[k].block for own, (k, _) in known.items() if own in name)
            what = "is in an algebraic loop, which takes derivatives of its outputs: these are not carried"
            raise RotorsimError(Problem(what, block, hint="put a state into the loop (integrator, lag, delay)"))
        k, made = known[name]
        equations = nested[k].functions.equations
        zero = equations.n_x + len(_shown(nested[k]))  # behind all: what nobody reads
        own = [equations.native_row.get(row, zero) for row in made.rows or ()]
        groups = ", ".join(str(int(group)) for group in made.groups)
        what = "RF_BY_STEPS" if nested[k].interface == "cs" else "RF_AT_BEGIN" if made.rows is None else "RF_AT_POINT"
        calls.append(f"{{{k}, {what}, {len(own)}, {len(rows)}, {{{groups}}}}}")
        rows += own
    return [
        *lines,
        table("rf_model", "rf_models", models),
        table("rf_called", "rf_calls", calls),
        table("int64_t", "rf_rows", map(str, rows)),
    ]


def _places(nested: Sequence[Nested]) -> list[str]:
    """Return where the libraries are, for every platform for which there are all."""
    lines: list[str] = []
    for platform in sorted(set.intersection(*(set(one.libraries) for one in nested))):
        processor, _, system = platform.partition("-")
        lines.append(f"#{'elif' if lines else 'if'} {_SYSTEM[system]} && {_PROCESSOR[processor]}")
        lines += [
            f"#define RF_LIBRARY_{k} {text(f'{one.folder}/{one.libraries[platform]}')}" for k, one in enumerate(nested)
        ]
    error = '#error "the FMUs inside this one hold no library for this platform"'
    return [*lines, "#else", error, "#endif"] if lines else [error]


def _model(k: int, one: Nested, step: float, at_x: int, at_z: int) -> tuple[list[str], str]:
    """Return the tables of an FMU, and what refers to them."""
    description, equations = one.description, one.functions.equations
    p, u = equations.instances.parameters, equations.instances.inputs
    shown = _shown(one)
    settings, constants, texts = _settings(one)
    u_refs, y_refs = (_references(description, names) for names in (u.names, shown))
    categories = [name for name in description.log_categories if name.startswith("logStatus")]
    has_resources = description.version == "2.0" or _has_resources(one)
    y_scales = equations.y_scales[[i for i, name in enumerate(equations.y_names) if name in set(shown)]]
    numbers: dict[str, Iterable[float]] = {
        "u_scales": equations.u_scales.ravel(),
        "y_scales": y_scales.ravel(),
        "starts": np.concatenate([p.starts, u.starts]),
        "idle": equations.idle,
        "scales": np.concatenate([p.scales, u.scales]).ravel(),
        "constants": constants,
    }
    lines = [
        table("uint32_t", f"rf_u_refs_{k}", map(str, u_refs)),
        table("uint32_t", f"rf_y_refs_{k}", map(str, y_refs)),
        *(table("double", f"rf_{name}_{k}", map(number, values)) for name, values in numbers.items()),
        table("rf_setting", f"rf_settings_{k}", settings, empty='{RF_DOUBLE, "", 0, 0, 0, 0}'),
        table("char *const", f"rf_texts_{k}", map(text, texts)),
        table("char *const", f"rf_categories_{k}", map(text, categories)),
    ]
    sizes = {
        "version": description.version[0],
        "reports": int(one.reports),
        "step": number(step if one.interface == "cs" else 0.0),
        "at_x": at_x,
        "at_z": at_z,
        "n_x": equations.n_x,
        "n_u": len(u),
        "n_y": len(shown),
        "n_z": one.n_events,
        "n_p": len(p),
        "counts": f"{{{len(u_refs)}, {len(y_refs)}}}",
        "n_settings": len(settings),
        "n_constants": len(constants),
        "n_categories": len(categories),
        "largest": max((variable.size for variable in description.variables.values()), default=1),
        "u_refs": f"rf_u_refs_{k}",
        "y_refs": f"rf_y_refs_{k}",
        **{name: f"rf_{name}_{k}" for name in (*numbers, "settings", "texts", "categories")},
        "block": text(one.block),
        "library": f"RF_LIBRARY_{k}",
        "resources": text(f"{one.folder}/resources") if has_resources else 0,
        "token": text(description.token),
    }
    return lines, "{" + ", ".join(f".{name} = {value}" for name, value in sizes.items()) + "}"


def _has_resources(one: Nested) -> bool:
    with Archive(one.file) as archive:
        return any(name.startswith("resources/") for name in archive.names)


def _references(description: ModelDescription, names: Sequence[str]) -> list[int]:
    runs = make_runs(description.resolve(names), "") if names else []
    return [reference for run in runs for reference in run["refs"]]


def _settings(one: Nested) -> tuple[list[str], list[float], list[str]]:
    """Return what is set before the initialisation, the numbers among it that are constants, and the texts."""
    description, instances = one.description, one.functions.equations.instances
    codes, words = (_CODES2, TYPES["2.0"]) if description.version == "2.0" else (_CODES, TYPES["3.0"])
    names = [*instances.parameters.names, *instances.inputs.names]
    settings: list[str] = []
    constants: list[float] = []
    texts: list[str] = []

    def add(variable: Any, n: int, at: int, always: bool) -> None:
        word = words[variable.type][0]
        settings.append(f"{{{codes[variable.type]}, {text(word)}, {variable.reference}, {n}, {at}, {int(always)}}}")

    at = 0
    for _, run in groupby(description.resolve(names), key=lambda entry: id(entry.variable)):
        entries = list(run)
        add(entries[0].variable, len(entries), at, False)
        at += len(entries)
    for name, value in instances.texts.items():
        variable = description.variables[name]
        values = list(value) if isinstance(value, list | tuple) else [value] * variable.size
        if variable.type == "String":
            add(variable, len(values), len(texts), True)
            texts += map(str, values)
        else:
            add(variable, len(values), len(names) + len(constants), True)
            constants += map(float, values)
    return settings, constants, texts
