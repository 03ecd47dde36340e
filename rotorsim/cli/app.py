"""The command ``rotorsim``: finds the verb, runs it, and turns every failure into words and an exit code.

Exit codes: 0 fine, 1 finding or failure in the data, 2 misuse or bad input, 130 interrupted, 141 when the reader of
standard output has gone before everything was said.
"""

from __future__ import annotations

import contextlib
import difflib
import errno
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NoReturn, TextIO

import click

from rotorsim.cli.shared import echo_json, problem_data, show_problems, warn
from rotorsim.errors import Problem, RotorsimError, visible
from rotorsim.jobs.threads import ONE_THREAD

# Room and title -> verb -> one line of help. A verb's module is imported only when it is called: --help stays instant.
ROOMS = {
    ("diagrams", "Diagrams"): {
        "check": "Find every mistake in diagrams and recordings.",
        "new": "Copy a diagram that comes with rotorsim, to be edited.",
        "fmt": "Write diagrams in canonical form.",
        "blocks": "List the blocks, or show one: ports, parameters, equation, source.",
        "draw": "Draw a diagram as SVG.",
        "swap": "Replace a block by another type with the same ports.",
        "diff": "Say what differs between two diagrams, apart from layout and spelling.",
        "serve": "Open a page on which a diagram is looked at, edited and run.",
    },
    ("simulations", "Simulation"): {
        "run": "Simulate a diagram; write, plot and summarise the recorded signals.",
        "sweep": "Simulate a diagram many times with varied parameters: maps, bands, bifurcations, cascades.",
        "cosim": "Co-simulate a diagram with FMUs, or parts of it; say what the coupling costs.",
    },
    ("analyses", "Analysis"): {
        "modes": "Natural frequencies, damping ratios and whirl of the linearised diagram.",
        "campbell": "Natural frequencies against speed, tracked.",
        "frequency": "Frequency response from a port to a signal: Bode plot, peaks.",
        "step": "Response of a signal to a step at a port: overshoot, rise and settling time.",
        "margins": "Stability margins of bearing loops after ISO 14839-3, of a diagram or of an injected sweep.",
        "accept": "Judge a machine by ISO 14839 and API 617, by its diagram and by recordings: one report.",
        "periodic": "The settled motion at one or many speeds by harmonic balance.",
    },
    ("recordings", "Recordings"): {
        "spectrum": "Full spectrum and harmonics of two-axis signals of a recording, a result or a diagram.",
        "orders": "Orders of run-ups over the speed: Bode, polar, cascade; critical speeds and separation margins.",
        "record": "Simulate measurements of a diagram into a recording.",
        "identify": "Estimate the free parameters of a diagram from a recording, with intervals and verdicts.",
        "sensitivity": "Move the identified parameters by noise and wrong known ones, over many seeds.",
        "diagnose": "Say where a diagram and a recording differ, what physics is missing, and repair the diagram.",
        "locate": "Find the node at which a crack or another force acts, from a recording.",
    },
    ("exchange", "Other tools"): {
        "fmu": "Export diagrams as FMUs for other tools; look into FMUs.",
        "ssp": "Export diagrams as systems of FMUs (SSP); import such systems as diagrams.",
        "import": "Write a model of another program as a diagram: rotors of ROSS.",
    },
    ("about", "About rotorsim"): {
        "docs": "List the pages that come with rotorsim, or show one.",
        "cache": "Show or clear the cache of compiled models.",
        "version": "Print the version.",
    },
}
VERBS = {verb: text for verbs in ROOMS.values() for verb, text in verbs.items()}


_FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))  # of a disk, a file, a quota


def verb(name: str) -> click.Command:
    """Return the command of a verb."""
    room = next(room for (room, _), verbs in ROOMS.items() if name in verbs)
    command: click.Command = import_module(f"rotorsim.cli.{room}.{name}").command
    return command


class _Verbs(click.Group):
    """Group whose commands are modules, imported when called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return verb(cmd_name) if cmd_name in VERBS else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for (_, title), verbs in ROOMS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(max(map(len, VERBS))), text) for name, text in verbs.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and args[0] not in VERBS:
            near = difflib.get_close_matches(args[0], VERBS, n=1)
            raise RotorsimError(
                Problem(
                    what=f"unknown verb '{args[0]}'",
                    hint=f"did you mean '{near[0]}'?" if near else "'rotorsim --help' lists the verbs",
                )
            )
        return super().resolve_command(ctx, args)

    def main(self, args: Sequence[str] | None = None, *_: Any, **extra: Any) -> NoReturn:
        """Run the verb; print every problem on stderr; leave with the exit code."""
        arguments = list(sys.argv[1:] if args is None else args)
        debug = "--debug" in arguments
        arguments = [argument for argument in arguments if argument != "--debug"]
        previous = warnings.showwarning, sys.stdout, sys.stderr
        warnings.showwarning = _show_warning
        for name, stream in {"stdout": _Output(sys.stdout), "stderr": _Messages(sys.stderr)}.items():
            setattr(sys, name, stream)
        try:
            code = self._code(arguments, extra, debug)
            sys.stdout.flush()
        except _UnwrittenError as error:
            code = _unwritten(error)
        finally:
            warnings.showwarning, sys.stdout, sys.stderr = previous
        sys.exit(code)

    def _code(self, arguments: Sequence[str], extra: dict[str, Any], debug: bool) -> int:
        """Run the verb and explain its failure; return the exit code."""
        try:
            extra.pop("standalone_mode", None)
            extra["prog_name"] = "rotorsim"
            code = super().main(arguments, standalone_mode=False, **extra)
        except _UnwrittenError:
            raise
        except BaseException as error:
            if debug and not isinstance(error, click.exceptions.Exit):
                import traceback

                traceback.print_exc()
            return _explain(error, as_json="--json" in arguments)
        return code if isinstance(code, int) else 0


@dataclass(eq=False)
class _UnwrittenError(Exception):
    """Standard output took no more. (No OSError, which click would explain itself.)"""

    cause: OSError


class _Output:
    """Standard output: control characters in names of others are written out, so that none steers a terminal."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        return int(self._try(lambda: self._stream.write(visible(text))))

    def flush(self) -> None:
        self._try(self._stream.flush)

    def _try(self, act: Callable[[], Any]) -> Any:
        try:
            return act()
        except OSError as error:
            raise _UnwrittenError(error) from error


