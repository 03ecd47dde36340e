"""``rotorsim diagnose``."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotorsim.cli.shared import (
    Chosen,
    amplitude_option,
    check_folder,
    diagram_argument,
    hold_out_option,
    jobs_options,
    json_option,
    keep_diagram,
    known_names,
    listed,
    note,
    parameter_options,
    progress_bar,
    progress_option,
    refuse_all,
    refuse_if,
    show,
    show_problems,
    speeds_of,
)
from rotorsim.errors import Problem, RotorsimError
from rotorsim.report.text.table import table

if TYPE_CHECKING:
    from rotorsim.diagnosis.conclude.result import Diagnosis
    from rotorsim.diagram.diagram import Diagram

REPORT_MODULE = "rotorsim.report.diagnosis.report"
EITHER = "--sensors rotor.displacement,controller.current asks what could be told, a RECORDING what is"


@click.command("diagnose")
@diagram_argument
@click.argument("recording", metavar="[RECORDING]", required=False)
@click.option("--out", metavar="DIR", help="Write diagnosis.json, the repaired diagram.json and report.html there.")
@hold_out_option
@click.option("--sensors", metavar="LIST", help="Without RECORDING: say which faults these signals detect and isolate.")
@click.option("--speeds", metavar="SPEEDS", help="With --sensors: of the runs, as '900 rpm:300 rpm:2100 rpm'.")
@click.option("--physics", metavar="LIST", help="Only these faults of the catalogue, such as runout,residual_bow.")
@jobs_options
@parameter_options
@progress_option
@amplitude_option
@json_option
def command(
    chosen: Chosen,
    recording: str | None,
    out: str | None,
    hold_out: str | None,
    sensors: str | None,
    speeds: str | None,
    physics: str | None,
    workers: int | None,
    scheduler: str | None,
    progress: bool | None,
    as_json: bool,
) -> int:
    """Say where DIAGRAM and RECORDING differ, what physics is missing, and repair the diagram.

    The free parameters are refitted first. If noise does not explain the residual, every fault of the catalogue
    (blocks that declare one, `rotorsim blocks`) is put at every place, refitted and judged; the best is kept, with
    what explains the data as well. Exit code 1: something is missing.

    With --sensors and no RECORDING: which faults signals can detect and isolate, and which sensor to add.

    \b
    rotorsim diagnose jeffcott measurements/2026-11 --out diagnosis
    rotorsim diagnose jeffcott --sensors rotor.displacement,controller.current
    """
    refuse_if((recording is None) == (sensors is None), "give either a RECORDING or --sensors", hint=EITHER)
    if recording is None:
        given = {"--out": out, "--hold-out": hold_out, "--workers": workers, "--scheduler": scheduler}
        what, hint = "does not go with --sensors", "it goes with a RECORDING"
    else:
        given = {"--speeds": speeds}
        what, hint = "does not go with a RECORDING", "it goes with --sensors; a recording has its own"
    problems = [Problem(f"{name} {what}", hint=hint) for name, value in given.items() if value is not None]
    refuse_all(problems)
    kinds = None if physics is None else _physics(physics)
    if sensors is not None:
        _show_isolability(chosen, listed(sensors), speeds, kinds, progress, as_json)
        return 0
    from rotorsim.diagnosis.diagnosis import diagnose
    from rotorsim.diagnosis.files import diagnosis_data, save_diagnosis
    from rotorsim.jobs.jobs import Jobs, local_workers
    from rotorsim.recordings.orders import load_any

    check_folder("--out", out)
    keep_diagram(out, chosen.name)
    loaded = chosen.open()
    _check_free(loaded)
    measured = load_any(_existing("RECORDING", recording or ""))
    refuse_if(
        measured.runs and not measured.select("identify"),
        f"RECORDING {recording}: all its runs are held out",
        hint='give runs to be scored only with --hold-out, or mark some of these "use": "identify"',
    )
    held = None if hold_out is None else load_any(_existing("--hold-out", hold_out))
    if out:
        _make(out)
    with local_workers(Jobs(workers, scheduler), diagnose.__module__, *([REPORT_MODULE] if out else [])) as jobs:
        with progress_bar("diagnose", progress) as bar:
            diagnosis = diagnose(loaded, measured, hold_out=held, physics=kinds, jobs=jobs, progress=bar)
        show_problems(diagnosis.warnings)
        if out:
            from rotorsim.report.diagnosis.report import save_report

            for file in (*save_diagnosis(diagnosis, out), *save_report(diagnosis, out, jobs=jobs)):
                note(f"written: {file}")
    show(as_json, lambda: diagnosis_data(diagnosis), lambda: _text(diagnosis))
    return 0 if diagnosis.verdict == "consistent" else 1


def _show_isolability(
    chosen: Chosen,
    sensors: Collection[str],
    speeds: str | None,
    physics: Collection[str] | None,
    progress: bool | None,
    as_json: bool,
) -> None:
    """Print which faults of a diagram sensors detect and isolate; physics: only these (default: all)."""
    from rotorsim.diagnosis.isolability.isolation import isolate, isolation_data
    from rotorsim.report.text.isolability import isolability_text

    loaded = chosen.open()
    at = [] if speeds is None else speeds_of(speeds).tolist()
    refuse_if(0 in at, f"--speeds {speeds}: the shaft does not turn", hint="leave 0 out")
    with progress_bar("signatures", progress) as bar:
        isolation = isolate(loaded, list(dict.fromkeys(sensors)), speeds=at, physics=physics, progress=bar)
    show_problems(isolation.warnings)
    show(as_json, lambda: isolation_data(isolation), lambda: isolability_text(isolation))


def _existing(what: str, path: str) -> str:
    refuse_if(
        not Path(path).exists(),
        f"{what} {path}: does not exist",
        hint="a recording is a folder with recording.json and data files; see docs/recordings.md",
    )
    return path


def _make(folder: str) -> None:
    """Make a folder before the work begins. Raises RotorsimError."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        what = f"--out {folder}: cannot be made: {(error.strerror or str(error)).lower()}"
        raise RotorsimError(Problem(what, hint="give a folder that you may write to")) from error


