"""Arithmetic of signals."""
