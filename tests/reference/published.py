"""Published numbers: Table 2-2 (recomputed by two programs), natural frequencies, run-up resonances.

Source: S. Singh (IIT Guwahati, 2015), Tables 2-2 and 2-3, sections 2.7, 3.7, 4.7; amplitudes at orders +-5
and arg I_2 corrected (the thesis' derivative block lags by part of a step; arg I_2 is misprinted).
"""

from __future__ import annotations

from collections.abc import Sequence

# order: (abs R [m], arg R [deg], abs I [A], arg I [deg]) at 25 Hz, step 1e-4 s, window 4-5 s
TABLE_2_2: dict[int, tuple[float, float, float, float]] = {
    0: (1.207e-6, -0.05, 2.754e-2, 0.04),
    1: (3.178e-6, 7.97, 3.880e-2, 10.15),
    2: (2.004e-6, -3.74, 2.452e-2, 0.67),
    3: (1.133e-6, -7.49, 1.391e-2, -0.88),
    5: (9.640e-7, 67.64, 1.198e-2, 78.57),
    7: (5.590e-8, -169.83, 7.058e-4, -154.88),
    -1: (7.393e-7, 1.64, 9.025e-3, -0.61),
    -3: (2.266e-7, -172.56, 2.783e-3, -179.05),
    -5: (4.133e-7, 112.35, 5.132e-3, 101.44),
}

# fe_rigid without AMB, E = 2.1e11 Pa, no damping [Hz]
FE_RIGID_AT_REST = ("54.3005", "338.398", "678.808")
FE_RIGID_AT_3000_RPM = ("54.1532", "54.4399", "312.997", "364.277")  # backward, forward, backward, forward

# resonance of the run-up of chapter 2 [rpm]: with the angle as integral of speed, and with omega(t) t
RUN_UP_RIGHT = 7298.0
RUN_UP_THESIS = 3684.0


def as_printed(found: Sequence[float], printed: Sequence[str]) -> bool:
    """Return whether numbers round to the printed digits (half a unit of the last: about 1e-6 relative here)."""
    return all(f"{x:.{len(text.partition('.')[2])}f}" == text for x, text in zip(found, printed, strict=False))
