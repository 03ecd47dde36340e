"""Diagnosis of measured machines, and what its tolerances stand on."""
