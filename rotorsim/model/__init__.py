"""A diagram as a compiled model: traced by CasADi, emitted as C, at work with its parameters and states."""
