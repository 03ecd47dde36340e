"""Faults between the motion and what is measured of it."""
