"""How noise and wrong known parameters move identified ones, as text: tables of studies, smallest cracks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rotorsim.identification.study.printed import PRINTED_LEVELS, TABLES, misprints
from rotorsim.report.text.table import parameter_unit, percent, rpm, table

if TYPE_CHECKING:
    from rotorsim.identification.study.plan import Study
    from rotorsim.identification.study.questions import Comparison, Smallest
from rotorsim.identification.study.study import StudyResult, StudyRow


def tables_data() -> list[dict[str, Any]]:
    """Return the tables of the thesis as data."""
    return [
        {
            "table": t.number,
            "varied": t.kind,
            "diagram": t.diagram,
            "speeds_rpm": list(t.speeds_rpm),
            "levels": list(PRINTED_LEVELS),
            "parameters": list(t.free),
            "reduction": t.reduction,
        }
        for t in TABLES.values()
    ]


def tables_text() -> str:
    """Return the tables of the thesis, one a line."""
    rows = [
        (t.number, t.kind, t.diagram, "{:g}:{:g}:{:g} rpm".format(*t.speeds_rpm), str(len(t.rows)), t.reduction)
        for t in TABLES.values()
    ]
    return table(("table", "varied", "diagram", "speeds", "parameters", "reduction"), rows)


def study_text(result: StudyResult) -> str:
    """Return the table of a study with what must be known to read it."""
    study = result.study
    columns = {
        "parameter": [row.parameter for row in result.rows],
        "true": [_value(row.true, row.unit) for row in result.rows],
        "case": [str(row.case) for row in result.rows],
        "mean error": [_per_cent(row.mean_percent) for row in result.rows],
        "rms error": [_per_cent(row.rms_percent) for row in result.rows],
        "rms error ": [_value(row.rms_error, row.unit) for row in result.rows],
        "thesis": [_per_cent(row.published) for row in result.rows],
        "coverage": [percent(row.coverage) for row in result.rows],
        "identified": [percent(row.identified) for row in result.rows],
    }
    columns = {name: cells for name, cells in columns.items() if any(cell != "-" for cell in cells)}
    lines = [list(line) for line in zip(*columns.values(), strict=True)]
    for before, line in zip(result.rows, lines[1:], strict=False):
        if before.parameter == line[0]:
            line[:2] = "", ""
    speeds = [abs(rpm(speed)) for speed in study.speeds]
    title = f"Table {study.table} of the thesis: " if study.table else ""
    title += f"{study.diagram.get('name')}, {len(speeds)} speeds, {min(speeds):g} to {max(speeds):g} rpm"
    title += f", {len(study.gains)} sets of gains" if len(study.gains) > 1 else ""
    title += f"; {study.method}" + (f", {study.reduction} reduction" if study.method == "regression" else "")
    return "\n\n".join([title, table([name.strip() for name in columns], lines), "\n".join(_notes(result))])


def _notes(result: StudyResult) -> list[str]:
    notes = [f"{result.study.seeds} seeds in every case; errors in % of the true value, angles too."]
    if any(row.coverage is not None for row in result.rows):
        share = 100 * result.coverage_tolerance
        notes.append(f"A right 90 % interval covers the true value in 90 +- {share:.2g} % of so many seeds.")
    if result.failed:
        notes.append(f"{len(result.failed)} estimates failed and are left out; the first: {result.failed[0]}")
    wrong = [
        f"  {symbol} at {100 * level:g} %: {printed:g} % is printed, its value says {error:.2f} %"
        for number, symbol, level, printed, error in misprints()
        if number == result.study.table
    ]
    return [*notes, *(["The thesis contradicts itself:", *wrong] if wrong else [])]


def smallest_text(study: Study, sizes: Sequence[Smallest]) -> str:
    """Return the smallest size of a parameter that is identified, for each level of noise."""
    rows = [
        (str(size.case), _value(size.expected, size.unit), _value(size.size, size.unit), percent(size.share))
        for size in sizes
    ]
    title = f"Smallest {sizes[0].parameter} of {study.diagram.get('name')} whose 90 % interval excludes zero"
    notes = [
        "expected: 2.93 standard deviations at size zero, by the information of the experiment; confirmed: where the",
        f"interval excluded zero in 90 % of {study.seeds} seeds, in steps of 10 %.",
    ]
    known = dict.fromkeys(other for size in sizes for other in size.left_out)
    notes += [f"Taken as known, for it has no effect at size zero: {', '.join(known)}."] if known else []
    return "\n\n".join([title, table(("noise", "expected", "confirmed", "in share of seeds"), rows), "\n".join(notes)])


def controllers_text(compared: Comparison) -> str:
    """Return the rms errors of every controller, and which were left out."""
    parts, results = [], list(compared.results.values())
    if results:
        first = results[0]
        rows = [
            (row.parameter, str(row.case), *(_rms(one.row(row.parameter, row.case)) for one in results))
            for row in first.rows
        ]
        title = f"rms errors of {first.study.diagram.get('name')}, {first.study.seeds} seeds; {first.study.method}"
        parts = [title, table(("parameter", "case", *compared.results), rows)]
    return "\n\n".join([*parts, *(f"left out: {name}: {why}" for name, why in compared.left_out.items())])


def _per_cent(value: float | None) -> str:
    return percent(None if value is None else value / 100)


def _rms(row: StudyRow) -> str:
    return _value(row.rms_error, row.unit) if row.rms_percent is None else _per_cent(row.rms_percent)


def _value(value: float, unit: str) -> str:
    shown, scale = parameter_unit(unit)
    return f"{value * scale:.4g} {shown}"
