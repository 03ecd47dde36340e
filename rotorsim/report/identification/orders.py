"""Bode plots of an identification: order vectors over the speed, measured beside simulated."""

from __future__ import annotations

from matplotlib.figure import Figure

from rotorsim.identification.in_orders import OrderIdentification
from rotorsim.identification.simulated_orders import OrdersBeside
from rotorsim.recordings.orders import OrderRecording
from rotorsim.report.figures.bode import Curve, bode_figure
from rotorsim.report.identification.parameters import heading


def order_figures(identification: OrderIdentification, recording: OrderRecording) -> dict[str, Figure | None]:
    """Return a Bode plot of every run and channel."""
    title = heading(identification, recording)
    made: dict[str, Figure | None] = {}
    for item in identification.runs:
        for k, (label, vectors) in enumerate(item.measured.items(), 1):
            use = "" if item.use == "identify" else ", held out"
            made[f"orders_{item.run.id}_{k}"] = bode_figure(
                Curve("measured", item.run.speed, vectors),
                [Curve("order-tracked simulation", item.run.speed, item.simulated[label])],
                f"{label}, run {item.run.id}{use}: {title}",
                identification.units[label],
                identification.noise[label],
            )
    return made


def beside_figure(found: OrdersBeside, title: str) -> Figure:
    """Return the Bode plot of a diagram as it is beside the first channel of a run."""
    label, vectors = next(iter(found.compared.measured.items()))
    speed = found.compared.run.speed
    simulated = Curve("order-tracked simulation", speed, found.compared.simulated[label])
    title = f"{label}, {title}"
    return bode_figure(Curve("measured", speed, vectors), [simulated], title, found.units[label], found.noise[label])
