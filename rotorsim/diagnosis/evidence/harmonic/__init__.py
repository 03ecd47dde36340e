"""Harmonics of a turning shaft, compared with the settled motion of a diagram."""
