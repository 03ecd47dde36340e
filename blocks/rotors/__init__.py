"""Rotors and other mechanical plants."""
