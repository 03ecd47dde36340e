"""Recordings of generic diagrams with something left out, to judge diagnoses where the truth is known: README.md."""
