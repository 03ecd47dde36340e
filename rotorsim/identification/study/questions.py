"""Two questions of section 6.4 of the thesis: the smallest crack that is found, and the controller that shows most."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

from rotorsim.criteria import Z90
from rotorsim.diagram.diagram import Diagram
from rotorsim.diagram.edit import fitting_types, swap
from rotorsim.diagram.resolve.registry import Registry
from rotorsim.errors import Problem, RotorsimError, near_miss
from rotorsim.identification.files import with_values
from rotorsim.identification.study.plan import Case, Study
from rotorsim.identification.study.runs import bench_of
from rotorsim.identification.study.study import StudyResult, run_study, study_rows, with_document
from rotorsim.linear.control.design import design_state_feedback
from rotorsim.model.load import load

POWER = 0.9  # share of seeds in which the interval is to exclude zero
STEP, STEPS = 1.1, 8  # of the search upwards
TOUCH_DOWN = 1e-3  # m; a rotor that moves further does not levitate
DESIGNED, BARE = "state_feedback", "state_space"

Progress = Callable[[float], None] | None


@dataclass(frozen=True)
class Smallest:
    """The smallest size of one parameter that is seen in one case.

    std: of its estimate where it is zero, by the expected information. expected: size that follows from it.
    size: that was confirmed; share: of seeds in which the interval there excludes zero. Sizes in SI.
    """

    case: Case
    parameter: str
    unit: str
    std: float
    expected: float
    size: float
    share: float
    seeds: int
    left_out: tuple[str, ...] = ()


def smallest_size(
    study: Study, parameter: str = "crack_stiffness", progress: Progress = None, **jobs: Any
) -> list[Smallest]:
    """Return for every noisy case the smallest size of a parameter whose 90 % interval excludes zero.

    Expected: (z_0.95 + z_0.9) standard deviations of the maximum-likelihood estimate at size zero. Confirmed by
    drawing noise: from there in steps of ten per cent to the first size at which the interval excludes zero in 90 %
    of the seeds. Parameters without effect at size zero (the angle of a crack that is not there) are taken as known.
    jobs: scheduler, workers of `run_jobs`.
    """
    diagram = study.load()
    known = {item.name: item for item in diagram.free}
    if parameter not in known:
        hint = near_miss(parameter, known) or f"they are {', '.join(known)}"
        raise RotorsimError(Problem(f"'{parameter}' is not among the parameters to identify", diagram.name, hint=hint))
    names = study.free or tuple(known)
    names = names if parameter in names else (*names, parameter)
    cases = [case for case in study.cases if case.noise and not case.bias]
    if not cases:
        raise RotorsimError(Problem("without noise every size is seen", hint='--noise "1, 2, 5"'))

    def sized(size: float, free: Sequence[str], **changes: Any) -> Study:
        alone = with_values(diagram, [(known[parameter], size)])
        here = {
            "without": (),
            "gains": tuple({alone.named(name): value for name, value in gains.items()} for gains in study.gains),
            "free": tuple(map(alone.named, free)),
        }
        return with_document(study, alone.document, method="likelihood", groups={}, bias=(0.0,), **here, **changes)

    absent = bench_of(sized(0.0, names).text)
    found = []
    for number, case in enumerate(cases):
        std = absent.expected_std(case.kind, case.noise)
        kept = tuple(name for name, value in zip(names, std, strict=True) if np.isfinite(value))
        own = float(std[names.index(parameter)])
        expected = (Z90 + float(norm.ppf(POWER))) * own
        size, share = expected, 0.0
        for step in range(STEPS):
            size = expected * STEP**step
            trial = sized(size, kept, kinds=(case.kind,), noise=(case.noise,))

            def show(part: float, done: float = number + step / STEPS) -> None:
                if progress:
                    progress((done + part / STEPS) / len(cases))

            result = run_study(trial, progress=show, **jobs)
            intervals = result.intervals[trial.cases[0]]
            assert intervals is not None
            share = float(np.mean(intervals[:, kept.index(parameter), 0] > 0))
            if share >= POWER:
                break
        left_out = tuple(name for name in names if name not in kept)
        found.append(
            Smallest(case, parameter, known[parameter].unit, own, expected, size, share, study.seeds, left_out)
        )
    return found


def smallest_rows(sizes: Sequence[Smallest]) -> list[dict[str, Any]]:
    """Return smallest sizes as plain data, for a table."""
    return [
        {
            "parameter": size.parameter,
            "unit": size.unit,
            "kind": size.case.kind,
            "noise": size.case.noise,
            "std_at_zero": size.std,
            "expected": size.expected,
            "size": size.size,
            "share": size.share,
            "seeds": size.seeds,
            "taken_as_known": " ".join(size.left_out),
        }
        for size in sizes
    ]


@dataclass(frozen=True, eq=False)
class Comparison:
    """The same study with each controller; left_out: controller -> why."""

    results: Mapping[str, StudyResult]
    left_out: Mapping[str, str]


def compare_controllers(study: Study, progress: Progress = None, **jobs: Any) -> Comparison:
    """Return the study with each controller of the library in the place of the diagram's own.

    Left out by name: controllers that do not levitate the rotor at all speeds, those that need matrices of their
    own, and sampled ones (a current that is held between samples, recorded at the samples, is half a sample late).
    """
    diagram = study.load()
    block = next((name for name, node in diagram.nodes.items() if "controller" in node.block.roles), None)
    if block is None:
        raise RotorsimError(Problem("no controller to compare", diagram.name))
    types = [kind for kind in fitting_types(diagram.document, block) if _is_controller(kind)]
    results: dict[str, StudyResult] = {}
    left_out: dict[str, str] = {}
    for number, kind in enumerate(types):

        def show(part: float, done: int = number) -> None:
            if progress:
                progress((done + part) / len(types))

        try:
            changed = _swapped(study, diagram, block, kind)
            _refuse_fall(changed)
            results[kind] = run_study(changed, progress=show, **jobs)
        except RotorsimError as error:
            left_out[kind] = error.problems[0].what
    return Comparison(results, left_out)


def comparison_rows(compared: Comparison) -> list[dict[str, Any]]:
    """Return the rows of all controllers as plain data, for a table."""
    return [{"controller": name, **row} for name, found in compared.results.items() for row in study_rows(found)]


def _is_controller(kind: str) -> bool:
    found = Registry().find(kind)
    return found is not None and "controller" in found.roles


def _swapped(study: Study, diagram: Diagram, block: str, kind: str) -> Study:
    """Return the study with another controller, without the gains that it does not have."""
    own = diagram.nodes[block].block.type_name
    parameters: dict[str, Any] = {}
    if kind == BARE and own != BARE:
        raise RotorsimError(Problem(f"has no matrices of its own; with those of {DESIGNED} it is that controller"))
    if kind == DESIGNED and own != DESIGNED:
        designed = design_state_feedback(diagram, block)
        parameters = {name: matrix.tolist() for name, matrix in designed.items()}
    document = diagram.document if kind == own else swap(diagram.document, block, kind, parameters)
    changed = load(document, without=study.without, folder=study.folder)
    if changed.nodes[block].block.sample_time:
        raise RotorsimError(Problem("is sampled: its held current, recorded at the samples, is half a sample late"))
    known = {f"{block}.{name}" for name in changed.nodes[block].values}
    kept = [
        {name: value for name, value in gains.items() if name.rpartition(".")[0] != block or name in known}
        for gains in study.gains
    ]
    unique = tuple(dict(pairs) for pairs in dict.fromkeys(tuple(gains.items()) for gains in kept))
    return with_document(study, document, gains=unique)


def _refuse_fall(study: Study) -> None:
    """Raise RotorsimError where a controller does not levitate the rotor."""
    bench = bench_of(study.text)
    places = [k for k, unit in enumerate(bench.units.values()) if unit == "m"]
    largest = max(float(np.abs(item.values[:, places]).max(initial=0.0)) for item in bench.clean)
    if not largest < TOUCH_DOWN:
        raise RotorsimError(Problem(f"does not levitate: the rotor moves {largest * 1e3:.3g} mm"))
