"""Elementary blocks of signals, which know nothing of rotors."""
