"""Frequency responses of loops into which a test signal is injected, with intervals, and the margins that they show."""
