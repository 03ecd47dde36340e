"""``--vary NAME=VALUES``: grids and random draws of parameters, and the runs that they make."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rotorsim.cli.shared.refusals import refuse_all, refuse_if
from rotorsim.errors import Problem, RotorsimError

if TYPE_CHECKING:
    import numpy as np

    from rotorsim.diagram.diagram import Diagram

MOST_SWEPT = 1_000_000
DISTRIBUTION = re.compile(r"(normal|uniform)\((.*)\)", re.IGNORECASE)
FORMS = (
    "--vary 'speed=600 rpm:10 rpm:6000 rpm' (start:step:stop), 'controller.KP=1e4, 2e4', "
    "'unbalance.mass=normal(0.1 kg, 5 %)' or 'amb.gap=uniform(0.4 mm, 0.6 mm)'"
)


@dataclass(frozen=True, eq=False)
class Variation:
    """Values of one parameter [SI]: a grid, or draws of its distribution."""

    name: str
    values: np.ndarray
    drawn: bool


@dataclass(frozen=True, eq=False)
class Varied:
    """Values of every varied parameter in every run [SI], name -> (n,); which lie on a grid, and which are drawn."""

    runs: dict[str, np.ndarray]
    grid: tuple[str, ...]
    drawn: tuple[str, ...]


def variations(texts: Sequence[str], diagram: Diagram, draws: int | None, seed: int) -> Varied:
    """Return the runs that variations make.

    Every combination of the grids, the first of them slowest; with distributions each is repeated with the same draws.
    Raises RotorsimError with all that is wrong.
    """
    import numpy as np

    from rotorsim.simulation.ensemble.setup import changes_structure

    found: list[Variation] = []
    problems: list[Problem] = []
    generator = np.random.default_rng(seed)
    count = 100 if draws is None else draws
    refuse_if(count > MOST_SWEPT, f"--draws {count}: at most {MOST_SWEPT}", hint="fewer draws")
    for text in texts:
        name, equals, values = (part.strip() for part in text.partition("="))
        if not equals or not name or not values:
            problems.append(Problem(f"--vary {text}: not NAME=VALUES", hint=FORMS))
            continue
        if name in (one.name for one in found):
            problems.append(Problem(f"--vary {text}: '{name}' is varied twice", hint="give all its values at once"))
            continue
        structural = changes_structure(diagram, name)
        if structural is not None:
            problems.append(structural)
            continue
        try:
            found.append(_variation(name, values, text, diagram.unit_of_parameter(name), count, generator))
        except RotorsimError as error:
            problems += error.problems
    refuse_all(problems)
    drawn = any(one.drawn for one in found)
    refuse_if(draws is not None and not drawn, "--draws needs a distribution", hint=FORMS)
    grids = [one.values for one in found if not one.drawn]
    n = int(np.prod([len(values) for values in grids], dtype=float)) * (count if drawn else 1)
    refuse_if(n > MOST_SWEPT, f"{n} runs; at most {MOST_SWEPT}", hint="larger steps")
    axes = iter(np.meshgrid(*grids, np.arange(count if drawn else 1), indexing="ij")) if found else iter(())
    by_grid = {one.name: next(axes).ravel() for one in found if not one.drawn}
    number = next(axes).ravel() if found else np.zeros(1, int)
    return Varied(
        {one.name: one.values[number] if one.drawn else by_grid[one.name] for one in found},
        tuple(one.name for one in found if not one.drawn and len(one.values) > 1),
        tuple(one.name for one in found if one.drawn),
    )


def _variation(
    name: str, values: str, text: str, unit: str | None, count: int, generator: np.random.Generator
) -> Variation:
    import numpy as np

    def number(part: str) -> float:
        from rotorsim.units import UnitError, parse_quantity

        try:
            return float(parse_quantity(part.strip(), unit, bare=True))
        except UnitError as error:
            raise RotorsimError(Problem(f"--vary {text}: {error.what}", hint=error.hint)) from None

    law = DISTRIBUTION.fullmatch(values)
    if law:
        given = [part.strip() for part in law[2].split(",")]
        refuse_if(len(given) != 2, f"--vary {text}: {law[1]} takes two numbers, {len(given)} given", hint=FORMS)
        first = number(given[0])
        if law[1].lower() == "normal":
            share = re.fullmatch(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*%", given[1])
            std = abs(first) * float(share[1]) / 100 if share else number(given[1])
            refuse_if(not std > 0, f"--vary {text}: the standard deviation must be positive", hint=FORMS)
            return Variation(name, first + std * generator.standard_normal(count), True)
        last = number(given[1])
        refuse_if(not last > first, f"--vary {text}: the second number must be larger than the first", hint=FORMS)
        return Variation(name, generator.uniform(first, last, count), True)
    parts = values.split(":")
    if len(parts) == 1:
        return Variation(name, np.array([number(part) for part in values.split(",")]), False)
    refuse_if(len(parts) != 3, f"--vary {text}: {len(parts)} parts, 3 expected", hint=FORMS)
    start, step, stop = map(number, parts)
    steps = (stop - start) / step if step else np.nan
    hint = f"the step leads from {parts[0].strip()} to {parts[2].strip()}: it is not zero and has the sign of the way"
    refuse_if(not (np.isfinite(steps) and steps >= 0), f"--vary {text}: no step leads there", hint=hint)
    refuse_if(steps >= MOST_SWEPT, f"--vary {text}: more than {MOST_SWEPT} values", hint="a larger step")
    return Variation(name, start + step * np.arange(int(steps + 1e-9) + 1), False)


def window_of_run(text: str, unit: str) -> tuple[float, float]:
    """Return the ends of ``"4 s:5 s"``, or of ``"100:200"`` in turns."""
    from rotorsim.cli.shared.inputs import quantity, window_of

    if unit == "s":
        return window_of(text)
    ends = [quantity(re.sub(r"\s*turns?$", "", part.strip()), "1", "--window") for part in text.split(":")]
    hint = "with --turns the window is in turns: --window 100:200"
    refuse_if(len(ends) != 2 or ends[1] <= ends[0], f"--window {text}: not START:STOP", hint=hint)
    return ends[0], ends[1]
