"""FMUs and co-simulation: masters, FMUs of other tools, platforms, cost of a step, damaged archives."""
