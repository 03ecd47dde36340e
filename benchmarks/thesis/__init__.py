"""What the source thesis prints beside what is computed here."""
