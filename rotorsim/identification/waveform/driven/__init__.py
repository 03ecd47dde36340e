"""Equations of a diagram driven by recorded signals, and their simulation with sensitivities: exact, or in steps."""
