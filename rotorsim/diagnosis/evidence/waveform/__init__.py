"""Recordings as samples in time, compared with simulated runs."""
