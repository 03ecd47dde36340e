"""Figures that a rotor engineer reads."""
