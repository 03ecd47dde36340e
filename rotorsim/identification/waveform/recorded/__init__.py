"""Runs as they were recorded: samples and what they drive, time stamps, gaps, the angle of a shaft that turns."""
