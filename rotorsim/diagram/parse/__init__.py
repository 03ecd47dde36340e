"""Text to a checked flat document: JSON within limits, its form, sub-diagrams, the canonical form."""
