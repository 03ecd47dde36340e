"""Tests of rotorsim; a package so that `tests.reference` can be imported by tests and benchmarks."""
