"""What several blocks share; no blocks of their own."""
