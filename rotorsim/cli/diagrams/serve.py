"""``rotorsim serve``."""

from __future__ import annotations

import asyncio
import os
import tempfile
from pathlib import Path

import click

from rotorsim.cli.shared import echo_json, json_option, note, refuse_if, trust_option
from rotorsim.errors import Place, Problem, RotorsimError

FIRST_PORT = 8350


@click.command("serve")
@click.argument("diagram", metavar="[DIAGRAM]", required=False)
@click.option("--read-only", is_flag=True, help="Look and run, write nothing.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=FIRST_PORT, show_default=True, help="0: one that is free."
)
@click.option("--no-browser", is_flag=True, help="Only print the address.")
@trust_option
@json_option
def command(
    diagram: str | None, read_only: bool, port: int, no_browser: bool, trust_blocks: bool, as_json: bool
) -> int:
    """Open a page on which a diagram is looked at, edited and run; its file on disk is the only store.

    DIAGRAM is a file of yours; without it the page shows the diagrams that come with rotorsim, each to be copied to the
    current folder. The page is served to this machine only, under an address with a secret token. Ctrl-C ends it.

    \b
    rotorsim serve mine.json
    rotorsim serve mine.json --read-only --port 9000 --no-browser
    """
    from rotorsim.diagram.resolve.resolution import shipped_diagrams
    from rotorsim.serve.guard import new_token
    from rotorsim.serve.server import end_threads, serve
    from rotorsim.serve.session import Session
    from rotorsim.serve.store import DiagramFile

    file = None
    if diagram is not None:
        path = Path(diagram)
        hint = "'rotorsim new mine' makes a diagram; without a name all that come with rotorsim are shown"
        if not path.exists() and diagram in shipped_diagrams():
            hint = f"it comes with rotorsim and stays as it is: rotorsim new mine --from {diagram}"
        refuse_if(not path.is_file(), "there is no such file", place=Place(diagram), hint=hint)
        file = DiagramFile(path, trusted=trust_blocks, read_only=read_only)
    session = Session(Path.cwd(), file, trusted=trust_blocks, read_only=read_only)
    token = new_token()

    def ready(actual: int) -> None:
        address = f"http://127.0.0.1:{actual}/#{token}"
        echo_json({"address": address, "port": actual}) if as_json else click.echo(address)
        note("Ctrl-C ends it; the address is for you alone, whoever has it can write the file")
        if not no_browser:
            import webbrowser

            # the arguments of a process are seen by all users of a machine: the address goes through a file of this one
            way.write_text(f'<meta http-equiv="refresh" content="0; url={address}">')
            webbrowser.open(way.as_uri())

    handle, name = tempfile.mkstemp(prefix="rotorsim-serve-", suffix=".html")  # nobody else may read it
    os.close(handle)
    way = Path(name)
    try:
        asyncio.run(serve(session, token, port, ready))
    except OSError as error:
        what = f"port {port} cannot be had: {error.strerror or error}"
        raise RotorsimError(Problem(what, "--port", hint="another one, or --port 0 for one that is free")) from None
    finally:
        way.unlink(missing_ok=True)
    end_threads()
    return 0
