"""Diagnoses judged against the truth, summed up, and compared with one another."""
