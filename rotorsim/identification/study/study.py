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
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.files import write_atomically
from rotorsim.identification.coordinates import ANGLE_UNIT
from rotorsim.identification.identification import METHODS
from rotorsim.identification.profile import Z90
from rotorsim.identification.regression import REDUCTIONS
from rotorsim.identification.study.printed import TABLES, PublishedTable
from rotorsim.identification.study.runs import Bench
from rotorsim.jobs.jobs import Failure, Jobs, run_jobs
from rotorsim.measure.record import KINDS
from rotorsim.model.load import load

__all__ = [
    "Case",
    "Study",
    "StudyResult",
    "StudyRow",
    "run_study",
    "study_data",
    "study_of_table",
    "study_rows",
    "write_rows",
]

CHUNK = 20  # estimates handed over at a time


@dataclass(frozen=True)
class Case:
    """What disturbs the data: a kind of noise with its level, and the level of the error of known parameters."""

    kind: str
    noise: float
    bias: float

    @property
    def disturbed(self) -> bool:
        """Whether seeds differ at all."""
        return self.noise > 0 or self.bias > 0

    def __str__(self) -> str:
        words = [f"{self.kind} {100 * self.noise:g} %"] if self.noise else []
        words += [f"bias {100 * self.bias:g} %"] if self.bias else []
        return ", ".join(words) or "clean"


@dataclass(frozen=True)
class Study:
    """A sensitivity study; all of it plain data.

    diagram: the JSON of the diagram that makes the data and identifies. speeds [rad/s] and gains (name -> SI value)
    give the runs, every gain set at every speed. free: parameters to estimate (default: all that the diagram leaves
    free). kinds, noise: of the noise, and its levels (0.05 is 5 %). groups, bias: known parameters that are wrong
    together, and the standard deviations of their relative errors. Every combination is a case with ``seeds`` draws.
    given: ports that the likelihood takes as measured. window [s] of a run from rest; settled: the settled motion.
    profile: intervals of the likelihood from its profile, not from its curvature. table: of the thesis, to compare.
    """

    diagram: Mapping[str, Any]
    speeds: tuple[float, ...]
    gains: tuple[Mapping[str, float], ...] = ({},)
    free: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ("white",)
    noise: tuple[float, ...] = (0.0,)
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    bias: tuple[float, ...] = (0.0,)
    seeds: int = 100
    method: str = "regression"
    reduction: str = "exact"
    given: tuple[str, ...] = ()
    window: tuple[float, float] = (4.0, 5.0)
    settled: bool = False
    profile: bool = True
    without: tuple[str, ...] = ()
    folder: str = "."
    trust_blocks: bool = False
    table: str = ""

    def __post_init__(self) -> None:
        """Raise RotorsimError with all that makes no sense."""
        problems = [
            Problem(f"no {word} '{value}'", hint=f"one of {', '.join(known)}")
            for word, values, known in (
                ("kind of noise", self.kinds, KINDS),
                ("method", (self.method,), METHODS),
                ("reduction", (self.reduction,), REDUCTIONS),
                ("table of the thesis", (self.table,) if self.table else (), tuple(TABLES)),
            )
            for value in values
            if value not in known
        ]
        for word, levels in (("noise", self.noise), ("bias", self.bias)):
            problems += [
                Problem(f"{level:g} is no level of {word}", hint="a share such as 0.05, for 5 %")
                for level in levels
                if not 0 <= level < 1
            ]
        if any(self.bias) and not self.groups:
            problems.append(
                Problem(
                    "nothing says which known parameters are wrong",
                    hint="for example --wrong rotor.mass,unbalance.mass",
                )
            )
        if not self.speeds or not all(abs(speed) > 0 for speed in self.speeds):
            problems.append(
                Problem("a study needs speeds that are not zero", hint='--speeds "1140 rpm:60 rpm:1620 rpm"')
            )
        if self.seeds < 1:
            problems.append(Problem(f"{self.seeds} seeds: at least one is needed"))
        if not 0 <= self.window[0] < self.window[1]:
            problems.append(Problem("the window must end after it begins, and begin at 0 s or later"))
        if problems:
            raise RotorsimError(*problems)

    @property
    def cases(self) -> list[Case]:
        """Every combination of noise and bias; without noise its kind does not matter."""
        noises = [(kind if level else "", level) for kind in self.kinds for level in self.noise]
        cases = [Case(kind, level, bias) for bias in self.bias for kind, level in noises]
        return list(dict.fromkeys(cases))

    @property
    def text(self) -> str:
        """All that decides the estimate of one seed, as JSON."""
        left_out = ("seeds", "noise", "bias", "kinds", "table")
        return json.dumps({k: v for k, v in vars(self).items() if k not in left_out}, default=str)

    def load(self) -> Diagram:
        """Return the diagram."""
        return load(self.diagram, without=self.without, trust_blocks=self.trust_blocks, folder=self.folder)

    def bench(self) -> Bench:
        """Return the undisturbed runs, kept for the next call."""
        return _bench(self.text)


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
    levels = (0.0, 0.01, 0.02, 0.05)
    varied: dict[str, Any] = {"noise": levels, "kinds": ("thesis", "uniform", "white")}
    if table.kind == "bias":
        varied = {"bias": levels, "groups": table.groups}
    fields = {
        "diagram": load(table.diagram).document,
        "speeds": table.speeds,
        "free": table.free,
        "reduction": table.reduction,
        "table": number,
        **varied,
    }
    return Study(**{**fields, **changes})


