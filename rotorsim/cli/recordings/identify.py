"""``rotorsim identify``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import click

from rotorsim.cli.shared import (
    Chosen,
    amplitude_option,
    check_folder,
    diagram_argument,
    given_options,
    hold_out_option,
    json_option,
    keep_diagram,
    measured_input_option,
    note,
    recording_argument,
    refuse_all,
    share_of,
    show,
    show_problems,
    whole_numbers,
)
from rotorsim.errors import Problem
from rotorsim.report.text.table import parameter_unit, percent, table

if TYPE_CHECKING:
    from rotorsim.identification.result import Identification

USE_WORDS = {"identify": "identified from", "hold_out": "held out"}


@click.command("identify")
@diagram_argument
@recording_argument
@click.option("--out", metavar="DIR", help="Write identification.json, diagram.json and figures into this folder.")
@click.option(
    "--method",
    type=click.Choice(["likelihood", "regression"]),
    default="likelihood",
    show_default=True,
    help="Maximum likelihood, or the thesis' least squares.",
)
@measured_input_option
@hold_out_option
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
@given_options
@amplitude_option
@json_option
def command(
    chosen: Chosen,
    recording: str,
    out: str | None,
    method: str,
    given: tuple[str, ...],
    hold_out: str | None,
    precision: str,
    orders: str | None,
    reduction: str,
    as_json: bool,
) -> int:
    """Estimate the free parameters of DIAGRAM (its key "identify") from the measurements in RECORDING.

    RECORDING is a folder with recording.json. Every parameter comes with a 90 % interval and a verdict: identified,
    or not, why not, and which change of the experiment would help. Exit code 1: a parameter is not identified, or the
    model does not explain the data.

    \b
    rotorsim identify jeffcott measurements/2026-11 --out result
    """
    from rotorsim.identification.files import identification_data, identified_diagram, save_identification
    from rotorsim.identification.harmonic.regression import THESIS_ORDERS
    from rotorsim.identification.identification import identify
    from rotorsim.recordings.orders import load_any

    check_folder("--out", out)
    keep_diagram(out, chosen.name)
    share = share_of("--precision", precision, "for example --precision '5 %'")
    wanted = THESIS_ORDERS if orders is None else whole_numbers("--orders", orders, "--orders 0,1,2,-1")
    _refuse_unheard(method, orders, reduction, given)
    loaded, measured = chosen.open(), load_any(recording)
    identification = identify(
        loaded,
        measured,
        method=method,
        given=given,
        orders=wanted,
        reduction=reduction,
        precision=share,
        hold_out=None if hold_out is None else load_any(hold_out),
    )
    show_problems(identification.warnings)
    if out:
        from rotorsim.report.identification.figures import save_figures

        show_problems(identified_diagram(identification)[1])

        for file in [*save_identification(identification, out), *save_figures(identification, measured, out)]:
            note(f"written: {file}")
    show(as_json, lambda: identification_data(identification), lambda: _text(identification))
    return 1 if identification.open or not identification.adequate else 0


def _refuse_unheard(method: str, orders: str | None, reduction: str, given: tuple[str, ...]) -> None:
    """Refuse options that belong to the other method."""
    problems = []
    if method == "likelihood":
        options = {"--orders": orders is not None, "--reduction": reduction != "exact"}
        problems = [Problem(f"{name} belongs to --method regression") for name, used in options.items() if used]
    elif given:
        hint = "it takes every port that was measured whole as it was"
        problems = [Problem("--measured-input belongs to --method likelihood", hint=hint)]
    refuse_all(problems)


def _digits(value: float, std: float) -> int:
    """Return how many digits of a value show two of its standard deviation, from 6 to 15."""
    known = value and math.isfinite(value) and math.isfinite(std) and std > 0
    return min(max(2 + math.ceil(math.log10(abs(value) / std)), 6), 15) if known else 6


def _text(identification: Identification) -> str:
    """Return the table of parameters, the fit and the statement."""
    rows = []
    for item in identification.parameters.values():
        unit, scale = parameter_unit(item.unit)
        digits = _digits(item.value, item.std)
        low, high = (f"{end * scale:.{digits}g}" for end in item.interval90)
        verdict = ("yes" if identification.adequate else "if the model is right") if item.verdict.identifiable else "NO"
        rows.append(
            (
                item.name,
                f"{item.value * scale:.{digits}g}",
                f"{item.std * scale:.2g}",
                f"{low} .. {high}",
                unit,
                verdict,
            )
        )
    errors = [
        (signal, *(f"{fit.get(signal, math.nan) * 100:.3g} %" for fit in identification.fit.values()), percent(floor))
        for signal, floor in identification.noise_floor.items()
    ]
    return "\n\n".join(
        [
            table(("parameter", "value", "std", "90 % interval", "unit", "identified"), rows),
            table(("NRMSE of signal", *(USE_WORDS[use] for use in identification.fit), "noise floor"), errors),
            identification.statement,
        ]
    )
