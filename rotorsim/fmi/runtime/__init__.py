"""An FMU at work: library, process, calls, steps of Co-Simulation and Model Exchange."""
