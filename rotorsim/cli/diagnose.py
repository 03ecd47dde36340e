"""``rotorsim diagnose``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError, near_miss

if TYPE_CHECKING:
    from rotorsim.diagnosis.conclude.conclusions import Diagnosis
    from rotorsim.diagram.diagram import Diagram

__all__ = ["command"]

_EITHER = "--sensors rotor.displacement,controller.current asks what could be told, a RECORDING what is"


@click.command("diagnose")
@click.argument("diagram", metavar="DIAGRAM")
@click.argument("recording", metavar="[RECORDING]", required=False)
@click.option("--out", metavar="DIR", help="Write diagnosis.json, the repaired diagram.json and report.html there.")
@click.option("--hold-out", metavar="RECORDING", help="Further runs, for scoring only.")
@click.option("--sensors", metavar="LIST", help="Without RECORDING: say which faults these signals tell apart.")
@click.option("--speeds", metavar="SPEEDS", help="With --sensors: of the runs, as '900 rpm:300 rpm:2100 rpm'.")
@click.option("--physics", metavar="LIST", help="Only these rows of the catalogue, such as runout,residual_bow.")
@click.option("--workers", type=click.IntRange(1), metavar="N", help="Processes (default: one for every CPU).")
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask cluster that you trust to run code here, tls://host:port or tcp://host:port (default: this machine).",
)
@common.set_option
@common.trust_option
@common.progress_option
@common.json_option
def command(
    diagram: str,
    recording: str | None,
    out: str | None,
    hold_out: str | None,
    sensors: str | None,
    speeds: str | None,
    physics: str | None,
    workers: int | None,
    scheduler: str | None,
    settings: tuple[str, ...],
    trust_blocks: bool,
    progress: bool | None,
    as_json: bool,
) -> None:
    """Say where DIAGRAM and RECORDING differ, what physics is missing, and repair the diagram.

    The free parameters are refitted first. If noise does not explain the rest, every row of the catalogue (blocks
    that declare a fault, `rotorsim blocks`) is put at every place, refitted and judged; the best is kept, with what
    explains the data as well. Exit code 1: something is missing.

    With --sensors and no RECORDING: which faults signals can tell apart, and which sensor to add.

    \b
    rotorsim diagnose jeffcott measurements/2026-11 --out diagnosis
    rotorsim diagnose jeffcott --sensors rotor.displacement,controller.current
    """
    from rotorsim.cli.app import show_problems
    from rotorsim.cli.structure import show_isolation
    from rotorsim.diagnosis.diagnosis import diagnose
    from rotorsim.diagnosis.files import diagnosis_data, save_diagnosis
    from rotorsim.recordings.loading import load_recording

    if (recording is None) == (sensors is None):
        raise RotorsimError(Problem("give either a RECORDING or --sensors", hint=_EITHER))
    given = {"--out": out, "--hold-out": hold_out, "--workers": workers, "--scheduler": scheduler}
    misfits = [
        name for name, value in ({"--speeds": speeds} if sensors is None else given).items() if value is not None
    ]
    if misfits:
        hint = "it goes with a RECORDING" if sensors is not None else "it goes with --sensors; a recording has its own"
        other = "--sensors" if sensors is not None else "a RECORDING"
        raise RotorsimError(*(Problem(f"{name} does not go with {other}", hint=hint) for name in misfits))
    if sensors is not None:
        rows = None if physics is None else _rows(physics)
        plain = common.open_diagram(diagram, settings, (), trust_blocks)
        show_isolation(
            plain, sensors, speeds, physics=rows, trust_blocks=trust_blocks, progress=progress, as_json=as_json
        )
        return
    assert recording is not None
    common.check_folder("--out", out)
    if out and Path(diagram).exists() and (Path(out) / "diagram.json").resolve() == Path(diagram).resolve():
        raise RotorsimError(Problem(f"--out {out}: would overwrite {diagram}", hint="give another folder"))
    rows = None if physics is None else _rows(physics)
    loaded = common.open_diagram(diagram, settings, (), trust_blocks)
    _check_free(loaded)
    measured = load_recording(_existing("RECORDING", recording))
    if measured.runs and not measured.select("identify"):
        hint = 'give runs to be scored only with --hold-out, or mark some of these "use": "identify"'
        raise RotorsimError(Problem(f"RECORDING {recording}: all its runs are held out", hint=hint))
    held = None if hold_out is None else load_recording(_existing("--hold-out", hold_out))
    if out:
        _made(out)
    with common.progress_bar("diagnose", progress) as show:
        found = diagnose(
            loaded,
            measured,
            hold_out=held,
            physics=rows,
            trust_blocks=trust_blocks,
            workers=workers,
            scheduler=scheduler,
            progress=show,
        )
    show_problems(found.warnings)
    if out:
        from rotorsim.report.diagnosis.report import save_report

        for save in (save_diagnosis, save_report):
            for file in save(found, out):
                common.note(f"written: {file}")
    if as_json:
        common.echo_json(diagnosis_data(found))
    else:
        click.echo(_text(found))
    if found.verdict != "consistent":
        sys.exit(1)


def _existing(what: str, path: str) -> str:
    if not Path(path).exists():
        hint = "a recording is a folder with recording.json and data files; see docs/recordings.md"
        raise RotorsimError(Problem(f"{what} {path}: does not exist", hint=hint))
    return path


def _made(folder: str) -> None:
    """Make a folder before the work begins. Raises RotorsimError."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        what = f"--out {folder}: cannot be made: {(error.strerror or str(error)).lower()}"
        raise RotorsimError(Problem(what, hint="give a folder that you may write to")) from error


def _check_free(diagram: Diagram) -> None:
    """Raise RotorsimError where nothing may be refitted."""
    from rotorsim.diagnosis.evidence.base import with_uncertain

    if not with_uncertain(diagram).get("identify"):
        known = [name for name in diagram.parameters if name != "speed"]
        known += [f"{name}.{key}" for name, node in diagram.nodes.items() for key in node.block.parameters]
        name = (known or ["block.parameter"])[0]
        hint = f'name what is not known exactly, such as "identify": {{"{name}": {{}}}}'
        raise RotorsimError(Problem("no free parameters: identify is empty", diagram.file or diagram.name, hint=hint))


def _rows(text: str) -> list[str]:
    """Return names of physics. Raises RotorsimError for those that no block declares."""
    from rotorsim.diagram.resolve.registry import all_types

    known = sorted({fault.physics for kind in all_types().values() for fault in kind.faults})
    wanted = [name.strip() for name in text.split(",") if name.strip()]
    problems = [
        Problem(f"--physics {name}: no block declares it", hint=near_miss(name, known))
        for name in wanted
        if name not in known
    ]
    if problems or not wanted:
        raise RotorsimError(*(problems or [Problem("--physics: names nothing", hint=f"known: {', '.join(known)}")]))
    return wanted


def _text(found: Diagnosis) -> str:
    """Return verdict, table of what is missing, places, and the statement."""
    parts = [f"verdict: {found.verdict}"]
    rows = [
        (name, f"{probability:.2g}", str(effect.spot_of(name) or ""))
        for effect in found.effects
        for name, probability in effect.members.items()
    ]
    if rows and found.verdict != "outside_catalogue":
        parts.append(common.table(("missing", "probability", "at"), rows))
    elif found.places:
        parts.append(common.table(("place", "probability"), [(str(s), f"{p:.2g}") for s, p in found.places[:8]]))
    parts.append(found.statement)
    parts.append(f"Next experiment: {found.next_experiment}.")
    return "\n\n".join(parts)
