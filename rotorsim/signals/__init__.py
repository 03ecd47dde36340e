"""Signal processing of rotors: shaft angle, harmonics, spectra, asynchronous lines, noise, quantisation."""
