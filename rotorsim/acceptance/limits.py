"""Limits of API 617 and of ISO 14839 that are formulas."""

from __future__ import annotations

from math import pi, sqrt

LARGEST_VIBRATION = 25.4e-6  # m, peak to peak
VIBRATION_SPEED = 12000.0  # rpm, up to which the largest vibration is allowed
RESIDUAL = 6350e-6  # kg m of a kilogram at one rpm: 6350 g mm
HIGHEST_MODE = 2000.0  # Hz: of modes that are listed, as far as ISO 14839-3 looks
SCALE = (0.5, 6.0)  # within which the response at running clearances is scaled
ANALYSED = 2.0  # times the residual unbalance: that of an unbalance response analysis


def vibration_limit(highest: float) -> float:
    """Return A_vl = 25.4 um sqrt(12000 / N), at most 25.4 um, peak to peak [m], at a speed N [rad/s].

    Source: API RP 684 (2005), SP6.8.2.8; API 617 (8th ed., 2014), 4.8.2.8: N is the maximum continuous speed, rpm.
    """
    rpm = highest * 30 / pi
    return LARGEST_VIBRATION * min(sqrt(VIBRATION_SPEED / rpm), 1.0) if rpm > 0 else LARGEST_VIBRATION


def residual_unbalance(mass: float, highest: float) -> float:
    """Return U_r = 6350 W / N [g mm] in kg m, of a mass W [kg] at the maximum continuous speed N [rad/s].

    Source: API RP 684 (2005), SP6.8.2.7 and 5.2: 4 W / N [oz in] with W in pounds.
    """
    return RESIDUAL * mass / (highest * 30 / pi)


def clearance_scale(ratio: float) -> float:
    """Return S_cc = A_vl / A_max, at least 0.5 and at most 6: by how much the response at running clearances is scaled.

    Its unbalance is then that which brings the vibration at the probes to its limit. Source: API RP 684 (2005),
    SP6.8.2.11; API 617 (8th ed., 2014), 4.8.2.11; bounds as ROSS has them of these (petrobras/ross, api_report.py).
    """
    return min(max(ratio, SCALE[0]), SCALE[1])
