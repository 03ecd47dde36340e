"""``rotorsim sensitivity``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from rotorsim.identification.study.plan import Study
    from rotorsim.identification.study.questions import Comparison, Smallest
    from rotorsim.identification.study.study import StudyResult, StudyRow

__all__ = ["command"]

SUFFIXES = (".csv", ".json")


@click.command("sensitivity")
@click.argument("diagram", metavar="[DIAGRAM]", required=False)
@click.option(
    "--table", metavar="NUMBER", help="A table of the thesis: its diagram, speeds, levels, beside its figures."
)
@click.option("--list", "listing", is_flag=True, help="List the tables of the thesis.")
@click.option("--speeds", metavar="SPEEDS", help="Speeds of the runs: start:step:stop, or a list.")
@click.option(
    "--gains",
    multiple=True,
    metavar="NAME=VALUE,...",
    help="Repeat all speeds with these values: controller.KP=14000,controller.KD=4; repeatable.",
)
@click.option("--free", metavar="NAME,...", help="Parameters to identify (default: those of the table or the diagram).")
@click.option("--noise", metavar="LEVELS", help="Noise in %, a list such as 0,1,2,5.")
@click.option(
    "--noise-kind",
    "kinds",
    multiple=True,
    type=click.Choice(common.NOISE_KINDS),
    help="white: Gaussian, in % of each signal's rms (default); thesis: eq. (2.67) with normal R; uniform: "
    "with R from 0 to 1, as the thesis' figures look; repeatable.",
)
@click.option(
    "--wrong",
    multiple=True,
    metavar="NAME,...",
    help="Known parameters that one draw makes wrong: rotor.mass,unbalance.mass; repeatable.",
)
@click.option("--bias", metavar="LEVELS", help="Standard deviation of their relative errors in %, a list.")
@click.option("--seeds", type=click.IntRange(1, 1_000_000), default=100, show_default=True, help="Draws of each case.")
@click.option(
    "--method",
    type=click.Choice(["regression", "likelihood"]),
    default="regression",
    show_default=True,
    help="The thesis' least squares, or maximum likelihood with intervals.",
)
@click.option("--reduction", type=click.Choice(["exact", "central"]), help="Elimination of what was not measured.")
@click.option("--measured-input", "given", multiple=True, metavar="PORT", help="Take this port as it was measured.")
@click.option(
    "--window", metavar="FROM:TO", default="4 s:5 s", show_default=True, help="What is used of a run from rest."
)
@click.option("--settled", is_flag=True, help="Take the settled motion instead of a run from rest.")
@click.option("--smallest-crack", is_flag=True, help="Smallest crack stiffness that is seen, for each level of noise.")
@click.option("--controllers", is_flag=True, help="The same study with each controller of the library.")
@click.option("--store", metavar="FILE", help="Keep every estimate here; an interrupted study resumes from it.")
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask cluster that you trust to run code here, tls://host:port or tcp://host:port (default: this machine).",
)
@click.option(
    "--workers", type=click.IntRange(1), metavar="N", help="Number of processes (default: one for every CPU)."
)
@click.option("--out", metavar="FILE", help="Write the table: .csv or .json.")
@common.set_option
@common.without_option
@common.trust_option
@common.progress_option
@common.json_option
def command(
    diagram: str | None,
    table: str | None,
    listing: bool,
    smallest_crack: bool,
    controllers: bool,
    store: str | None,
    scheduler: str | None,
    workers: int | None,
    out: str | None,
    progress: bool | None,
    as_json: bool,
    **options: Any,
) -> None:
    """How noise and wrong known parameters move the identified parameters, over many seeds.

    Runs are simulated with DIAGRAM, noise is added, and the parameters that its key "identify" leaves free are
    estimated for every seed. Errors are in % of the true value.

    \b
    rotorsim sensitivity --table 2-6 --seeds 400
    rotorsim sensitivity jeffcott --speeds "1140 rpm:60 rpm:1620 rpm" --noise 1,2,5 --method likelihood
    rotorsim sensitivity --table 2-5 --smallest-crack
    """
    if listing:
        _list(as_json)
        return
    common.check_target("--out", out, SUFFIXES)
    if smallest_crack and controllers:
        raise RotorsimError(Problem("--smallest-crack and --controllers exclude each other", hint="give one of them"))
    question = "--smallest-crack" if smallest_crack else "--controllers" if controllers else ""
    if question and store:
        raise RotorsimError(Problem(f"--store keeps one study; {question} makes several", hint="leave it out"))
    study = _study(diagram, table, **options)
    jobs: dict[str, Any] = {"scheduler": scheduler, "workers": workers}
    with common.progress_bar("sensitivity", progress) as bar:
        if smallest_crack:
            from rotorsim.identification.study.questions import smallest_rows, smallest_size

            sizes = smallest_size(study, progress=bar, **jobs)
            text, rows = _smallest_text(study, sizes), smallest_rows(sizes)
            data: Any = rows
        elif controllers:
            from rotorsim.identification.study.questions import compare_controllers, comparison_rows

            compared = compare_controllers(study, progress=bar, **jobs)
            text, rows = _comparison_text(compared), comparison_rows(compared)
            data = {"rows": rows, "left_out": dict(compared.left_out)}
        else:
            from rotorsim.identification.study.study import run_study, study_data, study_rows

            found = run_study(study, store=store, progress=bar, **jobs)
            text, data, rows = _text(found), study_data(found), study_rows(found)
    if out:
        from rotorsim.identification.study.study import write_rows

        write_rows(rows, common.plain(data), out)
        common.note(f"written: {out}")
    if as_json:
        common.echo_json(data)
    else:
        click.echo(text)


def _study(
    diagram: str | None,
    table: str | None,
    *,
    settings: Sequence[str],
    without: Sequence[str],
    trust_blocks: bool,
    speeds: str | None,
    gains: Sequence[str],
    free: str | None,
    noise: str | None,
    kinds: tuple[str, ...],
    wrong: Sequence[str],
    bias: str | None,
    seeds: int,
    method: str,
    reduction: str | None,
    given: tuple[str, ...],
    window: str,
    settled: bool,
) -> Study:
    """Return the study that the options describe."""
    from pathlib import Path

    from rotorsim.identification.study.plan import Study
    from rotorsim.identification.study.printed import TABLES
    from rotorsim.identification.study.study import study_of_table

    if diagram is None and table is None:
        hint = "rotorsim sensitivity --table 2-5, or a diagram with --speeds"
        raise RotorsimError(Problem("neither a diagram nor --table", hint=hint))
    if table is None and speeds is None:
        raise RotorsimError(Problem("--speeds is missing", hint='--speeds "1140 rpm:60 rpm:1620 rpm"'))
    if table is not None and table not in TABLES:
        raise RotorsimError(Problem(f"--table {table}: no such table", hint=f"one of {', '.join(TABLES)}"))
    name = diagram if diagram is not None else TABLES[table or ""].diagram
    loaded = common.open_diagram(name, settings, without, trust_blocks)
    changes: dict[str, Any] = {
        "diagram": loaded.document,
        "seeds": seeds,
        "method": method,
        "given": given,
        "window": _window(window),
        "settled": settled,
        "without": tuple(without),
        "trust_blocks": trust_blocks,
        "folder": str(Path(name).resolve().parent) if Path(name).exists() else ".",
    }
    if speeds is not None:
        changes["speeds"] = tuple(float(speed) for speed in common.speeds_of(speeds))
    if gains:
        changes["gains"] = tuple(_gains(text, loaded) for text in gains)
    if free is not None:
        changes["free"] = _names(free)
    if reduction is not None:
        changes["reduction"] = reduction
    if kinds:
        changes["kinds"] = kinds
    if given and method == "regression":
        hint = "it takes every port that was measured whole as it was"
        raise RotorsimError(Problem("--measured-input belongs to --method likelihood", hint=hint))
    if reduction is not None and method == "likelihood":
        raise RotorsimError(Problem("--reduction belongs to --method regression"))
    if wrong and bias is None and table is None:
        raise RotorsimError(Problem("--wrong needs --bias", hint="for example --bias 1,2,5"))
    if wrong:
        changes["groups"] = {text: _names(text) for text in wrong}
    if bias is not None:
        changes["bias"] = _levels(bias, "--bias")
    if noise is not None or (table is None and bias is None):
        changes["noise"] = _levels("0,1,2,5" if noise is None else noise, "--noise")
    return Study(**changes) if table is None else study_of_table(table, **changes)


def _names(text: str) -> tuple[str, ...]:
    """Return the names of a list; commas within brackets belong to a name."""
    import re

    return tuple(part.strip() for part in re.split(r",(?![^\[]*\])", text) if part.strip())


def _levels(text: str, option: str) -> tuple[float, ...]:
    try:
        levels = tuple(float(part.strip().rstrip("% ")) / 100 for part in text.split(","))
    except ValueError:
        hint = f'levels in per cent: {option} "0, 1, 2, 5"'
        raise RotorsimError(Problem(f"{option} {text}: not a list of numbers", hint=hint)) from None
    return tuple(dict.fromkeys(levels))


def _window(text: str) -> tuple[float, float]:
    parts = text.split(":")
    if len(parts) != 2:
        raise RotorsimError(Problem(f"--window {text}: not FROM:TO", hint='for example --window "4 s:5 s"'))
    first, last = (common.quantity(part.strip(), "s", "--window") for part in parts)
    return first, last


def _gains(text: str, diagram: Any) -> dict[str, float]:
    """Return NAME=VALUE,... as SI values by name."""
    from rotorsim.diagram.resolve.values import ValueProblem, numeric
    from rotorsim.errors import near_miss

    units = {
        f"{block}.{name}": declared.unit
        for block, node in diagram.nodes.items()
        for name, declared in node.block.parameters.items()
    }
    units |= dict(diagram.parameter_units)
    values: dict[str, float] = {}
    problems = []
    for name, value in common.parse_settings(_names(text)).items():
        if name not in units:
            problems.append(Problem(f"--gains: no parameter '{name}'", diagram.name, hint=near_miss(name, units)))
            continue
        try:
            values[name] = float(numeric(value, units[name]))
        except (ValueProblem, TypeError) as problem:
            hint = getattr(problem, "hint", "a number, or text with a unit")
            problems.append(Problem(f"--gains {name}: {getattr(problem, 'what', problem)}", diagram.name, hint=hint))
    if problems:
        raise RotorsimError(*problems)
    return values


# -- what is shown -----------------------------------------------------------------------------------------------------


def _list(as_json: bool) -> None:
    from rotorsim.identification.study.printed import LEVELS, TABLES

    tables = list(TABLES.values())
    if as_json:
        common.echo_json(
            [
                {
                    "table": t.number,
                    "varied": t.kind,
                    "diagram": t.diagram,
                    "speeds_rpm": list(t.speeds_rpm),
                    "levels": list(LEVELS),
                    "parameters": list(t.free),
                    "reduction": t.reduction,
                }
                for t in tables
            ]
        )
        return
    rows = [
        (t.number, t.kind, t.diagram, "{:g}:{:g}:{:g} rpm".format(*t.speeds_rpm), str(len(t.rows)), t.reduction)
        for t in tables
    ]
    click.echo(common.table(("table", "varied", "diagram", "speeds", "parameters", "reduction"), rows))


def _text(found: StudyResult) -> str:
    """Return the table of a study with what must be known to read it."""
    study = found.study
    columns: list[tuple[str, list[str]]] = [
        ("parameter", [row.parameter for row in found.rows]),
        ("true", [_value(row.true, row.unit) for row in found.rows]),
        ("case", [str(row.case) for row in found.rows]),
        ("mean error", [_percent(row.mean_percent) for row in found.rows]),
        ("rms error", [_percent(row.rms_percent) for row in found.rows]),
        ("rms error", [_value(row.rms_error, row.unit) for row in found.rows]),
        ("thesis", [_percent(row.published) for row in found.rows]),
        ("coverage", [_share(row.coverage) for row in found.rows]),
        ("identified", [_share(row.identified) for row in found.rows]),
    ]
    columns = [column for column in columns if any(cell != "-" for cell in column[1])]
    lines = [list(line) for line in zip(*(cells for _, cells in columns), strict=True)]
    for before, line in zip(reversed(found.rows[:-1]), reversed(lines[1:]), strict=True):
        if before.parameter == line[0]:
            line[0] = line[1] = ""
    rpm = [abs(common.rpm(speed)) for speed in study.speeds]
    title = f"Table {study.table} of the thesis: " if study.table else ""
    title += f"{study.diagram.get('name')}, {len(rpm)} speeds, {min(rpm):g} to {max(rpm):g} rpm"
    title += f", {len(study.gains)} sets of gains" if len(study.gains) > 1 else ""
    title += f"; {study.method}" + (f", {study.reduction} reduction" if study.method == "regression" else "")
    notes = [f"{study.seeds} seeds in every case; errors in % of the true value, angles too."]
    if any(row.coverage is not None for row in found.rows):
        share = 100 * found.coverage_tolerance
        notes.append(f"A right 90 % interval covers the true value in 90 +- {share:.2g} % of so many seeds.")
    if found.failed:
        notes.append(f"{len(found.failed)} estimates failed and are left out; the first: {found.failed[0]}")
    notes += _misprints(study.table)
    return "\n\n".join([title, common.table([name for name, _ in columns], lines), "\n".join(notes)])


def _misprints(table: str) -> list[str]:
    from rotorsim.identification.study.printed import misprints

    found = [
        f"{symbol} at {100 * level:g} %: {printed:g} % is printed, its value says {error:.2f} %"
        for number, symbol, level, printed, error in misprints()
        if number == table
    ]
    return ["The thesis contradicts itself:", *(f"  {line}" for line in found)] if found else []


def _percent(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.3g} %"


def _rms(row: StudyRow) -> str:
    return _value(row.rms_error, row.unit) if row.rms_percent is None else _percent(row.rms_percent)


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.3g} %"


def _value(value: float, unit: str) -> str:
    scale, shown = {"m": (1e6, "um"), "rad": (180 / math.pi, "deg")}.get(unit, (1.0, unit))
    return f"{value * scale:.4g} {shown}"


def _smallest_text(study: Study, sizes: Sequence[Smallest]) -> str:
    rows = [
        (str(size.case), _value(size.expected, size.unit), _value(size.size, size.unit), _share(size.share))
        for size in sizes
    ]
    name = sizes[0].parameter
    title = f"Smallest {name} of {study.diagram.get('name')} whose 90 % interval excludes zero"
    notes = [
        "expected: 2.93 standard deviations at size zero, by the information of the experiment; confirmed: where the",
        f"interval excluded zero in 90 % of {study.seeds} seeds, in steps of 10 %.",
    ]
    left_out = dict.fromkeys(other for size in sizes for other in size.left_out)
    if left_out:
        notes.append(f"Taken as known, for it has no effect at size zero: {', '.join(left_out)}.")
    table = common.table(("noise", "expected", "confirmed", "in share of seeds"), rows)
    return "\n\n".join([title, table, "\n".join(notes)])


def _comparison_text(compared: Comparison) -> str:
    """Return the rms errors of every controller, and which were left out."""
    parts = []
    if compared.results:
        first = next(iter(compared.results.values()))
        rows = []
        for row in first.rows:
            cells = [_rms(found.row(row.parameter, row.case)) for found in compared.results.values()]
            rows.append((row.parameter, str(row.case), *cells))
        parts.append(
            f"rms errors of {first.study.diagram.get('name')}, {first.study.seeds} seeds; {first.study.method}"
        )
        parts.append(common.table(("parameter", "case", *compared.results), rows))
    parts += [f"left out: {name}: {why}" for name, why in compared.left_out.items()]
    return "\n\n".join(parts)
