"""``rotorsim blocks``."""

from __future__ import annotations

import click

from rotorsim.cli.common import echo_json, json_option
from rotorsim.errors import Problem, RotorsimError

__all__ = ["command"]


@click.command("blocks")
@click.argument("types", metavar="[TYPE]...", nargs=-1)
@click.option("--schema", is_flag=True, help="Print the JSON schema of diagrams, for editors.")
@click.option("--markdown", is_flag=True, help="Print the page docs/blocks.md.")
@json_option
def command(types: tuple[str, ...], schema: bool, markdown: bool, as_json: bool) -> None:
    """List the blocks, or show some: ports, parameters, equation, source.

    \b
    rotorsim blocks
    rotorsim blocks pid
    """
    from rotorsim.cli.app import show_problems
    from rotorsim.cli.block_pages import block_data, block_list, block_text, markdown_page
    from rotorsim.diagram.registry import Registry

    registry = Registry()
    known = registry.all_types()
    show_problems(registry.problems)
    unknown = [name for name in types if name not in known]
    if unknown:
        raise RotorsimError(
            *[Problem(what=f"unknown block type '{name}'", hint=registry.hint(name)) for name in unknown]
        )
    if schema:
        from rotorsim.diagram.schema import schema_text

        click.echo(schema_text(), nl=False)
        return
    chosen = [known[name] for name in types] or list(known.values())
    if markdown:
        click.echo(markdown_page(chosen), nl=False)
    elif as_json:
        echo_json({"blocks": {cls.type_name: block_data(cls) for cls in chosen}})
    elif types:
        click.echo("\n\n\n".join(block_text(cls) for cls in chosen))
    else:
        click.echo(block_list(chosen))