class _Messages(_Output):
    """Standard error: where nobody can read it any more, the work goes on all the same."""

    def write(self, text: str) -> int:
        return int(self._try(lambda: self._stream.write(text)))

    def _try(self, act: Callable[[], Any]) -> Any:
        try:
            return act()
        except OSError:
            return 0


def _explain(error: BaseException, as_json: bool) -> int:
    """Print what went wrong; return the exit code."""
    if isinstance(error, click.exceptions.Exit):
        return error.exit_code
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else 1
    if isinstance(error, click.exceptions.Abort | KeyboardInterrupt):
        click.echo("interrupted", err=True)
        return 130
    if isinstance(error, RotorsimError):
        problems, code = error.problems, error.exit_code
    elif isinstance(error, click.UsageError):
        problems, code = (_usage_problem(error),), 2
    elif isinstance(error, click.ClickException):
        problems, code = (Problem(what=error.format_message()),), 2
    elif isinstance(error, MemoryError):
        problems, code = (Problem(what="not enough memory", hint="record less, or shorten the run with --stop"),), 1
    elif isinstance(error, OSError) and error.errno in _FULL:
        what = ": ".join(str(part) for part in (error.filename, os.strerror(error.errno or 0).lower()) if part)
        problems, code = (Problem(what=what, hint="make room, or write to another disk"),), 1
    elif isinstance(error, OSError) and error.filename is not None:
        problems, code = (Problem(what=f"{error.filename}: {(error.strerror or str(error)).lower()}"),), 2
    else:
        text = " ".join(str(error).split())[:300]
        hint = "this is a fault of rotorsim: please report it with the command and the traceback that --debug prints"
        problems, code = (Problem(what=f"internal error: {type(error).__name__}: {text}", hint=hint),), 1
    show_problems(problems)
    if as_json:
        echo_json({"problems": [problem_data(problem) for problem in problems]})
    return code


def _usage_problem(error: click.UsageError) -> Problem:
    """Return a usage error of click in our words, with the near miss as hint."""
    verb = error.ctx.command_path if error.ctx else "rotorsim"
    hint = f"'{verb} --help' shows how it is used"
    if isinstance(error, click.NoSuchOption):
        known = [name for parameter in error.ctx.command.params for name in parameter.opts] if error.ctx else []
        near = error.possibilities or difflib.get_close_matches(error.option_name, known, n=1)
        return Problem(f"unknown option '{error.option_name}'", hint=f"did you mean '{near[0]}'?" if near else hint)
    text = error.format_message().rstrip(".")
    return Problem(what=text[:1].lower() + text[1:], hint=hint)


def _show_warning(message: Any, category: Any, *_: Any, **__: Any) -> None:
    warn(str(message))


def _unwritten(error: _UnwrittenError) -> int:
    """Leave quietly when the reader of a pipe has gone (``rotorsim blocks | head``); say it of a full disk.

    The exit code is never 0: a finding may not have been said.
    """
    cause = error.cause
    with contextlib.suppress(OSError, ValueError):  # else Python tries again to write what is left, at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if cause.errno == errno.EPIPE:
        return 128 + 13  # as of a program that SIGPIPE ends
    what = f"standard output cannot be written: {(cause.strerror or str(cause)).lower()}"
    hint = "make room there; what was printed is lost, files that were named as written are not"
    show_problems([Problem(what, hint=hint)])
    return 1


def _open_streams() -> None:
    """Open what the caller has closed (``rotorsim ... >&-``) to nowhere: else a file would take its number, and get
    what a compiler or an FMU prints.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115


def _keep_output() -> None:
    """Let standard output be ours alone: what FMUs and compilers print in this process, or in one that it starts, goes
    where messages go.
    """
    sys.stdout.flush()
    ours = open(  # noqa: SIM115
        os.dup(1), "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors, buffering=1 if os.isatty(1) else -1
    )
    os.dup2(2, 1)
    sys.stdout = ours


@click.command(cls=_Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option("--debug", is_flag=True, expose_value=False, help="Show the traceback of a failure (with any verb).")
@click.version_option(package_name="rotorsim", message="rotorsim %(version)s")
def rotorsim() -> None:
    """Block diagrams of rotors in active magnetic bearings: edit JSON, run, compare.

    DIAGRAM is a file, or the name of a diagram that comes with rotorsim (jeffcott, fe_rigid, ...).
    Data goes to stdout, progress and messages to stderr.
    Exit codes: 0 fine, 1 a finding or a failure in the data, 2 misuse or bad input.
    """


def main() -> NoReturn:
    """Run the command line of this process, with one thread of linear algebra unless its environment says otherwise.

    Matrices are many and small: threads that wait for one another spin, above all beside other programs.
    """
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    _open_streams()
    _keep_output()
    rotorsim.main()
