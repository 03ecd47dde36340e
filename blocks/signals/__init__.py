"""Elementary blocks: sources, arithmetic, dynamics, routing and recording of signals."""
