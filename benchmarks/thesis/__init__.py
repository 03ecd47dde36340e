"""The thesis again: its result figures redrawn and its tables beside the printed ones."""
