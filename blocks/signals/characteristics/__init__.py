"""Nonlinear characteristics, with and without memory, and gains that vary."""
