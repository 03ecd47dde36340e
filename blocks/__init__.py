"""Block library; every file defines one block."""
