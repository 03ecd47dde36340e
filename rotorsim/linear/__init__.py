"""Linear analyses: operating points, modes, Campbell diagrams, frequency response, controller design."""
