"""Systems of FMUs (SSP 1.0 and 2.0) from diagrams, and as diagrams."""
