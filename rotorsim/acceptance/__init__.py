"""Acceptance of a machine: what standards ask of it, judged by its diagram and by its recordings."""
