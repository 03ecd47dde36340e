"""Sources of signals: constants, steps, ramps, lines, noise."""
