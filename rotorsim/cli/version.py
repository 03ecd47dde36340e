"""``rotorsim version``."""

from __future__ import annotations

import click

from rotorsim.cli.common import echo_json, json_option

__all__ = ["command"]


@click.command("version")
@json_option
def command(as_json: bool) -> None:
    """Print the versions of rotorsim, Python and the libraries that decide the numbers."""
    import platform
    from importlib.metadata import version

    versions = {"rotorsim": version("rotorsim"), "python": platform.python_version()}
    versions |= {name: version(name) for name in ("casadi", "numpy", "scipy", "fmpy")}
    if as_json:
        echo_json(versions)
    else:
        for name, text in versions.items():
            click.echo(f"{name} {text}")
