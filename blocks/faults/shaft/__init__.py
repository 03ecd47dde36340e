"""Faults of a shaft, its discs and couplings."""
