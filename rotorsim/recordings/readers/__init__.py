"""Readers of measurement files: one module and one class a format (`reader.Reader`), in the table of `columns`."""
