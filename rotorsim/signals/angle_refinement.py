"""Refine the shaft angle between pulses by the harmonics themselves: they turn with the shaft.

Sampled or jittering pulses leave the speed open by a fraction of a period over the run, and a speed that is stated in
whole rpm by more. The residual of strong harmonics then has power near every one of them.
"""

from __future__ import annotations

from dataclasses import replace
from math import tau

import numpy as np

from rotorsim.signals.harmonic_basis import Basis, harmonic_basis
from rotorsim.signals.shaft_angle import MOST_TURNED, ShaftAngle

ANGLE_CHANGE = 0.1  # standard deviations that the angle may still change by
PLAUSIBLE = 4.0  # standard deviations of the pulses (once in 16 000 runs): what the harmonics ask for beyond is not the
# angle's doing


def refined_angle(time: np.ndarray, angle: ShaftAngle, y: np.ndarray, basis: Basis) -> tuple[ShaftAngle, Basis]:
    """Return the angle with the smooth error taken out that the harmonics of signals y (n, C) show, and its basis.

    theta + d_1 P_1(u) + d_2 P_2(u), u from -1 to 1 over the run: a speed and a drift of it; d_1, d_2 are by maximum
    posterior, with `ShaftAngle.smooth` of the pulses as prior, and channels weighted by their residuals.
    basis: of `angle`. Where the harmonics contradict the pulses, both are as they were, and the angle says so.
    """
    if not angle.smooth > 0:
        return angle, basis
    u = 2 * (time - time[0]) / (time[-1] - time[0]) - 1
    shapes = np.column_stack([u, 1.5 * u**2 - 0.5])
    if angle.pulses:  # angle zero stays where they are on average
        at = np.interp(tau * np.arange(angle.pulses), np.sign(angle.speed) * angle.theta, u)
        shapes -= [at.mean(), np.mean(1.5 * at**2 - 0.5)]
    total, now, columns = np.zeros(2), angle, basis
    for _ in range(6):
        coefficients, residual = columns.solve(y)
        noise = np.sqrt(np.mean(residual**2, axis=0))
        told = noise > 0
        by_angle = columns.columns @ _by_angle(coefficients, columns.orders)
        jacobian = (by_angle[:, None, told] * shapes[:, :, None] / noise[told]).reshape(len(y), -1)
        jacobian = columns.solve(jacobian)[1].reshape(len(y), 2, -1)
        information = np.einsum("nic,njc->ij", jacobian, jacobian)
        gradient = np.einsum("nic,nc->i", jacobian, residual[:, told] / noise[told])
        if now is angle and _contradicts(information, gradient, angle.smooth):
            return replace(angle, contradicted=True), basis
        information = information + np.eye(2) / angle.smooth**2
        step = np.linalg.solve(information, gradient - total / angle.smooth**2)
        if step @ information @ step < 2 * ANGLE_CHANGE**2:
            break
        total = total + step
        if np.abs(total).max() > PLAUSIBLE * angle.smooth:
            return replace(angle, contradicted=True), basis
        theta = angle.theta + shapes @ total
        change = np.gradient(shapes @ total, time)
        speed, drift = (theta[-1] - theta[0]) / (time[-1] - time[0]), angle.drift + change[-1] - change[0]
        now = replace(angle, theta=theta, speed=float(speed), drift=float(drift))
        columns = harmonic_basis(basis.run, time, theta, orders=basis.orders)
    return now, columns


def _contradicts(information: np.ndarray, gradient: np.ndarray, smooth: float) -> bool:
    """Return whether harmonics alone ask for more than is followed, and than pulses and noise leave open."""
    covariance = np.linalg.pinv(information, hermitian=True)
    open_by = PLAUSIBLE * np.hypot(smooth, np.sqrt(np.diag(covariance)))
    return bool((np.abs(covariance @ gradient) > np.maximum(open_by, MOST_TURNED)).any())


def _by_angle(coefficients: np.ndarray, K: int) -> np.ndarray:
    """Return the coefficients (m, C) of d/dtheta: i k c_k; columns as in `harmonic_basis`, drift left out."""
    out = np.zeros_like(coefficients)
    k = np.arange(1, K + 1)[:, None]
    out[1 : 2 * K : 2], out[2 : 2 * K + 1 : 2] = -k * coefficients[2 : 2 * K + 1 : 2], k * coefficients[1 : 2 * K : 2]
    return out