def _check_free(diagram: Diagram) -> None:
    """Raise RotorsimError where nothing may be refitted."""
    from rotorsim.diagnosis.evidence.base_fit import with_uncertain

    if not with_uncertain(diagram).get("identify"):
        known = [name for name in diagram.parameters if name != "speed"]
        known += [f"{name}.{key}" for name, node in diagram.nodes.items() for key in node.block.parameters]
        name = (known or ["block.parameter"])[0]
        hint = f'name what is not known exactly, such as "identify": {{"{name}": {{}}}}'
        raise RotorsimError(Problem("no free parameters: identify is empty", diagram.file or diagram.name, hint=hint))


def _physics(text: str) -> list[str]:
    """Return names of physics. Raises RotorsimError for those that no block declares."""
    from rotorsim.diagram.resolve.registry import all_types

    known = sorted({fault.physics for kind in all_types().values() for fault in kind.faults})
    wanted = known_names(listed(text), known, lambda name: f"--physics {name}: no block declares it")
    refuse_if(not wanted, "--physics: names nothing", hint=f"known: {', '.join(known)}")
    return wanted


def _text(diagnosis: Diagnosis) -> str:
    """Return verdict, table of what is missing, places, and the statement."""
    parts = [f"verdict: {diagnosis.verdict}"]
    rows = [
        (name, f"{probability:.2g}", effect.at(name))
        for effect in diagnosis.effects
        for name, probability in effect.members.items()
    ]
    if rows and diagnosis.verdict != "outside_catalogue":
        parts.append(table(("missing", "probability", "at"), rows))
    elif diagnosis.places:
        parts.append(
            table(("place", "probability"), [(one.words, f"{one.probability:.2g}") for one in diagnosis.places[:8]])
        )
    parts.append(diagnosis.statement)
    parts.append(f"Next experiment: {diagnosis.next_experiment}.")
    return "\n\n".join(parts)
