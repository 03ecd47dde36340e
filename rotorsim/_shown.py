"""What a person sees of a result: a short text, a table in a notebook, a figure."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from rotorsim.errors import Problem, RotorsimError, escape

_ROWS = 30  # of a table in a notebook


class Shown:
    """A result that can be looked at; ``_figure``: "module:function" of what draws it.

    The figures are a room above the results and are therefore named, not imported: matplotlib loads when one is drawn.
    """

    _figure = ""

    def plot(self, *args: Any, **options: Any) -> Any:
        """Return the matplotlib Figure of this result; options: those of the function in `rotorsim.report`."""
        module, _, function = self._figure.partition(":")
        return getattr(import_module(module), function)(self, *args, **options)

    def _repr_html_(self) -> str:
        to_table = getattr(self, "to_table", None)
        return f"<p>{escape(repr(self))}</p>" + (html_table(to_table()) if to_table else "")


def html_table(rows: list[dict[str, Any]]) -> str:
    """Return rows of equal keys as an HTML table, the first 30 of them."""
    if not rows:
        return ""
    head = "".join(f"<th>{escape(str(name))}</th>" for name in rows[0])
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(_cell(value))}</td>" for value in row.values()) + "</tr>" for row in rows[:_ROWS]
    )
    more = f"<p>and {len(rows) - _ROWS} more rows: to_table()</p>" if len(rows) > _ROWS else ""
    return f"<table><tr>{head}</tr>{body}</table>{more}"


def _cell(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def xarray_module() -> Any:
    """Return the optional package xarray. Raises RotorsimError without it."""
    try:
        return import_module("xarray")
    except ImportError:
        raise RotorsimError(
            Problem(what="xarray is not installed", subject="to_xarray", hint="pip install 'rotorsim[xarray]'")
        ) from None
