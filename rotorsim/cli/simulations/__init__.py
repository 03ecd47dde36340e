"""Verbs that run diagrams in time."""
