"""Settled periodic motion: harmonic balance, with its derivatives by free parameters, and its stability."""
