"""Responses of loops: margins, frequency and step response, root loci, controller design."""
