"""Many runs of one diagram that differ in values: side by side, reduced as they go."""
