"""What the source thesis prints about the sensitivity of its identification: Tables 2-5 to 2-7, 3-3 to 3-5, 4-2, 4-3,
5-3 to 5-5 (S. Singh, IIT Guwahati, 2015), with the speeds of Tables 2-4, 3-2, 5-2 and section 4.7.

Values and errors are as printed, also where they contradict each other: `misprints` finds these.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

PRINTED_LEVELS = (0.0, 0.01, 0.02, 0.05)  # of noise or of bias, the columns of every table


@dataclass(frozen=True)
class Row:
    """One parameter of a table: its true value, and per level the estimate [unit] and the error [%] printed."""

    symbol: str
    parameter: str
    unit: str
    true: float
    values: tuple[float, float, float, float]
    errors: tuple[float, float, float, float]


@dataclass(frozen=True)
class PublishedTable:
    """One table: what was varied ("noise" or "bias"), on which diagram, at which speeds, with which result.

    speeds_rpm: first, step, last. reduction: how what was not measured is eliminated in that chapter. groups:
    name -> parameters of the diagram that one draw of the bias multiplies.
    """

    number: str
    title: str
    kind: str
    diagram: str
    speeds_rpm: tuple[float, float, float]
    reduction: str
    groups: Mapping[str, tuple[str, ...]]
    rows: tuple[Row, ...]

    @property
    def speeds(self) -> tuple[float, ...]:
        """Speeds of the runs [rad/s]."""
        first, step, last = self.speeds_rpm
        return tuple(float(rpm) * np.pi / 30 for rpm in np.arange(first, last + step / 2, step))

    @property
    def free(self) -> tuple[str, ...]:
        """The parameters that are identified; the thesis takes the angle of the crack as known."""
        return tuple(row.parameter for row in self.rows)

    def error(self, parameter: str, level: float) -> float | None:
        """Return the error [%] printed for a parameter at a level, None where the table says nothing."""
        for row in self.rows:
            if row.parameter == parameter and level in PRINTED_LEVELS:
                return row.errors[PRINTED_LEVELS.index(level)]
        return None


LUMPED = {"mass": ("rotor.mass", "unbalance.mass"), "stiffness": ("rotor.stiffness",), "sag": ("crack.sag",)}
PRINTED_BEAM = {
    "mass": ("rotor.density", "rotor.disc_mass", "rotor.disc_diametral_inertia", "unbalance.mass"),
    "stiffness": ("rotor.young_modulus",),
    "sag": ("crack.sag",),
}
BEAM_TWO_DISCS = {**PRINTED_BEAM, "mass": (*PRINTED_BEAM["mass"][:-1], "unbalance1.mass", "unbalance2.mass")}

_C = ("c", "viscous_damping", "N s/m", 76.0)
_CRACK = ("Delta k_22", "crack_stiffness", "N/m", 3e5)
_E = ("e", "eccentricity", "um", 24.0)
_BETA = ("beta", "unbalance_phase", "deg", 30.0)
_KS = ("k_s", "force_displacement_factor", "N/m", 105210.0)
_KI = ("k_I", "force_current_factor", "N/A", 42.1)
_E1 = ("e_1", "eccentricity1", "um", 24.0)
_BETA1 = ("beta_1", "unbalance_phase1", "deg", 15.0)
_E2 = ("e_2", "eccentricity2", "um", 58.0)
_BETA2 = ("beta_2", "unbalance_phase2", "deg", 45.0)
_LX = ("k_L^x", "support_left.stiffness[1]", "MN/m", 495.82)
_LY = ("k_L^y", "support_left.stiffness[2]", "MN/m", 950.13)
_RX = ("k_R^x", "support_right.stiffness[1]", "MN/m", 355.82)
_RY = ("k_R^y", "support_right.stiffness[2]", "MN/m", 805.82)

_CHAPTER = {
    "2": ("jeffcott", "exact", LUMPED),
    "3": ("offset_disc", "central", LUMPED),
    "4": ("fe_rigid", "central", PRINTED_BEAM),
    "5": ("fe_flexible", "central", BEAM_TWO_DISCS),
}


def _table(number: str, kind: str, first: float, last: float, *rows: Any) -> PublishedTable:
    diagram, reduction, groups = _CHAPTER[number[0]]
    title = f"sensitivity to {'noise' if kind == 'noise' else 'errors of known parameters'}, {first:g}-{last:g} rpm"
    made = tuple(Row(name[0], name[1], name[2], name[3], values, errors) for name, values, errors in rows)
    return PublishedTable(number, title, kind, diagram, (first, 60.0, last), reduction, groups, made)


_ALL = (
    _table(
        "2-5",
        "noise",
        1140,
        1620,
        (_C, (75.3, 75.32, 74.72, 74.69), (-0.92, -0.88, -1.67, -1.71)),
        (_CRACK, (299490, 299190, 299770, 299010), (-0.16, -0.26, -0.8, -0.33)),
        (_E, (23.95, 23.92, 23.97, 24.27), (-0.21, -0.32, -0.14, 1.13)),
        (_BETA, (30.002, 30.007, 30.002, 30.001), (0.008, 0.023, 0.006, 0.002)),
        (_KS, (106410, 106510, 106520, 106960), (1.14, 1.24, 1.25, 1.66)),
        (_KI, (42.12, 42.12, 42.13, 42.11), (0.04, 0.04, 0.05, 0.03)),
    ),
    _table(
        "2-6",
        "noise",
        5520,
        6000,
        (_C, (75.86, 75.71, 75.57, 78.52), (-0.18, -0.37, -0.56, 3.31)),
        (_CRACK, (299820, 299930, 299050, 300210), (-0.06, -0.02, -0.32, 0.07)),
        (_E, (23.95, 23.96, 23.94, 24.14), (-0.28, -0.16, -0.24, 0.59)),
        (_BETA, (30.04, 30.04, 29.83, 30.06), (0.13, 0.13, -0.57, 0.2)),
        (_KS, (107490, 108470, 102660, 100960), (2.17, 3.09, -2.42, -4.03)),
        (_KI, (42.157, 42.253, 41.77, 41.9), (0.14, 0.36, -0.77, -0.45)),
    ),
    _table(
        "2-7",
        "bias",
        1140,
        1620,
        (_C, (75.3, 76.43, 76.92, 79.01), (-0.92, 0.56, 1.21, 3.96)),
        (_CRACK, (299490, 299820, 299180, 308120), (-0.16, -0.06, -0.27, 2.7)),
        (_E, (23.95, 23.96, 23.96, 23.96), (-0.21, -0.13, -0.13, -0.13)),
        (_BETA, (30.002, 30.002, 30.002, 30.002), (0.008, 0.008, 0.008, 0.008)),
        (_KS, (106410, 108020, 112780, 114720), (1.14, 2.67, 7.23, 9.51)),
        (_KI, (42.12, 42.14, 42.34, 44.07), (0.04, 0.09, 0.57, 4.68)),
    ),
    _table(
        "3-3",
        "noise",
        900,
        1380,
        (_C, (74.82, 70.69, 70.74, 71.27), (-1.55, -6.97, -6.92, -6.22)),
        (_CRACK, (304830, 306410, 307930, 312400), (1.61, 2.13, 2.64, 4.13)),
        (_E, (24.26, 24.38, 24.5, 24.86), (1.08, 1.6, 2.1, 3.59)),
        (_BETA, (30.05, 30.06, 30.06, 30.04), (0.17, 0.2, 0.2, 0.14)),
        (_KS, (98602, 98540, 98561, 98740), (-6.28, -6.34, -6.32, -6.15)),
        (_KI, (42.74, 42.75, 42.75, 42.73), (1.52, 1.54, 1.54, 1.5)),
    ),
    _table(
        "3-4",
        "noise",
        5580,
        6060,
        (_C, (73.14, 73.08, 73.63, 74.5), (-3.76, -3.84, -3.12, -1.96)),
        (_CRACK, (308880, 312560, 313660, 308950), (2.96, 4.18, 4.55, 2.98)),
        (_E, (24.52, 24.64, 24.77, 25.36), (2.18, 2.68, 3.21, 5.68)),
        (_BETA, (30.18, 30.18, 30.16, 28.9), (0.61, 0.6, 0.53, -3.66)),
        (_KS, (102370, 102420, 100850, 97130), (-2.7, -2.65, -4.14, -7.68)),
        (_KI, (43.2, 43.19, 43.43, 40.23), (2.61, 2.58, 3.17, -4.43)),
    ),
    _table(
        "3-5",
        "bias",
        900,
        1380,
        (_C, (74.82, 73.94, 77.01, 78.6), (-1.55, -2.7, 1.33, 3.42)),
        (_CRACK, (304830, 306330, 308100, 306930), (1.61, 2.11, 2.7, 2.31)),
        (_E, (24.26, 24.25, 24.39, 24.51), (1.08, 1.06, 1.66, 2.13)),
        (_BETA, (30.05, 30.05, 30.05, 30.11), (0.17, 0.17, 0.17, 0.37)),
        (_KS, (98602, 100660, 97267, 96877), (-6.28, -4.32, -7.55, -7.92)),
        (_KI, (42.74, 42.89, 43.09, 42.9), (1.52, 1.88, 2.36, 1.9)),
    ),
    _table(
        "4-2",
        "noise",
        900,
        1380,
        (_CRACK, (299880, 297900, 303990, 308400), (-0.04, -0.7, 1.33, 2.8)),
        (_E, (23.68, 23.67, 23.64, 23.92), (-1.32, -1.37, -1.5, -0.32)),
        (_BETA, (29.52, 29.52, 29.52, 29.18), (-1.58, -1.6, -1.6, -2.73)),
        (_KS, (106020, 107070, 104810, 111120), (0.77, 1.77, -0.38, 5.62)),
        (_KI, (42.12, 40.61, 42.75, 43.62), (0.058, 1.21, 1.55, 3.61)),
    ),
    _table(
        "4-3",
        "bias",
        900,
        1380,
        (_CRACK, (299880, 302400, 304050, 302160), (-0.04, 0.8, 1.35, 0.72)),
        (_E, (23.68, 23.61, 23.75, 23.72), (-1.32, -1.62, -1.03, -1.18)),
        (_BETA, (29.52, 29.63, 29.45, 29.61), (-1.58, -1.22, -1.84, -1.31)),
        (_KS, (106020, 105120, 108180, 109170), (0.77, -0.09, 2.82, 3.76)),
        (_KI, (42.12, 42.41, 42.69, 42.84), (0.058, 0.74, 1.42, 1.75)),
    ),
    _table(
        "5-3",
        "noise",
        1560,
        2040,
        (_CRACK, (299580, 300900, 302130, 307260), (-0.14, 0.3, 0.71, 2.42)),
        (_E1, (24.00, 23.91, 24.17, 24.28), (0.0, -0.36, 0.7, 1.19)),
        (_BETA1, (14.639, 15.02, 15.03, 15.16), (-0.1, 0.16, 0.25, 1.1)),
        (_E2, (57.97, 57.86, 58.15, 59.38), (-0.04, -0.23, 0.25, 2.38)),
        (_BETA2, (44.74, 43.96, 43.84, 43.99), (0.07, -0.29, -0.32, -0.28)),
        (_KS, (103350, 103460, 103210, 103770), (-1.77, -1.66, -1.9, -1.37)),
        (_KI, (41.83, 41.77, 42.56, 42.76), (-0.65, -0.79, 1.1, 1.58)),
        (_LX, (497.87, 497.15, 496.57, 496.51), (0.41, 0.27, 0.15, 0.13)),
        (_LY, (945.4, 946.52, 946.18, 948.92), (-0.49, -0.38, -0.41, -0.13)),
        (_RX, (357.52, 357.18, 357.35, 357.46), (0.47, 0.38, 0.43, 0.46)),
        (_RY, (801.18, 800.77, 800.22, 802.13), (-0.57, -0.63, -0.69, -0.46)),
    ),
    _table(
        "5-4",
        "noise",
        6240,
        6720,
        (_CRACK, (299650, 298600, 304560, 314310), (-0.12, -0.47, 1.52, 4.77)),
        (_E1, (23.88, 22.96, 24.5, 25.3), (-0.47, -4.38, 2.1, 5.42)),
        (_BETA1, (14.34, 14.34, 14.34, 14.26), (-4.35, -4.35, -4.38, -4.9)),
        (_E2, (57.01, 55.5, 55.25, 59.54), (-1.7, -4.3, -4.74, 2.66)),
        (_BETA2, (43.12, 42.78, 43.1, 42.88), (-4.18, -4.93, -4.22, -4.7)),
        (_KS, (106200, 102990, 109380, 111020), (0.94, -2.11, 3.96, 5.52)),
        (_KI, (41.83, 42.31, 43.28, 43.59), (-0.64, 0.49, 2.81, 3.55)),
        (_LX, (497.42, 495.86, 496.95, 500.39), (-0.32, 0.01, 0.23, 0.92)),
        (_LY, (949.32, 949.61, 943.0, 947.55), (-0.08, -0.05, -0.75, -0.27)),
        (_RX, (357.61, 355.82, 357.23, 360.92), (0.5, 0.0, 0.39, 1.43)),
        (_RY, (805.09, 805.47, 796.47, 803.03), (-0.09, -0.04, -1.16, -0.35)),
    ),
    _table(
        "5-5",
        "bias",
        1560,
        2040,
        (_CRACK, (299580, 299460, 299670, 299190), (-0.14, -0.18, -0.11, -0.27)),
        (_E1, (24.00, 24.00, 23.99, 24.17), (0.0, 0.03, -0.02, 0.7)),
        (_BETA1, (14.639, 14.64, 14.64, 14.65), (-0.1, -0.1, -0.1, -0.1)),
        (_E2, (57.97, 58.01, 57.97, 57.87), (-0.04, 0.02, -0.06, -0.22)),
        (_BETA2, (44.74, 44.72, 44.74, 44.78), (0.07, -0.07, -0.06, -0.06)),
        (_KS, (103350, 103340, 103350, 103380), (-1.77, -1.77, -1.76, -1.74)),
        (_KI, (41.83, 41.83, 41.83, 41.83), (-0.65, -0.64, -0.65, -0.65)),
        (_LX, (497.87, 497.87, 497.85, 497.77), (0.41, 0.41, 0.4, 0.39)),
        (_LY, (945.4, 945.41, 945.37, 945.15), (-0.49, -0.49, -0.5, -0.52)),
        (_RX, (357.52, 357.5, 357.53, 357.44), (0.47, 0.47, 0.48, 0.45)),
        (_RY, (801.18, 801.14, 801.22, 800.96), (-0.57, -0.58, -0.57, -0.6)),
    ),
)

TABLES: Mapping[str, PublishedTable] = {table.number: table for table in _ALL}


def misprints(tolerance: float = 0.1) -> list[tuple[str, str, float, float, float]]:
    """Return where the printed error is not that of the printed value: table, symbol, level, error printed, of value.

    tolerance: in percent of the true value.
    """
    found = []
    for table in _ALL:
        for row in table.rows:
            for level, value, printed in zip(PRINTED_LEVELS, row.values, row.errors, strict=True):
                error = 100 * (value / row.true - 1)
                if abs(error - printed) > tolerance:
                    found.append((table.number, row.symbol, level, printed, error))
    return found
