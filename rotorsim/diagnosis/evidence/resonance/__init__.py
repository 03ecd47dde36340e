"""Recordings as resonances, compared with the modes of a diagram."""
