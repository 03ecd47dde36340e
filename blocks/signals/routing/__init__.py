"""Buses, selection and recording of signals."""
