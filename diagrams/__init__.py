"""Diagrams that come with rotorsim."""
