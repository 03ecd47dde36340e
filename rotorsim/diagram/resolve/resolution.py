"""Resolve a diagram: JSON to a validated `Diagram`, with all mistakes at once; equations are not looked at."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Diagram, Endpoint, Node, Solver
from rotorsim.diagram.parse.document import FlatDocument
from rotorsim.diagram.parse.flatten import flatten_document
from rotorsim.diagram.parse.source import MAX_DEPTH, Source, is_too_deep, read_document
from rotorsim.diagram.resolve.build import Builder
from rotorsim.diagram.resolve.free import free_parameters, unknown_names
from rotorsim.diagram.resolve.measured import measured_signals
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.diagram.resolve.template import Work
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.diagram.resolve.wiring import Wiring
from rotorsim.errors import Place, Problem, RotorsimError, near_miss

__all__ = ["METHODS", "find_diagram", "raise_errors", "resolve", "shipped_diagrams"]

METHODS = ("rk4", "dop853", "rk45", "radau", "bdf", "lsoda")
_SOLVER = {"step": "s", "stop": "s", "record_every": "1", "rtol": "1", "atol": "1"}
MOST_RTOL = 1e-3  # relative error of one step: in ten steps of the same sign one percent
MAX_PROBLEMS = 1000  # that one error carries
_SINKS = ("scope", "to_file")


def shipped_diagrams() -> dict[str, Path]:
    """Return the diagrams that come with rotorsim: name -> file."""
    folder = Path(str(resources.files("rotorsim.diagrams")))
    return {file.stem: file for file in sorted(folder.glob("*.json")) if not file.stem.endswith(".schema")}


def find_diagram(name: str | Path) -> tuple[Path, list[Problem]]:
    """Return the file that a name on the command line means, and what to say of it.

    A name that comes with rotorsim is one whatever folders are called so; a file of this name is the user's, and that
    is said. Raises RotorsimError for a name that is neither.
    """
    path, shipped = Path(name), shipped_diagrams()
    exists = os.path.lexists(path)
    if str(name) in shipped:
        if not exists or os.path.isdir(path):
            return shipped[str(name)], []
        what = "this is the file of the current folder, not the diagram that comes with rotorsim"
        hint = f"write ./{name} to mean the file; rename it to mean the other"
        return path, [Problem(what, place=Place(str(name)), hint=hint, severity="warning")]
    if not path.suffix and not exists:
        hint = near_miss(str(name), shipped)
        raise RotorsimError(Problem("no such file and no diagram of this name", place=Place(str(name)), hint=hint))
    return path, []


def resolve(
    source: str | Path | Mapping[str, Any],
    *,
    set: Mapping[str, Any] | None = None,
    without: Iterable[str] = (),
    trust_blocks: bool = False,
    folder: str | Path | None = None,
) -> Diagram:
    """Return the diagram of a document as data; arguments as of `rotorsim.model.load.load`.

    Raises RotorsimError with every mistake found; warnings are in ``diagram.warnings``.
    """
    document, root, said = _source(source, folder)
    parameters, blocks, solver = _overrides({} if set is None else set)
    flat = flatten_document(document, root, parameters, blocks)
    problems = flat.problems
    problems += said
    registry = Registry(_block_folders(flat, root, trust_blocks))
    builder = Builder(flat, registry, root)
    removed = _removed(flat, without)
    _check_overrides(flat, parameters, blocks)
    works: dict[str, Work] = {}
    for name, raw in flat.blocks.items():
        if name not in removed:
            work = builder.start(raw)
            if work is not None:
                works[name] = work
    if not (flat.blocks or flat.broken or flat.sub_diagrams) and "blocks" in flat.data:
        problems.append(
            Problem("the diagram has no blocks", place=document.locate(("blocks",)), hint="see `rotorsim blocks`")
        )
    wiring = Wiring(flat, builder, works, removed)
    wiring.connect()
    wiring.unify()
    settings = _solver(flat, solver)
    record = _record(flat, wiring, works, removed)
    values = builder.diagram_parameters()
    problems += registry.problems
    given = flat.data.get("identify")
    identify: Mapping[str, Any] = given if isinstance(given, Mapping) else {}
    if any(problem.severity == "error" for problem in problems):
        declared = {name: work.cls.parameters.keys() for name, work in works.items()}
        problems += unknown_names(document, identify, flat.parameters.keys(), declared)
    raise_errors(problems)

    nodes = {name: builder.node(work) for name, work in works.items()}
    free, mistakes = free_parameters(document, identify, values, builder.parameter_units, nodes, removed)
    problems += mistakes
    measured = measured_signals(flat, wiring, nodes, removed)
    for name, work in works.items():
        if work.template.has_check and name not in builder.misfits:
            problems += _contradictions(work, nodes[name])
    raise_errors(problems)
    return Diagram(
        name=flat.name,
        parameters=values,
        parameter_units={name: builder.parameter_units.get(name, "1") for name in values},
        nodes=nodes,
        wires=tuple(wiring.wires),
        solver=settings,
        record=record,
        solve_loops=flat.data.get("algebraic_loops") == "solve",
        cut=frozenset(wiring.cut),
        document=_with_settings(flat.data, parameters, blocks, solver),
        file=document.file,
        warnings=tuple(p for p in problems if p.severity == "warning"),
        free=free,
        measured=measured,
        trusted=trust_blocks,
    )


def raise_errors(problems: Iterable[Problem]) -> None:
    """Raise RotorsimError with all problems, in their order in the files, if one of them is an error."""
    problems = list(problems)
    if any(problem.severity == "error" for problem in problems):
        unique = sorted(dict.fromkeys(problems), key=lambda p: (p.place.file, p.place.line, p.place.column))
        if len(unique) > MAX_PROBLEMS:
            unique.sort(key=lambda p: p.severity != "error")  # stable: warnings go last
            more = f"and {len(unique) - MAX_PROBLEMS} more problems"
            unique[MAX_PROBLEMS:] = [Problem(more, place=unique[MAX_PROBLEMS].place, hint="correct these first")]
        raise RotorsimError(*[p if p.hint or p.severity == "warning" else replace(p, hint=_HINT) for p in unique])


_HINT = "docs/diagrams.md describes the format; `rotorsim blocks TYPE` lists ports and parameters"


def _contradictions(work: Work, node: Node) -> list[Problem]:
    hint = f"see `rotorsim blocks {work.cls.type_name}`"
    try:
        messages = list(node.block.check(node.values))
    except Exception as error:  # the code of the block is foreign
        messages = [f"check of block type '{work.cls.type_name}' fails: {type(error).__name__}: {error}"]
    return [Problem(message, node.name, work.raw.place(key=True), hint) for message in messages]


def _with_settings(
    data: Mapping[str, Any], parameters: Mapping[str, Any], blocks: Mapping[str, Any], solver: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a document with ``set`` in it; what is set inside sub-diagrams is kept under the key "set"."""
    result = dict(data)
    if parameters:
        result["parameters"] = {**result["parameters"], **parameters}
    if solver:
        result["solver"] = {**result.get("solver", {}), **solver}
    own = {name: values for name, values in blocks.items() if name in data["blocks"]}
    if own:
        result["blocks"] = dict(result["blocks"])
        for name, values in own.items():
            block = result["blocks"][name]
            result["blocks"][name] = {**block, "parameters": {**block.get("parameters", {}), **values}}
    inside = {f"{name}.{key}": v for name, values in blocks.items() if name not in own for key, v in values.items()}
    return {**result, "set": inside} if inside else result


