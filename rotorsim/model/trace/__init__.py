"""Equations of blocks and of whole diagrams as expressions, in the order in which they can be computed."""
