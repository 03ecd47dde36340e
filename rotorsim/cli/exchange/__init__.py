"""Verbs that exchange models with other tools."""
