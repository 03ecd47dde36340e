"""A diagram or some of its blocks as an FMU: variables, description, C sources, binaries."""
