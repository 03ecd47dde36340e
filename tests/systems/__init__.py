"""Whole diagrams against independent programs."""
