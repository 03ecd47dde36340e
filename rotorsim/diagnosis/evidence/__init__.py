"""What recordings say: residuals and scores of a diagram against harmonics, samples in time, orders, or resonances."""
