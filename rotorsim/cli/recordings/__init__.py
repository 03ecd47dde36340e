"""Verbs of measurements: made, looked at, compared with a diagram."""
