"""The report of a diagnosis: one HTML page with its figures and tables."""
