"""``rotorsim cache``."""

from __future__ import annotations

import click

from rotorsim.cli.common import echo_json, json_option

__all__ = ["command"]


@click.command("cache")
@click.option("--clear", is_flag=True, help="Delete the compiled models.")
@json_option
def command(clear: bool, as_json: bool) -> None:
    """Show or clear the cache of compiled models."""
    from rotorsim.compile.toolchain import cache_folder

    folder = cache_folder()
    files = [file for file in folder.glob("*") if file.suffix in {".so", ".dll"}] if folder.is_dir() else []
    size = sum(file.stat().st_size for file in files)
    if clear:
        for file in files:
            file.unlink(missing_ok=True)
    if as_json:
        echo_json({"folder": str(folder), "files": len(files), "bytes": size, "cleared": clear})
    else:
        verb = "deleted from" if clear else "in"
        click.echo(f"{len(files)} compiled models, {size / 1e6:.1f} MB, {verb} {folder}")
