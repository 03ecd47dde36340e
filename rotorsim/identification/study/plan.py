"""What a sensitivity study varies: plain data."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import Problem, RotorsimError
from rotorsim.identification.harmonic.regression import REDUCTIONS
from rotorsim.identification.identification import ESTIMATORS
from rotorsim.identification.study.printed import TABLES
from rotorsim.measure.record import NOISE_KINDS
from rotorsim.model.load import load

NOT_OF_ONE_SEED = ("seeds", "noise", "bias", "kinds", "table")


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
        known = {
            "kind of noise": (self.kinds, NOISE_KINDS),
            "method": ((self.method,), ESTIMATORS),
            "reduction": ((self.reduction,), REDUCTIONS),
            "table of the thesis": ((self.table,) if self.table else (), tuple(TABLES)),
        }
        problems = [
            Problem(f"no {word} '{value}'", hint=f"one of {', '.join(choices)}")
            for word, (values, choices) in known.items()
            for value in values
            if value not in choices
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
        return json.dumps({k: v for k, v in vars(self).items() if k not in NOT_OF_ONE_SEED}, default=str)

    def load(self) -> Diagram:
        """Return the diagram."""
        return load(self.diagram, without=self.without, trust_blocks=self.trust_blocks, folder=self.folder)
