"""Recordings of machines: what was measured, read from and written to measurement files."""
