"""``rotorsim version``."""

from __future__ import annotations

import click

from rotorsim.cli.shared import json_option, show


@click.command("version")
@json_option
def command(as_json: bool) -> None:
    """Print the versions of rotorsim, Python and the libraries that decide the numbers."""
    import platform
    from importlib.metadata import version

    versions = {"rotorsim": version("rotorsim"), "python": platform.python_version()}
    versions |= {name: version(name) for name in ("casadi", "numpy", "scipy", "fmpy")}
    show(as_json, lambda: versions, lambda: "\n".join(f"{name} {text}" for name, text in versions.items()))
