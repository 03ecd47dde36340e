"""Natural modes of rotors over speed and support stiffness, and their response to unbalance."""
