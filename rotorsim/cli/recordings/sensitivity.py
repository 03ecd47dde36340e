"""``rotorsim sensitivity``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorsim.cli.shared import (
    Chosen,
    file_option,
    gains_of,
    given_options,
    jobs_options,
    json_option,
    known_names,
    listed,
    measured_input_option,
    noise_kind_option,
    note,
    plain,
    progress_bar,
    progress_option,
    refuse_if,
    show,
    speeds_of,
    window_of,
)
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from rotorsim.diagram.diagram import Diagram
    from rotorsim.identification.study.plan import Study

DEFAULT_NOISE = "0,1,2,5"  # levels in %


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
@noise_kind_option(
    "kinds",
    "white: Gaussian, in % of each signal's rms (default); thesis: eq. (2.67) with normal R; uniform: "
    "with R from 0 to 1, as the thesis' figures look; repeatable.",
    multiple=True,
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
@measured_input_option
@click.option(
    "--window", metavar="START:STOP", default="4 s:5 s", show_default=True, help="What is used of a run from rest."
)
@click.option("--settled", is_flag=True, help="Take the settled motion instead of a run from rest.")
@click.option("--smallest-crack", is_flag=True, help="Smallest crack stiffness that is seen, for each level of noise.")
@click.option("--controllers", is_flag=True, help="The same study with each controller of the library.")
@click.option("--store", metavar="FILE", help="Keep every estimate here; an interrupted study resumes from it.")
@jobs_options
@file_option("--out", suffixes=(".csv", ".json"), help="Write the table: .csv or .json.")
@given_options
@progress_option
@json_option
def command(
    chosen: Chosen,
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
    from rotorsim.report.text import study as text

    if listing:
        show(as_json, text.tables_data, text.tables_text)
        return
    refuse_if(
        smallest_crack and controllers, "--smallest-crack and --controllers exclude each other", hint="give one of them"
    )
    question = "--smallest-crack" if smallest_crack else "--controllers" if controllers else ""
    refuse_if(question and store, f"--store keeps one study; {question} makes several", hint="leave it out")
    study = _study(chosen, table, **options)
    with progress_bar("sensitivity", progress) as bar:
        jobs: dict[str, Any] = {"scheduler": scheduler, "workers": workers, "progress": bar}
        if smallest_crack:
            from rotorsim.identification.study.questions import smallest_rows, smallest_size

            sizes = smallest_size(study, **jobs)
            said, rows = text.smallest_text(study, sizes), smallest_rows(sizes)
            data: Any = rows
        elif controllers:
            from rotorsim.identification.study.questions import compare_controllers, comparison_rows

            compared = compare_controllers(study, **jobs)
            said, rows = text.controllers_text(compared), comparison_rows(compared)
            data = {"rows": rows, "left_out": dict(compared.left_out)}
        else:
            from rotorsim.identification.study.study import run_study, study_data, study_rows

            result = run_study(study, store=store, **jobs)
            said, rows, data = text.study_text(result), study_rows(result), study_data(result)
    if out:
        from rotorsim.identification.study.study import write_rows

        write_rows(rows, plain(data), out)
        note(f"written: {out}")
    show(as_json, lambda: data, lambda: said)


def _study(
    chosen: Chosen,
    table: str | None,
    *,
    speeds: str | None,
    gains: Sequence[str],
    free: str | None,
    noise: str | None,
    wrong: Sequence[str],
    bias: str | None,
    window: str,
    **others: Any,
) -> Study:
    """Return the study that the options describe; others: those that it takes as they are."""
    from rotorsim.identification.study.plan import Study
    from rotorsim.identification.study.printed import TABLES
    from rotorsim.identification.study.study import study_of_table

    _check(chosen, table, speeds, wrong, bias, **others)
    chosen = replace(chosen, name=chosen.name or TABLES[table or ""].diagram)
    loaded = chosen.open()
    here = str(Path(chosen.name).resolve().parent) if Path(chosen.name).exists() else "."
    levels = noise or (DEFAULT_NOISE if table is None and bias is None else None)
    changes: dict[str, Any] = {
        "diagram": loaded.document,
        "window": window_of(window),
        "without": chosen.without,
        "trust_blocks": chosen.trust_blocks,
        "folder": here,
        "speeds": tuple(speeds_of(speeds).tolist()) if speeds else None,
        "gains": tuple(_gains(text, loaded) for text in gains) or None,
        "free": None if free is None else listed(free),
        "groups": {text: listed(text) for text in wrong} or None,
        "bias": None if bias is None else _levels(bias, "--bias"),
        "noise": None if levels is None else _levels(levels, "--noise"),
        **others,
        "kinds": others["kinds"] or None,
    }
    given = {name: value for name, value in changes.items() if value is not None}
    return Study(**given) if table is None else study_of_table(table, **given)


def _check(
    chosen: Chosen,
    table: str | None,
    speeds: str | None,
    wrong: Sequence[str],
    bias: str | None,
    *,
    method: str,
    given: Sequence[str],
    reduction: str | None,
    **others: Any,
) -> None:
    """Refuse options that miss others, or do not go together."""
    from rotorsim.identification.study.printed import TABLES

    new, hint = table is None, "rotorsim sensitivity --table 2-5, or a diagram with --speeds"
    refuse_if(new and not chosen.name, "neither a diagram nor --table", hint=hint)
    refuse_if(new and speeds is None, "--speeds is missing", hint='--speeds "1140 rpm:60 rpm:1620 rpm"')
    refuse_if(not new and table not in TABLES, f"--table {table}: no such table", hint=f"one of {', '.join(TABLES)}")
    hint = "it takes every port that was measured whole as it was"
    refuse_if(given and method == "regression", "--measured-input belongs to --method likelihood", hint=hint)
    refuse_if(reduction and method == "likelihood", "--reduction belongs to --method regression")
    refuse_if(new and wrong and bias is None, "--wrong needs --bias", hint="for example --bias 1,2,5")


def _levels(text: str, option: str) -> tuple[float, ...]:
    """Return levels, of one, of a list in per cent."""
    try:
        levels = tuple(float(part.strip().rstrip("% ")) / 100 for part in text.split(","))
    except ValueError:
        hint = f'levels in per cent: {option} "0, 1, 2, 5"'
        raise RotorsimError(Problem(f"{option} {text}: not a list of numbers", hint=hint)) from None
    return tuple(dict.fromkeys(levels))


def _gains(text: str, diagram: Diagram) -> dict[str, float]:
    """Return NAME=VALUE,... as SI values by name."""
    from rotorsim.diagram.resolve.values import ValueProblem, numeric

    units = {
        f"{block}.{name}": declared.unit
        for block, node in diagram.nodes.items()
        for name, declared in node.block.parameters.items()
    }
    units |= dict(diagram.parameter_units)
    given = gains_of(text)
    known_names(given, units, lambda name: f"--gains: no parameter '{name}'", diagram.name)
    values: dict[str, float] = {}
    for name, value in given.items():
        try:
            values[name] = float(numeric(value, units[name]))
        except ValueProblem as problem:
            raise RotorsimError(Problem(f"--gains {name}: {problem.what}", diagram.name, hint=problem.hint)) from None
        except TypeError:
            hint = "a number, or text with a unit"
            raise RotorsimError(Problem(f"--gains {name}: not one number", diagram.name, hint=hint)) from None
    return values
