"""The independent programs with the values that the shipped diagrams chose where the thesis prints none."""

from __future__ import annotations

from tests.reference.rotor import Rotor
from tests.reference.rotor import fe_flexible as _fe_flexible
from tests.reference.rotor import fe_rigid as fe_rigid
from tests.reference.rotor import offset_disc as offset_disc


def fe_flexible() -> Rotor:
    """Return chapter 5 with inertias of chapter 4 scaled by mass and 500 N s/m in the supports."""
    return _fe_flexible(polar=(0.0045, 0.0034), diametral=(0.0024, 0.0018), bearing_damping=500.0)
