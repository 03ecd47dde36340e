"""Magnetic bearings and supports."""
