"""Figures of runs and of linear analyses."""
