"""Noise of residuals: whiteness, colour, asynchronous lines, and the cross-spectrum that a fit leaves."""
