"""Verbs that analyse a machine by its diagram."""
