"""Diagrams as data: documents, blocks, wires, values; read, checked, edited, compared, drawn."""
