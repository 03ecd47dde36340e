"""``rotorsim cache``."""

from __future__ import annotations

import re
import shutil

import click

from rotorsim.cli.shared import json_option, show


@click.command("cache")
@click.option("--clear", is_flag=True, help="Delete the compiled models.")
@json_option
def command(clear: bool, as_json: bool) -> None:
    """Show or clear the cache of compiled models."""
    from rotorsim.files import HIDDEN, sweep
    from rotorsim.model.emit.toolchain import cache_folder

    folder = cache_folder()
    inside = list(folder.iterdir()) if folder.is_dir() else []
    files = [file for file in inside if file.suffix in {".so", ".dll", ".dylib"}]
    size = sum(file.lstat().st_size for file in files)
    if clear:
        for file in files:
            file.unlink(missing_ok=True)
        for left in inside:  # by runs that were killed, of this version or an older one
            if left.name.startswith("build-") and left.is_dir() and not left.is_symlink():
                shutil.rmtree(left, ignore_errors=True)
            elif re.fullmatch(r"fmu-[0-9a-f]{32}\.\d+", left.name):
                left.unlink(missing_ok=True)
        sweep(folder, HIDDEN)
    show(
        as_json,
        lambda: {"folder": str(folder), "files": len(files), "bytes": size, "cleared": clear},
        lambda: f"{len(files)} compiled models, {size / 1e6:.1f} MB, {'deleted from' if clear else 'in'} {folder}",
    )
