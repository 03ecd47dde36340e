"""Verbs of diagrams as documents."""
