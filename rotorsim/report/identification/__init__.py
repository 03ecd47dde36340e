"""Figures of an identification, beside what was measured."""