def _source(
    source: str | Path | Mapping[str, Any], folder: str | Path | None
) -> tuple[Source, Path | None, list[Problem]]:
    """Return the document, its folder, and what to say of its name."""
    if isinstance(source, Mapping):
        if is_too_deep(dict(source)):
            what = f"the document is nested deeper than {MAX_DEPTH} levels"
            raise RotorsimError(Problem(what, hint="a diagram needs no more than ten; use sub-diagrams"))
        return Source(dict(source)), Path(folder) if folder is not None else None, []
    if not isinstance(source, str | Path):
        what = f"a diagram is a file, a name or a mapping, not {type(source).__name__}"
        raise RotorsimError(Problem(what, hint='load("diagram.json")'))
    path, said = find_diagram(source)
    try:
        found = read_document(path)
    except RotorsimError as error:
        raise RotorsimError(
            *[p if p.hint else replace(p, hint="give the JSON file of a diagram") for p in error.problems]
        ) from None
    return found, path.parent, said


def _overrides(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, dict[str, Any]], dict[str, Any]]:
    if not isinstance(given, Mapping) or is_too_deep(dict(given)):
        raise RotorsimError(Problem("settings are a mapping of names to values", hint='set={"speed": "1500 rpm"}'))
    parameters: dict[str, Any] = {}
    blocks: dict[str, dict[str, Any]] = {}
    solver: dict[str, Any] = {}
    for name, value in given.items():
        block, dot, parameter = str(name).rpartition(".")
        if not dot:
            parameters[str(name)] = value
        elif block == "solver":
            solver[parameter] = value
        else:
            blocks.setdefault(block, {})[parameter] = value
    return parameters, blocks, solver


def _check_overrides(flat: FlatDocument, parameters: Mapping[str, Any], blocks: Mapping[str, Any]) -> None:
    place = Place("--set")
    for name in parameters:
        if name not in flat.parameters:
            known = [*flat.parameters, *(f"{b}.{p}" for b, raw in flat.blocks.items() for p in raw.parameters)]
            flat.problems.append(Problem(f"no diagram parameter '{name}'", name, place, near_miss(name, known)))
    for name in blocks:
        if name not in flat.blocks and name not in flat.sub_diagrams:
            known = [*flat.blocks, *flat.sub_diagrams]
            flat.problems.append(Problem(f"no block '{name}'", name, place, near_miss(name, known)))


