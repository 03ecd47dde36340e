"""Measurements beside their targets: each a module to run from the repository root; see README.md."""
