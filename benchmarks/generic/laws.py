"""The laws of effects.c: names, synonyms, numbers, and how large they are drawn beside the signals they act on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import log, pi

import numpy as np

Random = np.random.Generator
ORDER = (  # as in effects.c
    *("saturation", "dead_zone", "play", "friction", "cubic", "quadratic", "asymmetry", "stop", "delay", "rate_limit"),
    *("lag", "mode", "leak", "offset", "drift", "jump", "line", "series", "cross_talk", "gain_drift", "gain_schedule"),
    *("quantisation", "bouc_wen", "fractional", "prandtl", "self_heating", "ripple"),
)


@dataclass(frozen=True)
class Scale:
    """What sizes are measured by: peak and rms of the signal v (about its mean: spread) and of the argument o."""

    peak: float
    rms: float
    spread: float
    other_peak: float
    other_rms: float
    pace: float  # s, of the plant
    duration: float  # s, of a run


@dataclass(frozen=True)
class Law:
    """A law: its name, fair synonyms, where equivalent places lie, its numbers, and its sizes.

    moves: how it passes blocks unchanged but for its numbers: "static" gains, "linear" also linear dynamics, "added"
    gains and sums. size: numbers at a strength, with a scale, of random draws of what is not the strength.
    """

    key: str
    physics: str
    also: tuple[str, ...]
    moves: str
    numbers: tuple[str, ...]
    strengths: tuple[float, float]
    size: Callable[[float, Scale, Random], tuple[float, ...]]
    states: int = 0
    fixed: tuple[str, ...] = ()  # numbers that a fit leaves
    outside: bool = False
    unpredictable: bool = False  # another course in every run
    equation: str = ""


def _sign(rng: Random) -> float:
    return float(rng.choice([-1.0, 1.0]))


def log_uniform(rng: Random, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(log(low), log(high))))


def _bent(s: float) -> float:
    """Return a cubic coefficient that leaves the law rising where |v| <= 1."""
    return s if s > 0.0 else s / (1.0 - 3.2 * s)


_STATIC = ("static_nonlinearity", "nonlinear_gain")
_LIMIT = ("saturation", "limit", "voltage_limit", "force_limit", "power_limit", "current_clipping", "clipping")

LAWS = {
    law.key: law
    for law in (
        Law(
            "saturation", "actuator_saturation", _LIMIT, "static", ("level",), (0.02, 0.7),
            lambda s, a, rng: ((1.0 - s) * a.peak,),
            equation="w = min(max(v, -level), level)",
        ),
        Law(
            "dead_zone", "dead_zone", ("dead_band", "overlap", "valve_overlap", "threshold", "clearance"), "static",
            ("half_width",), (0.003, 0.8), lambda s, a, rng: (s * a.rms,),
            equation="w = v - min(max(v, -half_width), half_width)",
        ),
        Law(
            "play", "backlash", ("play", "gear_backlash", "lost_motion", "hysteresis"), "static",
            ("half_width",), (0.002, 0.8), lambda s, a, rng: (s * a.spread,),
            equation="w = min(max(w, v - half_width), v + half_width)",
        ),
        Law(
            "friction", "coulomb_friction", ("dry_friction", "friction", "static_friction"), "added",
            ("force", "width"), (0.003, 0.6),
            lambda s, a, rng: (s * a.rms, rng.uniform(0.01, 0.04) * a.other_rms),
            fixed=("width",), equation="w = v - force tanh(o / width), o: the speed",
        ),
        Law(
            "cubic", "cubic_nonlinearity", (*_STATIC, "cubic_stiffness", "duffing", "soft_saturation"), "static",
            ("coefficient",), (0.005, 3.0), lambda s, a, rng: (_bent(_sign(rng) * s) / a.peak**2,),
            equation="w = v + coefficient v^3",
        ),
        Law(
            "quadratic", "quadratic_nonlinearity", (*_STATIC, "asymmetry"), "static",
            ("coefficient",), (0.003, 0.4), lambda s, a, rng: (_sign(rng) * s / a.peak,),
            equation="w = v + coefficient v^2",
        ),
        Law(
            "asymmetry", "asymmetric_gain", (*_STATIC, "asymmetry", "direction_dependent_gain"), "static",
            ("difference",), (0.003, 0.5), lambda s, a, rng: (_sign(rng) * s,),
            equation="w = v + difference |v|",
        ),
        Law(
            "stop", "one_sided_stop", ("end_stop", "stop", "contact", "clearance", "rub", "one_sided_contact"), "added",
            ("gap", "stiffness"), (0.02, 20.0),
            lambda s, a, rng: (rng.uniform(0.3, 0.8) * a.other_peak, s * a.rms / a.other_rms),
            equation="w = v - stiffness max(o - gap, 0), o: the position",
        ),
        Law(
            "delay", "transport_delay", ("delay", "dead_time", "control_delay", "time_delay"), "linear",
            ("delay",), (0.003, 0.6), lambda s, a, rng: (s * a.pace,),
            equation="w(t) = v(t - delay)",
        ),
        Law(
            "rate_limit", "rate_limit", ("rate_limiter", "slew_rate_limit", "rate_saturation", "slew_limit"), "static",
            ("rate",), (0.03, 3.0), lambda s, a, rng: (a.spread / (a.pace * s),),
            equation="|dw/dt| <= rate, else w = v",
        ),
        Law(
            "lag", "first_order_lag", ("lag", "sensor_lag", "actuator_lag", "amplifier_bandwidth", "low_pass"),
            "linear", ("time_constant",), (0.003, 1.0), lambda s, a, rng: (s * a.pace,), states=1,
            equation="time_constant w' = v - w",
        ),
        Law(
            "mode", "missing_mode",
            ("second_order_lag", "resonance", "flexible_mode", "actuator_dynamics", "sensor_dynamics"),
            "linear", ("frequency", "damping"), (0.003, 0.6),
            lambda s, a, rng: (1.0 / (s * a.pace), rng.uniform(0.1, 0.6)), states=2,
            equation="w'' + 2 damping frequency w' + frequency^2 w = frequency^2 v",
        ),
        Law(
            "leak", "integrator_leak", ("leak", "leakage", "integral_leakage"), "added",
            ("rate",), (0.002, 1.0), lambda s, a, rng: (s * a.rms / a.other_rms,),
            equation="w = v - rate o, o: the integral of w",
        ),
        Law(
            "offset", "sensor_offset", ("offset", "bias", "sensor_bias"), "added", ("offset",), (0.003, 1.0),
            lambda s, a, rng: (_sign(rng) * s * a.spread,), equation="w = v + offset",
        ),
        Law(
            "drift", "sensor_drift", ("sensor_offset_drift", "offset_drift", "drift", "bias_drift"), "added",
            ("rate",), (0.005, 1.0), lambda s, a, rng: (_sign(rng) * s * a.spread / a.duration,),
            equation="w = v + rate t",
        ),
        Law(
            "jump", "sensor_step", ("offset_step", "sensor_jump", "offset_jump", "step_disturbance"), "added",
            ("step", "time"), (0.003, 1.0),
            lambda s, a, rng: (_sign(rng) * s * a.spread, rng.uniform(0.2, 0.8) * a.duration),
            fixed=("time",), equation="w = v + step where t >= time (of every run)",
        ),
        Law(
            "line", "periodic_disturbance",
            ("disturbance_line", "sinusoidal_disturbance", "disturbance", "harmonic_disturbance", "hum"),
            "added_dynamic", ("amplitude", "frequency", "phase"), (0.003, 1.0),
            lambda s, a, rng: (s * a.spread, log_uniform(rng, 0.2, 3.0) / a.pace, rng.uniform(-pi, pi)),
            equation="w = v + amplitude sin(frequency t + phase), the same in every run",
        ),
        Law(
            "series", "unmeasured_disturbance",
            ("coloured_disturbance", "disturbance", "unknown_input", "unknown_force", "random_disturbance"),
            "added_dynamic", ("size",), (0.003, 1.0), lambda s, a, rng: (s * a.spread,), unpredictable=True,
            equation="w = v + size n(t), n: low-pass noise of unit rms, another in every run",
        ),
        Law(
            "cross_talk", "cross_talk", ("crosstalk", "cross_coupling", "coupling"), "added",
            ("share",), (0.003, 1.5), lambda s, a, rng: (_sign(rng) * s * a.spread / a.other_rms,),
            equation="w = v + share o",
        ),
        Law(
            "gain_drift", "gain_drift", ("drifting_gain", "time_varying_gain", "parameter_drift"), "static",
            ("rate",), (0.005, 0.6), lambda s, a, rng: (_sign(rng) * s / a.duration,),
            equation="w = v (1 + rate t)",
        ),
        Law(
            "gain_schedule", "signal_dependent_gain",
            ("varying_gain", "scheduled_gain", "multiplicative_coupling", "nonlinear_gain"), "static",
            ("coefficient",), (0.005, 0.6), lambda s, a, rng: (_sign(rng) * s / a.other_peak,),
            equation="w = v (1 + coefficient o)",
        ),
        Law(
            "quantisation", "quantisation", ("quantization", "quantiser", "resolution"), "static",
            ("interval",), (0.01, 1.0), lambda s, a, rng: (s * a.spread,), fixed=("interval",),
            equation="w = interval round(v / interval)",
        ),
        Law(
            "bouc_wen", "bouc_wen_hysteresis", ("outside_catalogue", "hysteresis", "hysteretic_force"), "added",
            ("force", "yield", "sharpness"), (0.005, 1.5),
            lambda s, a, rng: (s * a.rms, rng.uniform(0.05, 0.4) * a.other_rms * a.pace, float(rng.integers(1, 4))),
            states=1, fixed=("sharpness",), outside=True,
            equation="w = v - force z, z' = o / yield (1 - (1 + sgn(o z)) / 2 |z|^sharpness), o: the speed",
        ),
        Law(
            "fractional", "fractional_lag",
            ("outside_catalogue", "fractional_order_lag", "eddy_current_lag", "diffusion"), "linear",
            ("time_constant",), (0.0003, 1.0), lambda s, a, rng: (s * a.pace,), states=40, outside=True,
            equation="W = V / (1 + sqrt(s time_constant)), poles to 4 times the sample rate",
        ),
        Law(
            "prandtl", "prandtl_hysteresis", ("outside_catalogue", "hysteresis", "prandtl_ishlinskii"), "static",
            ("share", "half_width"), (0.02, 0.95), lambda s, a, rng: (s, rng.uniform(0.03, 0.12) * a.spread * 2.0),
            outside=True, equation="w = (1 - share) v + share (sum of 5 plays of half_width 1, 2 ... 5) / 5",
        ),
        Law(
            "self_heating", "self_heating", ("outside_catalogue", "thermal_gain", "heating", "thermal_memory"),
            "static", ("share", "time_constant", "unit"), (0.005, 0.4),
            lambda s, a, rng: (s, rng.uniform(3.0, 15.0) * a.pace, a.rms), states=1, fixed=("unit",), outside=True,
            equation="w = v (1 - share theta), time_constant theta' = (v / unit)^2 - theta",
        ),
        Law(
            "ripple", "position_ripple", ("outside_catalogue", "cogging", "ripple", "force_ripple"), "added",
            ("amplitude", "period", "phase"), (0.005, 1.0),
            lambda s, a, rng: (s * a.rms, a.other_rms / rng.uniform(1.5, 5.0), rng.uniform(-pi, pi)), outside=True,
            equation="w = v + amplitude (sin(o / period + phase) - sin phase), o: the position",
        ),
    )
}  # fmt: skip
