"""Identification beside its targets, on data of independent programs."""
