"""The command line: one thin file per verb."""

from rotorsim.cli.app import main

__all__ = ["main"]
