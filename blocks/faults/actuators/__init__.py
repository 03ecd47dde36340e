"""Faults between the controller and the magnetic force."""
