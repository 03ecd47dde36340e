"""Traced expressions to C, and C to a shared library."""
