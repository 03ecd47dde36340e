"""Figures and reports that a rotor engineer reads."""
