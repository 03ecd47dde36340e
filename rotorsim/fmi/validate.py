"""Checks of an FMU beyond what is needed to read it: rules of the standard, libraries, and a first instance.

Nothing of the FMU is run unless that is asked for; FMPy's validator runs in a process of its own.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from rotorsim.errors import Place, Problem, RotorsimError
from rotorsim.fmi.description.archive import Archive
from rotorsim.fmi.description.model import FLOATS, NUMERIC, FmuVariable, ModelDescription
from rotorsim.fmi.description.platforms import SUFFIXES, binary_kind, folders, platform_of
from rotorsim.fmi.runtime.slave import describe, open_fmu

_INDEX = r"(\[\d+(,\d+)*\])?"
_PART = r"([A-Za-z_]\w*|'([^'\\]|\\.)+')" + _INDEX
_PATH = rf"{_PART}(\.{_PART})*"
_STRUCTURED = re.compile(rf"{_PATH}|der\({_PATH}(,\d+)?\)", re.ASCII)
_LEGAL = {
    "structuralParameter": {("fixed", "exact"), ("tunable", "exact")},
    "parameter": {("fixed", "exact"), ("tunable", "exact")},
    "calculatedParameter": {(v, i) for v in ("fixed", "tunable") for i in ("calculated", "approx")},
    "input": {("discrete", "exact"), ("continuous", "exact")},
    "output": {("constant", "exact")}
    | {(v, i) for v in ("discrete", "continuous") for i in ("calculated", "exact", "approx")},
    "local": {("constant", "exact")}
    | {(v, i) for v in ("fixed", "tunable") for i in ("calculated", "approx")}
    | {(v, i) for v in ("discrete", "continuous") for i in ("calculated", "exact", "approx")},
    "independent": {("continuous", "")},
}
_FMPY = (
    "import sys, json\nfrom fmpy.validation import validate_fmu\n"
    "print(json.dumps([str(p) for p in validate_fmu(sys.argv[1])]))"
)
_FMPY_TIME, _FMPY_MOST, _SHOWN = 120.0, 20_000, 20


def validate_fmu(path: str | Path, *, load: bool = False, fmpy: bool = True) -> list[Problem]:
    """Return everything that is wrong with an FMU that can be read, and warnings.

    load: instantiate and initialise it too, in a process of its own. fmpy: ask FMPy's validator too.
    Raises RotorsimError when the archive or its model description cannot be read.
    """
    with Archive(path) as archive:
        description = describe(archive, str(path))
        problems = [*description.warnings, *_variables(description)]
        problems += _structure(description) if description.version != "1.0" else []  # which has none
        problems += _libraries(description, archive)
    if fmpy:
        problems += _ask_fmpy(Path(path), description)
    if load and not any(problem.severity == "error" and problem.subject == "binaries" for problem in problems):
        problems += _loaded(path, description)
    return problems


# -- the model description ---------------------------------------------------------------------------------------------


def _variables(description: ModelDescription) -> Iterator[Problem]:
    """Yield what is wrong with variables: the first of each kind."""
    rules = [_broken_rules(v, description) for v in description.variables.values()]
    for kind in (*zip(*rules, strict=True), _twice(description)):
        problems = [problem for problem in kind if problem]
        yield from problems[:_SHOWN]
        if len(problems) > _SHOWN:
            yield Problem(f"... and {len(problems) - _SHOWN} more like these", place=Place(description.place.file))
    if description.version == "3.0" and len(description.by_causality("independent")) != 1:
        yield Problem("there must be exactly one independent variable", place=description.place)


def _broken_rules(v: FmuVariable, description: ModelDescription) -> list[Problem | None]:
    """Return of every rule what a variable does against it, None where it keeps it."""
    structured = description.naming == "structured"
    data = v.type not in ("Clock", "Binary")
    low = -math.inf if v.minimum is None else v.minimum
    high = math.inf if v.maximum is None else v.maximum
    starts = [s for s in (v.start if isinstance(v.start, tuple) else (v.start,)) if isinstance(s, int | float)]
    unit = description.units.get(v.unit)
    lost = v.unit and unit and v.display_unit and v.display_unit not in unit.display
    initial = f" and initial {v.initial}" if v.initial else ""
    illegal = (v.variability, v.initial) not in _LEGAL[v.causality] and v.type != "Clock"
    rules = {
        f"causality {v.causality} with variability {v.variability}{initial}": illegal,
        f"is of type {v.type} and cannot be continuous": v.variability == "continuous" and v.type not in FLOATS,
        "has no start value": data and v.start is None and (v.initial in ("exact", "approx") or v.causality == "input"),
        "is calculated but has a start value": data and v.start is not None and v.initial == "calculated",
        "is the independent variable but has a start value": data
        and v.start is not None
        and v.causality == "independent",
        f"min {low:g} is above max {high:g}": data and low > high,
        f"its unit '{v.unit[:80]}' is not defined": v.unit and unit is None and description.version != "1.0",
        f"its display unit '{v.display_unit[:80]}' is not defined": lost,
    }
    names = {
        f"'{v.name[:200]}' is not a structured name": structured and not _STRUCTURED.fullmatch(v.name[:1000]),
        f"{v.name[:200]!r} has a line break or a tab": not structured and any(c in "\r\n\t" for c in v.name),
    }
    far = f"its start value is outside {low:g} ... {high:g}"
    outside = data and v.type in NUMERIC and any(not low <= start <= high for start in starts)
    return [
        *(Problem(what, "variable", v.place) if broken else None for what, broken in names.items()),
        *(Problem(what, v.name, v.place) if broken else None for what, broken in rules.items()),
        Problem(far, v.name, v.place, severity="warning") if outside else None,
    ]


def _twice(description: ModelDescription) -> list[Problem]:
    """Return the variables of FMI 3.0 that have the value reference of another one."""
    own = [v for v in description.variables.values() if not v.alias] if description.version == "3.0" else []
    first = {v.reference: v for v in reversed(own)}
    again = [(v, first[v.reference].name) for v in own if first[v.reference] is not v]
    return [Problem(f"has the value reference of {name}", v.name, v.place) for v, name in again]


def _structure(description: ModelDescription) -> Iterator[Problem]:
    outputs = {v.name for v in description.by_causality("output") if not v.alias}
    listed, unknowns = set(description.outputs), set(description.initial_unknowns)
    expected = _initial_unknowns(description)
    for names, what in (
        (outputs - listed, "is an output that the model structure does not list"),
        (listed - outputs, "is listed as an output but is none"),
        (expected - unknowns, "is missing among the initial unknowns"),
        (unknowns - expected, "is no initial unknown but is listed as one"),
    ):
        yield from (Problem(what, name, description.variables[name].place) for name in sorted(names)[:_SHOWN])


def _initial_unknowns(description: ModelDescription) -> set[str]:
    free = ("approx", "calculated")
    rates = {entry.variable.name for entry in description.resolve(description.derivatives)}
    states = {description.variables[name].derivative_of for name in rates}
    found = {name for name in rates | states if description.variables[name].initial in free}
    for v in description.variables.values():
        output = v.causality == "output" and v.initial in free and not v.clocked
        if not v.alias and (output or v.causality == "calculatedParameter"):
            found.add(v.name)
    return found


# -- libraries ---------------------------------------------------------------------------------------------------------


def _libraries(description: ModelDescription, archive: Archive) -> Iterator[Problem]:
    place, here = Place(str(archive.path)), folders(description.version)
    present = sorted({name.split("/")[1] for name in archive.names if re.fullmatch(r"binaries/[^/]+/.+", name)})
    if not description.platforms:
        sources = any(name.startswith("sources/") for name in archive.names)
        hint = "it holds sources: build it with the tool it is from" if sources else ""
        yield Problem("no library that can be loaded is inside", "binaries", place, hint)
    elif not set(here) & set(description.platforms):
        what = f"no library for this machine ({here[0]}); inside: {', '.join(description.platforms)}"
        yield Problem(what, "binaries", place, severity="warning")
    identifiers = sorted({kind.identifier for kind in description.kinds.values()})
    for folder in (folder for folder in present if platform_of(folder)):
        known = platform_of(folder)
        for name in (f"binaries/{folder}/{of}{SUFFIXES[known.partition('-')[2]]}" for of in identifiers):
            if name not in archive:
                yield Problem(f"{name} is missing", "binaries", place, severity="warning")
            elif (kind := binary_kind(archive.peek(name, 4096))) != known:
                yield Problem(f"{name} is {kind or 'no library'}, not {known}", "binaries", place)


# -- other judges ------------------------------------------------------------------------------------------------------


def _ask_fmpy(path: Path, description: ModelDescription) -> Iterator[Problem]:
    """Yield what FMPy's validator finds."""
    place = Place(str(path))
    longest = max((len(name) for name in description.variables), default=0)
    if len(description.variables) > _FMPY_MOST or longest > 500:
        yield Problem("is too large for FMPy's validator, which was not asked", place=place, severity="warning")
        return
    command = [sys.executable, "-P", "-W", "ignore", "-c", _FMPY, str(path.resolve())]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_FMPY_TIME, check=True)
        found = json.loads(done.stdout.splitlines()[-1])
    except (subprocess.SubprocessError, OSError, ValueError, IndexError) as error:
        yield Problem(f"FMPy's validator failed: {type(error).__name__}", place=place, severity="warning")
        return
    yield from (Problem(" ".join(str(text).split())[:500], "FMPy", place) for text in found[:_SHOWN])
    if len(found) > _SHOWN:
        yield Problem(f"... and {len(found) - _SHOWN} more", "FMPy", place)


def _loaded(path: str | Path, description: ModelDescription) -> Iterator[Problem]:
    """Instantiate and initialise the FMU, as each kind that it offers; yield what goes wrong, once."""
    if not set(folders(description.version)) & set(description.platforms):
        return
    names = [name for name, v in description.variables.items() if v.type in FLOATS and not v.clocked]
    told: set[Problem] = set()
    for kind in description.kinds:
        if kind == "se":
            continue
        try:
            with open_fmu(path) as fmu:
                slave = fmu.instantiate(kind)
                slave.setup(description.experiment.start or 0.0, description.experiment.stop)
                entries = description.resolve(names)
                values = [value for name in names for value in slave.get([name])]
                bad = [e.name for e, value in zip(entries, values, strict=True) if not math.isfinite(value)]
                if bad:
                    what = f"not finite after the initialisation ({kind}): {', '.join(bad[:5])}"
                    yield Problem(what, description.name, Place(str(path)), severity="warning")
                slave.terminate()
        except RotorsimError as error:
            yield from (problem for problem in error.problems if problem not in told)
            told.update(error.problems)
