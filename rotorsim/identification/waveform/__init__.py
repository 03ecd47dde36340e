"""Samples in time: driven equations, their simulation with sensitivities, output-error search."""
