"""What can be hidden in a machine: rows of the catalogue by where they act, aliases, and laws outside."""
