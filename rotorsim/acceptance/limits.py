"""Limits of API 617 and of ISO 14839 that are formulas."""

from __future__ import annotations

from math import pi, sqrt

LARGEST_VIBRATION = 25.4e-6  # m, peak to peak
VIBRATION_SPEED = 12000.0  # rpm, up to which the largest vibration is allowed
RESIDUAL = 6350e-6  # kg m of a kilogram at one rpm: 6350 g mm
HIGHEST_MODE = 2000.0  # Hz: of modes that are listed, as far as ISO 14839-3 looks
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
