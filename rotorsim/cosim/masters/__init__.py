"""Masters of a co-simulation: Jacobi, Gauss-Seidel, iterative (Picard, Newton), waveform relaxation."""
