"""Functional mock-up units: description, export, and use of foreign ones."""
