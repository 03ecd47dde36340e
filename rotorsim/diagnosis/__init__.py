"""Diagnosis: locate where model and recordings differ, name the missing physics, model it, show the fit improve."""
