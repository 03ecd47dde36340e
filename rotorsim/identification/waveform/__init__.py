"""Samples in time: output-error search, what counts as noise, free signals."""
