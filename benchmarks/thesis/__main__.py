"""python -m benchmarks.thesis figures [NUMBER ...] [--out docs/images/thesis] [--page docs/thesis_figures.md]."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.markers import expect, fill


def _figures(given: argparse.Namespace) -> None:
    from benchmarks.thesis.figures import stated_table, write

    expect(given.page, "figures")
    stated = []
    for number in given.numbers:
        file, numbers = write(number, given.out)
        print(f"{file}  {file.stat().st_size / 1000:.0f} kB", flush=True)
        stated += numbers
    text = stated_table(stated)
    print(f"\n{text}")
    if given.page:
        fill(given.page, "figures", text)


def main(arguments: list[str] | None = None) -> None:
    """Run one of the commands."""
    from benchmarks.thesis.figures import FIGURES

    parser = argparse.ArgumentParser(prog="python -m benchmarks.thesis", description=__doc__)
    commands = parser.add_subparsers(required=True)
    figures = commands.add_parser("figures", help="redraw the result figures of the thesis")
    figures.add_argument(
        "numbers", nargs="*", default=list(FIGURES), metavar="NUMBER", help="such as 2-7; default: all"
    )
    figures.add_argument("--out", type=Path, default=Path("docs/images/thesis"), help="folder of the pictures")
    figures.add_argument("--page", type=Path, help="page with <!-- figures --> and <!-- end --> for the table")
    figures.set_defaults(run=_figures)
    given = parser.parse_args(arguments)
    wrong = sorted(set(getattr(given, "numbers", ())) - set(FIGURES))
    if wrong:
        parser.error(f"no figure {', '.join(wrong)}; hint: {', '.join(FIGURES)}")
    given.run(given)


if __name__ == "__main__":
    main()
