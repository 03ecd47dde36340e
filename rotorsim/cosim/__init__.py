"""Co-simulation: participants, masters, coupling, and what the coupling does to stability."""
