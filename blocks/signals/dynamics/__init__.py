"""Linear dynamics of signals, continuous and sampled."""
