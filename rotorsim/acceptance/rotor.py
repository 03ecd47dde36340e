"""The rotor by itself: undamped critical speeds over the stiffness of the supports, mode shapes, collocation."""

from __future__ import annotations

import numpy as np

from rotorsim.acceptance.conditions import Conditions
from rotorsim.acceptance.criterion import API_684, ISO_4, MET, NOT_MET, Criterion, Part, judged
from rotorsim.acceptance.limits import HIGHEST_MODE
from rotorsim.linear.modes.collocation import Collocation, collocation
from rotorsim.linear.modes.critical_speed_map import critical_speed_map
from rotorsim.model.compiled import Model

MAP_TITLE, SHAPES_TITLE = "Undamped critical speeds over the support stiffness", "Mode shapes, probes and magnets"
MAP, SHAPES = f"{API_684}, 2.4", f"{ISO_4}, 8.4"
MAP_SHARE = 20.0  # of the trip speed, up to which critical speeds are mapped
CROSSINGS_SHARE = 3.0  # of the trip speed, up to which those of the bearings are listed


def support_map(model: Model, given: Conditions) -> Part:
    """Return the critical speed map, and where the bearings' own stiffness meets it within the operating speeds."""
    return judged(MAP_TITLE, MAP, "critical speed map", lambda: _mapped(model, given), required=False)


def _mapped(model: Model, given: Conditions) -> Part:
    highest = MAP_SHARE * given.trip if np.isfinite(given.trip) else np.inf
    found = critical_speed_map(model, highest=highest)
    made = []
    for bearing, stiffness, speed in found.crossings:
        if speed > CROSSINGS_SHARE * given.trip:
            continue
        where = f"{bearing}, {stiffness:.4g} N/m at {speed * 30 / np.pi:.5g} rpm"
        inside = given.lowest <= speed <= given.highest
        nearest = min(max(speed, given.lowest), given.highest)
        share = 100 * abs(speed - nearest) / nearest
        if np.isfinite(share):
            verdict = NOT_MET if inside else MET
            said = "undamped: the response to unbalance counts"
            made.append(Criterion(MAP, "separation", where, share, unit="%", required=False, said=said, stated=verdict))
    return Part(MAP_TITLE, tuple(made), found.notes, (found,))


def mode_shapes(model: Model, given: Conditions) -> Part:
    """Return the bent modes of the free rotor, and in which of them a probe moves against its magnet."""
    return judged(SHAPES_TITLE, SHAPES, "probe times magnet", lambda: _shaped(model), required=False)


def _shaped(model: Model) -> Part:
    found = collocation(model, highest=HIGHEST_MODE)
    told = found.pairs or not found.shapes
    notes = () if told else ("no controller of two axes drives a bearing: collocation is not told",)
    return Part(SHAPES_TITLE, tuple(_criterion(one) for one in found.pairs), notes, (found,))


def _criterion(one: Collocation) -> Criterion:
    where = f"{one.controller} to {one.bearing}, mode {one.mode}, {one.frequency:.4g} Hz"
    said = f"{one.verdict}: probe {one.sensor:+.2f}, magnet {one.actuator:+.2f} of the largest"
    return Criterion(
        SHAPES,
        "probe times magnet",
        where,
        one.product,
        0.0,
        at_most=False,
        required=False,
        said=said,
        stated=NOT_MET if one.verdict == "opposite phase" else "",
    )
