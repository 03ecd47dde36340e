"""The figures of an acceptance, by what was found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from rotorsim.acceptance.acceptance import Acceptance
from rotorsim.acceptance.criterion import Part
from rotorsim.acceptance.displacement import Displacement
from rotorsim.acceptance.run_ups import PassedRunUp
from rotorsim.acceptance.stability_margins import MarginsAt
from rotorsim.acceptance.unbalance import UnbalanceCases
from rotorsim.linear.modes.campbell import Campbell
from rotorsim.linear.modes.collocation import FreeModes
from rotorsim.linear.modes.critical_speed_map import CriticalSpeedMap
from rotorsim.report.figures import acceptance as figures
from rotorsim.report.figures.linear import campbell_figure
from rotorsim.report.figures.margins import margins_figure, measured_margins_figure
from rotorsim.report.figures.orders import MOST_CHANNELS, Tracked, bode_plot
from rotorsim.report.page import Drawn
from rotorsim.report.text.table import rpm
from rotorsim.signals.injection.measured_margins import MeasuredMargins


@dataclass(frozen=True, eq=False)
class Shown:
    """What a figure belongs to."""

    result: Acceptance
    part: Part

    @property
    def title(self) -> str:
        """The part and the machine."""
        return f"{self.part.title}, {self.result.name}" if self.result.diagram is not None else self.part.title

    @property
    def operating(self) -> tuple[float, float] | None:
        """Operating speeds [rad/s], None where there are none."""
        given = self.result.conditions
        return (given.lowest, given.highest) if np.isfinite(given.highest) else None


@singledispatch
def figures_of(found: object, shown: Shown) -> Iterator[Drawn]:
    """Yield the figures of a result; none of one that has none."""
    return iter(())


@figures_of.register
def _(found: Displacement, shown: Shown) -> Iterator[Drawn]:
    every = [one for one in shown.part.results if isinstance(one, Displacement)]
    if found is every[0]:
        caption = "Largest distance of the shaft from the centre, of the least radial clearance, over the zones."
        yield Drawn("displacement", figures.displacement_figure(every, shown.title), caption)


@figures_of.register
def _(found: MarginsAt, shown: Shown) -> Iterator[Drawn]:
    every = [one for one in shown.part.results if isinstance(one, MarginsAt)]
    worst = max(every, key=lambda one: one.margins.peak if one.margins.stable else np.inf)
    if found is worst:
        at = "" if worst.speed is None else f" at {rpm(worst.speed):.5g} rpm"
        made = margins_figure(worst.margins, f"{shown.title}{at}")
        yield Drawn("margins", made, f"Sensitivity over the zones, and the open loop{at}, the worst of the speeds.")


@figures_of.register
def _(found: UnbalanceCases, shown: Shown) -> Iterator[Drawn]:
    caption = "Major axis of the orbit, peak to peak, with all of the unbalance U_a in one plane after the other."
    yield Drawn("unbalance", figures.unbalance_figure(found, shown.title), caption)


@figures_of.register
def _(found: Campbell, shown: Shown) -> Iterator[Drawn]:
    caption = "Damped natural frequencies over the speed, and the orders 1X and 2X."
    yield Drawn("campbell", campbell_figure(found, f"Campbell diagram, {shown.result.name}"), caption)


@figures_of.register
def _(found: CriticalSpeedMap, shown: Shown) -> Iterator[Drawn]:
    made = figures.critical_speed_map_figure(found, shown.title, operating=shown.operating)
    yield Drawn("map", made, "Undamped critical speeds of forward whirl, every bearing a spring of one stiffness.")


@figures_of.register
def _(found: FreeModes, shown: Shown) -> Iterator[Drawn]:
    if found.shapes and shown.result.diagram is not None:
        title = f"Bent modes of the rotor without its bearings, {shown.result.name}"
        made = figures.mode_shapes_figure(found, shown.result.diagram, title)
        yield Drawn("shapes", made, "Modes in one plane at rest; probe and magnet of each bearing.")


@figures_of.register
def _(found: MeasuredMargins, shown: Shown) -> Iterator[Drawn]:
    made = measured_margins_figure(found, f"{shown.part.title}, {', '.join(found.runs)}")
    yield Drawn(f"margins_{'_'.join(found.runs)}", made, "Sensitivity as measured, with 90 % intervals.")


@figures_of.register
def _(found: PassedRunUp, shown: Shown) -> Iterator[Drawn]:
    every = {name: one for name, one in found.channels.items() if one.order == found.found.order}
    unit = next(iter(every.values())).unit
    some = {name: one for name, one in every.items() if one.unit == unit}
    tracked = Tracked(found.run, dict(list(some.items())[:MOST_CHANNELS]), found.found, operating=shown.operating)
    made = bode_plot(tracked, f"{shown.part.title}, {found.run.id}")
    yield Drawn(f"orders_{found.run.id}", made, "1X over the speed, the fitted modes, and their settled response.")
