"""Rotors that ROSS has saved, as diagrams."""
