"""Block diagrams, FMUs and diagnosis for rotors in active magnetic bearings."""
