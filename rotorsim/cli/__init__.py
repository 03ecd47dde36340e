"""The command line: one thin file per verb, whose name is the verb and which offers its `command`."""

from rotorsim.cli.app import main

__all__ = ["main"]
