"""Fault candidates: declared faults, the places where they fit, and their insertion into a diagram."""
