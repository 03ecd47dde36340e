"""``rotorsim blocks``."""

from __future__ import annotations

from pathlib import Path

import click

from rotorsim.cli.shared import echo_json, json_option, show_problems
from rotorsim.errors import Problem, RotorsimError

_MOST = 200  # files that are looked into


@click.command("blocks")
@click.argument("types", metavar="[TYPE]...", nargs=-1)
@click.option("--schema", is_flag=True, help="Print the JSON schema of diagrams, for editors.")
@click.option("--markdown", is_flag=True, help="Print the page docs/blocks.md.")
@click.option("--diagram", metavar="FILE", help="Whose block_folders count too (default: of the diagrams here).")
@click.option("--trust-blocks", is_flag=True, help="Load the block files in these folders: they are code.")
@json_option
def command(
    types: tuple[str, ...], schema: bool, markdown: bool, diagram: str | None, trust_blocks: bool, as_json: bool
) -> None:
    """List the blocks, or show some: ports, parameters, equation, source.

    \b
    rotorsim blocks
    rotorsim blocks pid
    rotorsim blocks hardening_spring --trust-blocks
    """
    from rotorsim.diagram.resolve.registry import Registry
    from rotorsim.report.text.blocks import block_data, block_list, block_text, markdown_page

    registry = Registry(_folders(diagram) if trust_blocks else ())
    known = registry.all_types()
    show_problems(registry.problems)
    unknown = [name for name in types if name not in known]
    if unknown:
        more = ""
        if not trust_blocks and (folders := _folders(diagram)):
            more = f"add --trust-blocks if it is in {' or '.join(map(str, folders[:3]))}; "
        raise RotorsimError(
            *[Problem(what=f"unknown block type '{name}'", hint=more + registry.hint(name)) for name in unknown]
        )
    chosen = [known[name] for name in types] or list(known.values())
    if schema:
        from rotorsim.diagram.schema import schema_text

        click.echo(schema_text(), nl=False)
    elif markdown:
        click.echo(markdown_page(chosen), nl=False)
    elif as_json:
        echo_json({"blocks": {cls.type_name: block_data(cls) for cls in chosen}})
    else:
        click.echo("\n\n\n".join(map(block_text, chosen)) if types else block_list(chosen))


def _folders(diagram: str | None) -> list[Path]:
    """Return the block folders of a diagram, or of those in the current folder, as seen from there."""
    from rotorsim.diagram.parse.source import read_document

    found: dict[Path, None] = {}
    for file in sorted(Path().glob("*.json"))[:_MOST] if diagram is None else [Path(diagram)]:
        try:
            data = read_document(file).data
        except RotorsimError:
            if diagram is None:  # other files of JSON
                continue
            raise
        folders = data.get("block_folders") if isinstance(data, dict) else None
        found |= {file.parent / name: None for name in folders or () if isinstance(name, str)}
    return list(found)
