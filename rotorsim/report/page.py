"""HTML pages of reports: their style, their tables, and their figures, which are written as PNG as well."""

from __future__ import annotations

import base64
import io
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure

from rotorsim.errors import escape
from rotorsim.files import write_atomically
from rotorsim.report.style import styled

STYLE = """
body{font-family:Helvetica,Arial,sans-serif;color:#222;max-width:1080px;margin:0 auto;padding:1.2em 1.5em}
body{line-height:1.45}h1{font-size:1.5em;margin:0 0 .2em}
h2{font-size:1.15em;margin:2em 0 .5em;border-bottom:1px solid #ccc;padding-bottom:.2em}
h3{font-size:1em;margin:1.4em 0 .4em}.verdict{border-left:6px solid;padding:.5em .9em;background:#f6f6f4;margin:.8em 0}
.verdict b{display:block;font-size:1.1em}table{border-collapse:collapse;margin:.5em 0;font-size:.9em}
th,td{border-bottom:1px solid #ddd;padding:.28em .7em;text-align:left;vertical-align:top}th{background:#f2f2f0}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}td.n{white-space:nowrap}figure{margin:1em 0}
figure img,figure svg{max-width:100%;height:auto}figcaption{font-size:.88em;color:#555}
.wide{overflow-x:auto}.small{font-size:.85em;color:#555}
code{background:#f2f2f0;padding:.1em .3em;overflow-wrap:anywhere}
.key{display:inline-block;width:1em;height:1em;border:3px solid;border-radius:3px;vertical-align:-.2em}
.key{margin:0 .3em 0 .8em}@page{size:A4;margin:15mm}
@media print{body{padding:0;max-width:none;font-size:10pt}h2,h3{break-after:avoid}figure,tr{break-inside:avoid}
.wide{overflow:visible}*{print-color-adjust:exact}}
"""
DPI = 130
SMALL_CLASS = ' class="small"'


class Drawn(NamedTuple):
    """A figure with its name and caption; None where there is nothing to show."""

    name: str
    figure: Figure | None
    caption: str


class Picture(NamedTuple):
    """A figure as pixels: a PNG file in base64."""

    name: str
    title: str
    caption: str
    pixels: str


@styled()
def picture_of(drawn: Drawn) -> Picture | None:
    """Return a figure as pixels; None for none."""
    if drawn.figure is None:
        return None
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    buffer = io.BytesIO()
    drawn.figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(drawn.figure)  # savefig draws twice, the same
    canvas.print_png(buffer)  # type: ignore[no-untyped-call]
    title = " ".join(str(drawn.figure.get_suptitle()).split())
    return Picture(drawn.name, title, drawn.caption, base64.b64encode(buffer.getvalue()).decode("ascii"))


@dataclass
class Page:
    """A page that is being written into a folder, and the files beside it."""

    folder: Path
    files: list[Path] = field(default_factory=list)

    def write(self, name: str, content: str | bytes) -> None:
        """Write a file beside the page."""
        write_atomically(self.folder / name, content)
        self.files.append(self.folder / name)

    def figure(self, drawn: Drawn | None) -> str:
        """Write a figure as PNG and return it for the page, with its pixels inside; nothing for none."""
        return self.picture(None if drawn is None else picture_of(drawn))

    def picture(self, picture: Picture | None) -> str:
        """Write a picture as PNG and return it for the page; nothing for none."""
        if picture is None:
            return ""
        self.write(f"{picture.name}.png", base64.b64decode(picture.pixels))
        return (
            f'<figure><img alt="{escape(picture.title)}" src="data:image/png;base64,{picture.pixels}">'
            f"<figcaption>{escape(picture.caption)}</figcaption></figure>"
        )

    @staticmethod
    def html(title: str, sections: Iterable[str]) -> str:
        """Return the whole page."""
        body = "\n".join(section for section in sections if section)
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
        )


def table(
    header: Sequence[str], rows: Iterable[Sequence[str]], *, right: Collection[int] = (), head: bool = True
) -> str:
    """Return a table, escaped; right: columns that stand to the right, as numbers do."""
    kinds = [' class="n"' if k in right else "" for k in range(len(header))]

    def line(tag: str, cells: Sequence[str]) -> str:
        inside = (f"<{tag}{kind}>{escape(cell)}</{tag}>" for kind, cell in zip(kinds, cells, strict=True))
        return f"<tr>{''.join(inside)}</tr>"

    body = "".join(line("td", row) for row in rows)
    return f'<div class="wide"><table>{line("th", header) if head else ""}{body}</table></div>'


def paragraph(text: str, *, small: bool = False) -> str:
    """Return a paragraph, escaped; nothing for an empty text."""
    return f"<p{SMALL_CLASS if small else ''}>{escape(text)}</p>" if text else ""
