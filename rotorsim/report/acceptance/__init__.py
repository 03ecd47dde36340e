"""The report of an acceptance."""
