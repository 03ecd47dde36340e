"""Time simulation: fixed and adaptive steps, results, their files, and whether they can be believed."""
