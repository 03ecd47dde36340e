"""Samples in time: what drives a diagram, output-error search, what counts as noise, free signals."""