def _removed(flat: FlatDocument, without: Iterable[str]) -> frozenset[str]:
    removed: list[str] = []
    for name in [without] if isinstance(without, str) else map(str, without):
        inside = [block for block in flat.blocks if block == name or block.startswith(f"{name}/")]
        if not inside:
            hint = near_miss(name, [*flat.blocks, *flat.sub_diagrams])
            flat.problems.append(Problem(f"no block '{name}'", name, Place("--without"), hint))
        removed += inside
    return frozenset(removed)


def _block_folders(flat: FlatDocument, root: Path | None, trusted: bool) -> list[Path]:
    folders: list[Path] = []
    for k, name in (
        enumerate(flat.data.get("block_folders") or []) if isinstance(flat.data.get("block_folders"), list) else ()
    ):
        place = flat.source.place(("block_folders", k))
        hint = "name a folder inside the folder of the diagram"
        if not isinstance(name, str):
            flat.problems.append(Problem("must be the name of a folder", "block_folders", place, hint))
            continue
        if root is None:
            flat.problems.append(Problem("a document in memory has no folder", name, place, "pass folder="))
            continue
        path = _inside(root, name)
        if path is None:
            flat.problems.append(Problem("folder is outside the folder of the diagram", name, place, hint))
        elif not trusted:
            what = "block files are programs; they are not run unless you say so"
            flat.problems.append(Problem(what, name, place, "read them, then add --trust-blocks (trust_blocks=True)"))
        elif not os.path.isdir(path):  # unlike Path.is_dir, no error for a name that is too long
            flat.problems.append(Problem("folder does not exist", name, place, hint))
        else:
            folders.append(path)
    return folders


def _inside(root: Path, name: str) -> Path | None:
    """Return the folder of this name below ``root``, or None if it is not below it."""
    if Path(name).is_absolute() or "\0" in name:
        return None
    try:
        path = (root / name).resolve()
    except (OSError, RuntimeError):  # a link to itself
        return None
    return path if path.is_relative_to(root.resolve()) else None


def _solver(flat: FlatDocument, overrides: Mapping[str, Any]) -> Solver:
    given = flat.data.get("solver")
    merged = {**(given if isinstance(given, dict) else {}), **overrides}
    found: dict[str, Any] = {}
    for key, value in merged.items():
        place = Place("--set") if key in overrides else flat.source.place(("solver", key))
        subject = f"solver.{key}"

        def error(what: str, hint: str = "", subject: str = subject, place: Place = place) -> None:
            flat.problems.append(Problem(what, subject, place, hint))

        if key == "method":
            if not isinstance(value, str) or value.lower() not in METHODS:
                error(
                    f"unknown method {value!r}" if not isinstance(value, dict | list) else "must be a text",
                    near_miss(str(value)[:50], METHODS),
                )
            else:
                found[key] = value.lower()
        elif key not in _SOLVER:
            error(f"unknown key '{key}'", near_miss(str(key), ["method", *_SOLVER]))
        else:
            try:
                number = numeric(value, _SOLVER[key], bare=key in overrides)
            except ValueProblem as problem:
                error(problem.what, problem.hint)
                continue
            if number.ndim or not float(number) > 0:
                error("must be one positive number", f"the default is {getattr(Solver, key):g}")
            elif key == "record_every" and float(number) != int(number):
                error("must be a whole number", "1 records every step")
            else:
                found[key] = int(number) if key == "record_every" else float(number)
    settings = Solver(**found)
    if settings.step > settings.stop:
        what = f"step {settings.step:g} s is longer than stop {settings.stop:g} s"
        flat.problems.append(Problem(what, "solver", flat.source.place(("solver",)), "choose a smaller step"))
    if settings.rtol > MOST_RTOL:
        place, hint = flat.source.place(("solver", "rtol")), f"errors of steps add up; the default is {Solver.rtol:g}"
        flat.problems.append(Problem(f"must be at most {MOST_RTOL:g}", "solver.rtol", place, hint))
    if settings.stop / settings.step > 1e10:
        place = flat.source.place(("solver",))
        flat.problems.append(
            Problem(f"{settings.stop / settings.step:.0e} steps", "solver", place, "at most 1e10: a larger step")
        )
    return settings


def _record(
    flat: FlatDocument, wiring: Wiring, works: Mapping[str, Work], removed: frozenset[str]
) -> tuple[Endpoint, ...]:
    if flat.record is not None:
        wanted = [(end, place) for end, place in flat.record if end.block not in removed]
        ends = [end for end, place in wanted if wiring.part_shape(end, place)]
    else:
        domain = {name for name, work in works.items() if work.cls.category != "elementary"} or set(works)
        ends = [
            Endpoint(name, port) for name, work in works.items() if name in domain for port in work.template.outputs
        ]
    sinks = {name for name, work in works.items() if work.cls.type_name in _SINKS}
    ends += [wire.source for wire in wiring.wires if wire.target.block in sinks]
    return tuple(dict.fromkeys(ends))