@lru_cache(maxsize=2)
def _bench(text: str) -> Bench:
    data = json.loads(text)
    diagram = load(data["diagram"], without=data["without"], trust_blocks=data["trust_blocks"], folder=data["folder"])
    names = ("gains", "free", "groups", "method", "reduction", "given", "window", "settled", "profile")
    return Bench(diagram, data["speeds"], **{name: data[name] for name in names})


def _job(text: str, argument: Sequence[Any]) -> dict[str, Any]:
    """Return the estimate of one case and seed."""
    kind, noise, bias, seed = argument
    return _bench(text).solve(kind, noise, bias, seed)


def run_study(
    study: Study,
    *,
    store: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> StudyResult:
    """Run a study and return its statistics; store, scheduler, workers, progress: as in `run_jobs` and `Jobs`.

    With a store, an interrupted study resumes, and one with more seeds runs only the new ones.
    Raises RotorsimError for what does not fit together, and when no seed of a case gives an estimate.
    """
    how = Jobs(workers, scheduler, progress)
    bench = study.bench()  # mistakes come before any worker starts
    jobs = [(case, seed) for seed in range(study.seeds) for case in study.cases if case.disturbed or seed == 0]
    found = run_jobs(
        partial(_job, study.text),
        [[case.kind, case.noise, case.bias, seed] for case, seed in jobs],
        store=store,
        key=hashlib.sha256(study.text.encode()).hexdigest(),
        jobs=how,
        chunk=CHUNK,
        on_error="return",
    )
    failed = [
        f"{case}, seed {seed}: {item.type}: {item.text}"
        for (case, seed), item in zip(jobs, found, strict=True)
        if isinstance(item, Failure)
    ]
    rows: list[StudyRow] = []
    estimates: dict[Case, np.ndarray] = {}
    intervals: dict[Case, np.ndarray | None] = {}
    for case in study.cases:
        items = [
            item for (of, _), item in zip(jobs, found, strict=True) if of == case and not isinstance(item, Failure)
        ]
        if not items:
            raise RotorsimError(Problem(f"no seed gives an estimate; {failed[0]}", str(case)), exit_code=1)
        estimates[case] = np.array([item["values"] for item in items])
        intervals[case] = np.array([item["intervals"] for item in items]) if "intervals" in items[0] else None
        called = np.array([item["identified"] for item in items]) if "identified" in items[0] else None
        rows += _rows(study, bench, case, estimates[case], intervals[case], called)
    rows.sort(key=lambda row: [item.name for item in bench.opened.experiment.free].index(row.parameter))
    return StudyResult(study, tuple(rows), estimates, intervals, tuple(failed))


def _rows(
    study: Study, bench: Bench, case: Case, values: np.ndarray, intervals: np.ndarray | None, called: np.ndarray | None
) -> list[StudyRow]:
    """Return the statistics of one case."""
    rows = []
    table: PublishedTable | None = TABLES.get(study.table)
    for j, item in enumerate(bench.opened.experiment.free):
        true = float(bench.true[j])
        error = values[:, j] - true
        if item.unit == ANGLE_UNIT:
            error = np.angle(np.exp(1j * error))
        covered = None
        if intervals is not None and case.disturbed:
            low, high = intervals[:, j].T
            covered = float(np.mean((low <= true) & (true <= high)))
        level = case.noise if table is not None and table.kind == "noise" else case.bias
        rows.append(
            StudyRow(
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
        )
    return rows


def study_data(found: StudyResult) -> dict[str, Any]:
    """Return the result of a study as plain data."""
    said = {name: value for name, value in vars(found.study).items() if name != "diagram"}
    name = found.study.diagram.get("name")
    return {"diagram": name, "study": said, "rows": study_rows(found), "failed": list(found.failed)}


def study_rows(found: StudyResult) -> list[dict[str, Any]]:
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
        for row in found.rows
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
