"""Diagrams beside what was measured: harmonics of a turning shaft with their uncertainty, or samples in time."""
