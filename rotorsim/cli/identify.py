"""``rotorsim identify``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rotorsim.cli import common
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    from rotorsim.identification.identification import Identification

__all__ = ["command"]


@click.command("identify")
@click.argument("diagram", metavar="DIAGRAM")
@click.argument("recording", metavar="RECORDING")
@click.option("--out", metavar="DIR", help="Write identification.json, diagram.json and figures into this folder.")
@click.option(
    "--method",
    type=click.Choice(["likelihood", "regression"]),
    default="likelihood",
    show_default=True,
    help="Maximum likelihood, or the thesis' least squares.",
)
@click.option(
    "--measured-input",
    "given",
    multiple=True,
    metavar="PORT",
    help="Take this port as it was measured; what makes it need not be right.",
)
@click.option("--hold-out", metavar="RECORDING", help="Further runs on which the fit is scored.")
@click.option(
    "--precision",
    metavar="SHARE",
    default="5 %",
    show_default=True,
    help="Half width of the 90 % interval that counts as identified.",
)
@click.option("--orders", metavar="LIST", help="Harmonics of the regression (default: 0,1,2,3,5,7,-1,-3,-5).")
@click.option(
    "--reduction",
    type=click.Choice(["exact", "central"]),
    default="exact",
    show_default=True,
    help="Elimination of what was not measured, in the regression; central: as in the thesis.",
)
@common.set_option
@common.without_option
@common.trust_option
@common.json_option
def command(
    diagram: str,
    recording: str,
    out: str | None,
    method: str,
    given: tuple[str, ...],
    hold_out: str | None,
    precision: str,
    orders: str | None,
    reduction: str,
    settings: tuple[str, ...],
    without: tuple[str, ...],
    trust_blocks: bool,
    as_json: bool,
) -> None:
    """Estimate the free parameters of DIAGRAM (its key "identify") from the measurements in RECORDING.

    RECORDING is a folder with recording.json. Every parameter comes with a 90 % interval and a verdict: identified,
    or not, why not, and which change of the experiment would help. Exit code 1: a parameter is not identified, or the
    model does not explain the data.

    \b
    rotorsim identify jeffcott measurements/2026-11 --out result
    """
    from rotorsim.cli.app import show_problems
    from rotorsim.identification.files import identification_data, save_identification
    from rotorsim.identification.identification import identify
    from rotorsim.identification.regression import THESIS_ORDERS
    from rotorsim.recordings.loading import load_recording

    common.check_folder("--out", out)
    if out and Path(diagram).exists() and (Path(out) / "diagram.json").resolve() == Path(diagram).resolve():
        raise RotorsimError(Problem(f"--out {out}: would overwrite {diagram}", hint="give another folder"))
    share = _share(precision)
    wanted = THESIS_ORDERS if orders is None else _orders(orders)
    _refuse_unheard(method, orders, reduction, given)
    loaded = common.open_diagram(diagram, settings, without, trust_blocks)
    measured = load_recording(recording)
    found = identify(
        loaded,
        measured,
        method=method,
        given=given,
        orders=wanted,
        reduction=reduction,
        precision=share,
        hold_out=None if hold_out is None else load_recording(hold_out),
    )
    show_problems(found.warnings)
    if out:
        from rotorsim.report.identification.figures import save_figures

        for file in [*save_identification(found, out), *save_figures(found, measured, out)]:
            common.note(f"written: {file}")
    if as_json:
        common.echo_json(identification_data(found))
    else:
        click.echo(_text(found))
    if found.open or not found.adequate:
        sys.exit(1)


def _refuse_unheard(method: str, orders: str | None, reduction: str, given: tuple[str, ...]) -> None:
    """Refuse options that belong to the other method."""
    problems = []
    if method == "likelihood":
        options = [("--orders", orders is not None), ("--reduction", reduction != "exact")]
        problems = [Problem(f"{name} belongs to --method regression") for name, used in options if used]
    elif given:
        hint = "it takes every port that was measured whole as it was"
        problems = [Problem("--measured-input belongs to --method likelihood", hint=hint)]
    if problems:
        raise RotorsimError(*problems)


def _text(found: Identification) -> str:
    """Return the table of parameters, the fit and the statement."""
    rows = []
    for item in found.parameters.values():
        scale, unit = _shown(item.unit)
        low, high = (f"{end * scale:.6g}" for end in item.interval90)
        verdict = ("yes" if found.adequate else "if the model is right") if item.verdict.identifiable else "NO"
        rows.append(
            (item.name, f"{item.value * scale:.6g}", f"{item.std * scale:.2g}", f"{low} .. {high}", unit, verdict)
        )
    header = ("parameter", "value", "std", "90 % interval", "unit", "identified")
    parts = [common.table(header, rows)]
    signals = list(found.noise_floor)
    fit_rows = [
        (
            signal,
            *(f"{found.fit[use].get(signal, float('nan')) * 100:.3g} %" for use in found.fit),
            f"{found.noise_floor[signal] * 100:.3g} %",
        )
        for signal in signals
    ]
    uses = [{"identify": "identified from", "hold_out": "held out"}[use] for use in found.fit]
    parts.append(common.table(("NRMSE of signal", *uses, "noise floor"), fit_rows))
    parts.append(found.statement)
    return "\n\n".join(parts)


def _shown(unit: str) -> tuple[float, str]:
    import math

    return {"m": (1e6, "um"), "rad": (180 / math.pi, "deg")}.get(unit, (1.0, unit))


def _share(text: str) -> float:
    try:
        value = float(text.rstrip("% ")) / (100 if "%" in text else 1)
    except ValueError:
        value = -1.0
    if not 0 < value <= 1:
        raise RotorsimError(Problem(f"--precision {text}: not a share", hint="for example --precision '5 %'"))
    return value


def _orders(text: str) -> tuple[int, ...]:
    try:
        orders = tuple(int(part) for part in text.split(","))
    except ValueError:
        orders = ()
    if not orders or len(set(orders)) < len(orders):
        raise RotorsimError(
            Problem(f"--orders {text}: not a list of different whole numbers", hint="--orders 0,1,2,-1")
        )
    return orders
