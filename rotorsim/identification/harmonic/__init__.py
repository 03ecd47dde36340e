"""Measured harmonics of settled motion: likelihood, estimates with intervals, the regression of stiffnesses."""
