"""Sensitivity studies: how noise and wrong known parameters move the identified ones, over many seeds.

The undisturbed data are simulated with the diagram itself, noise is added to the samples, and the parameters are
estimated again and again: what is seen is the method and the experiment, not whether the diagram is right.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.criteria import Z90
from rotorsim.errors import Problem, RotorsimError
from rotorsim.files import write_atomically
from rotorsim.identification.harmonic.coordinates import ANGLE_UNIT
from rotorsim.identification.study.plan import Case, Study
from rotorsim.identification.study.printed import PRINTED_LEVELS, TABLES
from rotorsim.identification.study.runs import Bench, bench_of
from rotorsim.jobs.jobs import Failure, Jobs, run_jobs
from rotorsim.model.load import load

ESTIMATES_PER_TASK = 20  # estimates handed over at a time


@dataclass(frozen=True)
class StudyRow:
    """How well one parameter is found in one case.

    true, mean_error, rms_error: SI, of the diagram's unit; shares are relative to the true value, None where it is
    zero. coverage: share of seeds whose 90 % interval holds the true value; identified: share in which it is called
    so; None where the method gives no interval. published: error [%] that the thesis prints.
    """

    parameter: str
    unit: str
    true: float
    case: Case
    mean_error: float
    rms_error: float
    coverage: float | None
    identified: float | None
    published: float | None
    seeds: int

    @property
    def mean_percent(self) -> float | None:
        """Mean error in % of the true value."""
        return 100 * self.mean_error / self.true if self.true else None

    @property
    def rms_percent(self) -> float | None:
        """Root mean square error in % of the true value."""
        return 100 * self.rms_error / abs(self.true) if self.true else None


@dataclass(frozen=True, eq=False)
class StudyResult:
    """Rows for every parameter and case; estimates: case -> values (seeds, m), SI; failed: seeds without estimate."""

    study: Study
    rows: tuple[StudyRow, ...]
    estimates: Mapping[Case, np.ndarray]
    intervals: Mapping[Case, np.ndarray | None]
    failed: tuple[str, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(dict.fromkeys(row.parameter for row in self.rows))

    def row(self, parameter: str, case: Case) -> StudyRow:
        """Return the row of a parameter in a case."""
        return next(row for row in self.rows if row.parameter == parameter and row.case == case)

    @property
    def coverage_tolerance(self) -> float:
        """How far from 90 % the coverage may be by chance (90 % of the time)."""
        return Z90 * float(np.sqrt(0.09 / self.study.seeds))


def study_of_table(number: str, **changes: Any) -> Study:
    """Return the study of a table of the thesis: diagram, speeds, levels, reduction, parameters.

    changes: fields of the `Study` that are to differ. Raises RotorsimError for a table that is not one of those.
    """
    if number not in TABLES:
        raise RotorsimError(Problem(f"no table '{number}'", hint=f"one of {', '.join(TABLES)}"))
    table = TABLES[number]
    varied: dict[str, Any] = {"noise": PRINTED_LEVELS, "kinds": ("thesis", "uniform", "white")}
    if table.kind == "bias":
        varied = {"bias": PRINTED_LEVELS, "groups": table.groups}
    fields = {
        "diagram": load(table.diagram).document,
        "speeds": table.speeds,
        "free": table.free,
        "reduction": table.reduction,
        "table": number,
        **varied,
    }
    return Study(**{**fields, **changes})


def _job(text: str, argument: Sequence[Any]) -> dict[str, Any]:
    """Return the estimate of one case and seed."""
    kind, noise, bias, seed = argument
    return bench_of(text).solve(kind, noise, bias, seed)


def run_study(
    study: Study,
    *,
    store: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> StudyResult:
    """Run a study and return its statistics; store, scheduler, workers, progress: as in `run_jobs`.

    With a store, an interrupted study resumes, and one with more seeds runs only the new ones.
    Raises RotorsimError for what does not fit together, and when no seed of a case gives an estimate.
    """
    how = Jobs(workers, scheduler, progress)  # mistakes come before any worker starts
    bench = bench_of(study.text)
    jobs = [(case, seed) for seed in range(study.seeds) for case in study.cases if case.disturbed or seed == 0]
    results = run_jobs(
        partial(_job, study.text),
        [[case.kind, case.noise, case.bias, seed] for case, seed in jobs],
        store=store,
        key=hashlib.sha256(study.text.encode()).hexdigest(),
        jobs=how,
        chunk=ESTIMATES_PER_TASK,
        on_error="return",
    )
    of_case: dict[Case, list[dict[str, Any]]] = {case: [] for case in study.cases}
    failed = []
    for (case, seed), result in zip(jobs, results, strict=True):
        if isinstance(result, Failure):
            failed.append(f"{case}, seed {seed}: {result.type}: {result.text}")
        else:
            of_case[case].append(result)
    empty = next((case for case, items in of_case.items() if not items), None)
    if empty is not None:
        raise RotorsimError(Problem(f"no seed gives an estimate; {failed[0]}", str(empty)), exit_code=1)
    estimates = {case: np.array([item["values"] for item in items]) for case, items in of_case.items()}
    intervals = {case: _stacked(items, "intervals") for case, items in of_case.items()}
    called = {case: _stacked(items, "identified") for case, items in of_case.items()}
    rows = [
        _row(study, bench, j, case, estimates[case], intervals[case], called[case])
        for j in range(len(bench.opened.experiment.free))
        for case in study.cases
    ]
    return StudyResult(study, tuple(rows), estimates, intervals, tuple(failed))


def _stacked(items: Sequence[Mapping[str, Any]], key: str) -> np.ndarray | None:
    """Return what every estimate says under a key, (seeds, ...); None where the method does not say it."""
    return np.array([item[key] for item in items]) if key in items[0] else None


def _row(
    study: Study,
    bench: Bench,
    j: int,
    case: Case,
    values: np.ndarray,
    intervals: np.ndarray | None,
    called: np.ndarray | None,
) -> StudyRow:
    """Return the statistics of parameter j in one case."""
    item, true, table = bench.opened.experiment.free[j], float(bench.true[j]), TABLES.get(study.table)
    error = values[:, j] - true
    if item.unit == ANGLE_UNIT:
        error = np.angle(np.exp(1j * error))
    covered = None
    if intervals is not None and case.disturbed:
        covered = float(np.mean((intervals[:, j, 0] <= true) & (true <= intervals[:, j, 1])))
    level = case.noise if table is not None and table.kind == "noise" else case.bias
    return StudyRow(
        parameter=item.name,
        unit=item.unit,
        true=true,
        case=case,
        mean_error=float(error.mean()),
        rms_error=float(np.sqrt(np.mean(error**2))),
        coverage=covered,
        identified=None if called is None else float(called[:, j].mean()),
        published=None if table is None else table.error(item.name, level),
        seeds=len(values),
    )


def study_data(result: StudyResult) -> dict[str, Any]:
    """Return the result of a study as plain data."""
    said = {name: value for name, value in vars(result.study).items() if name != "diagram"}
    name = result.study.diagram.get("name")
    return {"diagram": name, "study": said, "rows": study_rows(result), "failed": list(result.failed)}


def study_rows(result: StudyResult) -> list[dict[str, Any]]:
    """Return the rows of a study as plain data, for a table."""
    return [
        {
            "parameter": row.parameter,
            "unit": row.unit,
            "true": row.true,
            "kind": row.case.kind,
            "noise": row.case.noise,
            "bias": row.case.bias,
            "mean_error": row.mean_error,
            "mean_error_percent": row.mean_percent,
            "rms_error": row.rms_error,
            "rms_error_percent": row.rms_percent,
            "thesis_error_percent": row.published,
            "coverage90": row.coverage,
            "identified": row.identified,
            "seeds": row.seeds,
        }
        for row in result.rows
    ]


def write_rows(rows: Sequence[Mapping[str, Any]], data: Any, file: str | Path) -> None:
    """Write rows as .csv, or all the data as .json."""
    file = Path(file)
    if file.suffix.lower() == ".json":
        write_atomically(file, json.dumps(data, indent=2, allow_nan=False) + "\n")
        return
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(file, text.getvalue())


def with_document(study: Study, document: Mapping[str, Any], **changes: Any) -> Study:
    """Return a study of another diagram, whose figures the thesis does not print."""
    return replace(study, diagram=document, table="", **changes)
