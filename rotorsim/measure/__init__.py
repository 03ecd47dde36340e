"""Measuring and checking: simulated recordings, recordings as results, suspicious signals."""
