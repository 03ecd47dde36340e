"""``rotorsim fmu info`` and ``rotorsim fmu validate``."""

from __future__ import annotations

from typing import Any

import click

from rotorsim.cli import common
from rotorsim.errors import RotorsimError

__all__ = ["info", "validate"]

file_argument = click.argument("file", metavar="FILE")


@click.command("info")
@file_argument
@click.option("--all", "every", is_flag=True, help="Show local variables too, and all of every kind.")
@common.json_option
def info(file: str, every: bool, as_json: bool) -> int:
    """Show what an FMU holds: platforms, kinds, variables with units, and what of it is supported.

    Nothing of it is loaded or unpacked.
    """
    from rotorsim.fmi.description.info import information, information_text
    from rotorsim.fmi.runtime.slave import describe_fmu

    data = information(describe_fmu(file), every=every)
    if as_json:
        common.echo_json(data)
    else:
        click.echo(information_text(data, every=every))
    return 0


@click.command("validate")
@file_argument
@click.option("--load", is_flag=True, help="Instantiate and initialise it too, in a process of its own: it is code.")
@click.option("--no-fmpy", is_flag=True, help="Do not ask FMPy's validator.")
@common.json_option
def validate(file: str, load: bool, no_fmpy: bool, as_json: bool) -> int:
    """Find every mistake in an FMU: archive, model description, libraries.

    Its code is not run without --load. Exit code 0: no mistake, 1: mistakes, 2: it cannot be read at all.
    """
    from rotorsim.cli.app import problem_data, show_problems
    from rotorsim.fmi.validate import validate_fmu

    try:
        problems, code = validate_fmu(file, load=load, fmpy=not no_fmpy), 0
    except RotorsimError as error:
        problems, code = list(error.problems), 2
    mistakes = sum(problem.severity == "error" for problem in problems)
    code = code or int(mistakes > 0)
    show_problems(problems)
    if as_json:
        data: dict[str, Any] = {"fmu": file, "valid": code == 0, "problems": [problem_data(p) for p in problems]}
        common.echo_json(data)
    elif code == 0:
        warnings = f", {len(problems)} warning{'s' if len(problems) > 1 else ''}" if problems else ""
        click.echo(f"{file}: no mistakes{warnings}")
    if mistakes:
        common.note(f"\n{mistakes} mistake{'s' if mistakes > 1 else ''}")
    return code
