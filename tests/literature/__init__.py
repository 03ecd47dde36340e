"""Published numbers, at the tolerance of their source."""
