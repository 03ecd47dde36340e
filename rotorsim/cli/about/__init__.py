"""Verbs of rotorsim itself."""
