"""Sensitivity studies: how noise and wrong known parameters move the identified ones."""
