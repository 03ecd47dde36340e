"""Resolve a diagram: JSON to a validated `Diagram`, with all mistakes at once; equations are not looked at.

Three stages: a `Draft` of every block (`drafts`), the wires between them (`wiring`), the shapes that fit (`fitting`).
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from rotorsim.diagram.diagram import Diagram, Endpoint, Node
from rotorsim.diagram.parse.document import FlatDocument
from rotorsim.diagram.parse.flatten import flatten_document
from rotorsim.diagram.parse.source import MAX_DEPTH, Source, is_too_deep, read_document
from rotorsim.diagram.resolve.drafts import Drafter
from rotorsim.diagram.resolve.entries import entries_set, with_entries
from rotorsim.diagram.resolve.fitting import Fitting
from rotorsim.diagram.resolve.free import free_parameters, unknown_names
from rotorsim.diagram.resolve.measured import measured_signals
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.diagram.resolve.settings import SET, Settings
from rotorsim.diagram.resolve.template import Templates
from rotorsim.diagram.resolve.values import ValueProblem, numeric
from rotorsim.diagram.resolve.wiring import UNFINISHED, Wiring
from rotorsim.diagram.solver import SOLVER_METHODS, Solver
from rotorsim.errors import Place, Problem, RotorsimError, near_miss

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
        return path, [
            Problem(
                "this is the file of the current folder, not the diagram that comes with rotorsim",
                place=Place(str(name)),
                hint=f"write ./{name} to mean the file; rename it to mean the other",
                severity="warning",
            )
        ]
    if not path.suffix and not exists:
        raise RotorsimError(
            Problem(
                "no such file and no diagram of this name", place=Place(str(name)), hint=near_miss(str(name), shipped)
            )
        )
    return path, []


def resolve(
    source: str | Path | Mapping[str, Any],
    *,
    set: Mapping[str, Any] | None = None,
    without: Iterable[str] = (),
    trust_blocks: bool = False,
    folder: str | Path | None = None,
    unfinished: list[Problem] | None = None,
) -> Diagram:
    """Return the diagram of a document as data; arguments as of `rotorsim.model.load.load`.

    unfinished: takes what is only missing yet (wires, sizes), which is an error without it; these inputs read zero.
    Raises RotorsimError with every mistake found; warnings are in ``diagram.warnings``.
    """
    if isinstance(source, Mapping) and isinstance(source.get(SET), Mapping):  # of a diagram loaded with settings
        set = {**source[SET], **(set or {})}
        source = {key: value for key, value in source.items() if key != SET}
    if entries := entries_set(set):
        rest = {name: value for name, value in (set or {}).items() if name not in entries}
        more: dict[str, Any] = {"without": without, "trust_blocks": trust_blocks, "folder": folder}

        def diagram_with(settings: Mapping[str, Any]) -> Diagram:
            return resolve(source, set=settings, unfinished=None if unfinished is None else [], **more)

        return resolve(source, set=with_entries(diagram_with, rest, entries), unfinished=unfinished, **more)
    document, root, said = _source(source, folder)
    settings = Settings.of({} if set is None else set)
    flat = flatten_document(document, root, settings.parameters, settings.blocks)
    problems = flat.problems
    problems += said
    registry = Registry(_block_folders(flat, root, trust_blocks))
    templates = Templates()
    drafter = Drafter(flat, registry, templates, root)
    removed = _removed(flat, without)
    settings.check(flat)
    drafts = drafter.drafts(raw for name, raw in flat.blocks.items() if name not in removed)
    if not (flat.blocks or flat.broken or flat.sub_diagrams) and "blocks" in flat.data:
        problems.error("the diagram has no blocks", "", document.locate(("blocks",)), "see `rotorsim blocks`")
    wiring = Wiring(flat, drafts, removed)
    wiring.connect(templates)
    fitting = Fitting(wiring)
    fitting.fit()
    solver = _solver(flat, settings.solver)
    record = _record(fitting)
    values = drafter.parameters.values(flat.parameters)
    problems += registry.problems
    given = flat.data.get("identify")
    identify: Mapping[str, Any] = given if isinstance(given, Mapping) else {}
    if any(problem.severity == "error" for problem in problems):
        declared = {name: draft.cls.parameters.keys() for name, draft in drafts.items()}
        problems += unknown_names(document, identify, flat.parameters.keys(), declared)
    raise_errors(_apart(problems, unfinished))

    nodes, units = fitting.nodes(), drafter.parameters.units
    free, mistakes = free_parameters(document, identify, values, units, nodes, removed, drafter.structural)
    problems += mistakes
    problems += wiring.gaps(nodes)
    measured = measured_signals(flat, fitting, nodes, removed)
    for name, node in nodes.items():
        if name not in fitting.misfits:
            problems += _contradictions(node)
    raise_errors(_apart(problems, unfinished))
    return Diagram(
        name=flat.name,
        parameters=values,
        parameter_units={name: units.get(name, "1") for name in values},
        nodes=nodes,
        wires=tuple(wiring.wires),
        solver=solver,
        record=record,
        solve_loops=flat.data.get("algebraic_loops") == "solve",
        cut=frozenset(wiring.cut),
        document=settings.written_in(flat.data),
        file=document.file,
        folder=None if root is None else str(root),
        warnings=tuple(p for p in problems if p.severity == "warning"),
        free=free,
        measured=measured,
        trusted=trust_blocks,
        structural=drafter.structural,
        sub_ports=flat.sub_ports,
        removed=removed,
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


def _apart(problems: list[Problem], unfinished: list[Problem] | None) -> list[Problem]:
    """Move what is only missing yet to where it is asked for; return the problems that are left."""
    if unfinished is not None:
        unfinished += [problem for problem in problems if problem.code == UNFINISHED]
        problems[:] = [problem for problem in problems if problem.code != UNFINISHED]
    return problems


_HINT = "docs/diagrams.md describes the format; `rotorsim blocks TYPE` lists ports and parameters"


def _contradictions(node: Node) -> list[Problem]:
    """Return what a block says of its own values."""
    kind = type(node.block).type_name
    try:
        messages = list(node.block.check(node.values))
    except Exception as error:  # the code of the block is foreign
        messages = [f"check of block type '{kind}' fails: {type(error).__name__}: {error}"]
    return [Problem(message, node.name, node.place, f"see `rotorsim blocks {kind}`") for message in messages]


def _source(
    source: str | Path | Mapping[str, Any], folder: str | Path | None
) -> tuple[Source, Path | None, list[Problem]]:
    """Return the document, its folder, and what to say of its name."""
    if isinstance(source, Mapping):
        if is_too_deep(dict(source)):
            raise RotorsimError(
                Problem(
                    f"the document is nested deeper than {MAX_DEPTH} levels",
                    hint="a diagram needs no more than ten; use sub-diagrams",
                )
            )
        return Source(dict(source)), Path(folder) if folder is not None else None, []
    if not isinstance(source, str | Path):
        raise RotorsimError(
            Problem(
                f"a diagram is a file, a name or a mapping, not {type(source).__name__}", hint='load("diagram.json")'
            )
        )
    path, said = find_diagram(source)
    try:
        document = read_document(path)
    except RotorsimError as error:
        raise RotorsimError(
            *[p if p.hint else replace(p, hint="give the JSON file of a diagram") for p in error.problems]
        ) from None
    return document, path.parent, said


def _removed(flat: FlatDocument, without: Iterable[str]) -> frozenset[str]:
    removed: list[str] = []
    for name in [without] if isinstance(without, str) else map(str, without):
        inside = [block for block in flat.blocks if block == name or block.startswith(f"{name}/")]
        if not inside:
            flat.problems.error(
                f"no block '{name}'", name, Place("--without"), near_miss(name, [*flat.blocks, *flat.sub_diagrams])
            )
        removed += inside
    return frozenset(removed)


def _block_folders(flat: FlatDocument, root: Path | None, trusted: bool) -> list[Path]:
    folders: list[Path] = []
    given = flat.data.get("block_folders")
    for k, name in enumerate(given if isinstance(given, list) else ()):
        what, subject, hint = "", name, "name a folder inside the folder of the diagram"
        path = _inside(root, name) if root is not None and isinstance(name, str) else None
        if not isinstance(name, str):
            what, subject = "must be the name of a folder", "block_folders"
        elif root is None:
            what, hint = "a document in memory has no folder", "pass folder="
        elif path is None:
            what = "folder is outside the folder of the diagram"
        elif not trusted:
            what = "block files are programs; they are not run unless you say so"
            hint = "read them, then add --trust-blocks (trust_blocks=True)"
        elif not os.path.isdir(path):  # unlike Path.is_dir, no error for a name that is too long
            what = "folder does not exist"
        else:
            folders.append(path)
        if what:
            flat.problems.error(what, subject, flat.source.place(("block_folders", k)), hint)
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
    values: dict[str, Any] = {}
    for key, value in {**(given if isinstance(given, dict) else {}), **overrides}.items():
        try:
            values[key] = _solver_setting(key, value, key in overrides)
        except ValueProblem as problem:
            place = Place("--set") if key in overrides else flat.source.place(("solver", key))
            flat.problems.error(problem.what, f"solver.{key}", place, problem.hint)
    solver = Solver(**values)
    place = flat.source.place(("solver",))
    if solver.step > solver.stop:
        flat.problems.error(
            f"step {solver.step:g} s is longer than stop {solver.stop:g} s", "solver", place, "choose a smaller step"
        )
    if solver.rtol > MOST_RTOL:
        at_rtol, hint = flat.source.place(("solver", "rtol")), f"errors of steps add up; the default is {Solver.rtol:g}"
        flat.problems.error(f"must be at most {MOST_RTOL:g}", "solver.rtol", at_rtol, hint)
    if solver.stop / solver.step > 1e10:
        flat.problems.error(f"{solver.stop / solver.step:.0e} steps", "solver", place, "at most 1e10: a larger step")
    return solver


def _solver_setting(key: str, value: Any, bare: bool) -> Any:
    """Return a setting of the solver in SI; raise ValueProblem."""
    if key == "method":
        if not isinstance(value, str) or value.lower() not in SOLVER_METHODS:
            raise ValueProblem(
                "must be a text" if isinstance(value, dict | list) else f"unknown method {value!r}",
                near_miss(str(value)[:50], SOLVER_METHODS),
            )
        return value.lower()
    if key not in _SOLVER:
        raise ValueProblem(f"unknown key '{key}'", near_miss(str(key), ["method", *_SOLVER]))
    array = numeric(value, _SOLVER[key], bare=bare)
    if array.ndim or not float(array) > 0:
        raise ValueProblem("must be one positive number", f"the default is {getattr(Solver, key):g}")
    number = float(array)
    if key != "record_every":
        return number
    if number != int(number):
        raise ValueProblem("must be a whole number", "1 records every step")
    return int(number)


def _record(fitting: Fitting) -> tuple[Endpoint, ...]:
    """Return what a run records: what the document says, else all that blocks beyond the elementary ones give."""
    wiring, drafts = fitting.wiring, fitting.drafts
    if wiring.flat.record is not None:
        wanted = [(end, place) for end, place in wiring.flat.record if end.block not in wiring.removed]
        ends = [end for end, place in wanted if fitting.is_signal(end, place)]
    else:
        domain = {name for name, draft in drafts.items() if draft.cls.category != "elementary"} or drafts.keys()
        ends = [Endpoint(name, port) for name in drafts if name in domain for port in drafts[name].template.outputs]
    ends += [w.source for w in wiring.wires if drafts[w.target.block].cls.type_name in _SINKS]
    return tuple(dict.fromkeys(ends))
