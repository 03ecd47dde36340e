"""A document to a diagram: block classes, shapes, values, units and wires, all mistakes at once."""
