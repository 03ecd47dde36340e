"""Tables and texts of the report of a diagnosis: everything that comes from users is escaped here."""

from __future__ import annotations

import hashlib
import json
import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from rotorsim.diagnosis.conclude.conclusions import Diagnosis, estimates
from rotorsim.diagnosis.evidence.harmonic import Fit
from rotorsim.diagnosis.files import repaired_document
from rotorsim.diagnosis.search.trials import Candidate
from rotorsim.diagram.resolve.registry import all_types
from rotorsim.errors import escape
from rotorsim.units import format_quantity

__all__ = [
    "CRITERION",
    "EVIDENCE",
    "STYLE",
    "VERDICTS",
    "Right",
    "estimate",
    "flat",
    "own_parameters",
    "percent",
    "plain_words",
    "provenance",
    "quantity",
    "table",
    "why_lost",
]


VERDICTS = {
    "consistent": ("Nothing is missing", "#0b6b4f"),
    "missing_physics": ("Physics is missing", "#b33c00"),
    "outside_catalogue": ("Physics outside the catalogue is missing", "#6a2300"),
    "not_identifiable": ("Physics is missing, and the data do not say which", "#7a5c00"),
}
EVIDENCE = (
    "Misfit: sum of squares of what is left over, in standard deviations of the noise. Freedom: equations less "
    "unknowns. Probability: that noise alone leaves as much."
)
CRITERION = "Criterion: misfit and ln(equations) for every unknown (BIC); 10 more are odds of 150 to 1."
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
.key{margin:0 .3em 0 .8em}@media print{h2{break-after:avoid}figure,tr{break-inside:avoid}}
"""
UNITS = {"orders": "N, 0-peak", "phase_to_displacement_deg": "deg"}
MAP = "force_map"  # the block whose terms are the map of an unknown force


@dataclass(frozen=True)
class Right:
    """A cell of a table that stands to the right, as numbers do."""

    text: str


def table(header: Sequence[str], rows: Iterable[Sequence[str | Right]], *, head: bool = True) -> str:
    """Return a table; `Right` stands to the right."""
    lines = [list(row) for row in rows]
    right = {k for row in lines for k, cell in enumerate(row) if isinstance(cell, Right)}

    def cell(tag: str, k: int, value: str | Right) -> str:
        text = value.text if isinstance(value, Right) else value
        kind = ' class="n"' if k in right else ""
        return f"<{tag}{kind}>{escape(text)}</{tag}>"

    body = "".join("<tr>" + "".join(cell("td", k, value) for k, value in enumerate(row)) + "</tr>" for row in lines)
    top = "<tr>" + "".join(cell("th", k, value) for k, value in enumerate(header)) + "</tr>" if head else ""
    return f'<div class="wide"><table>{top}{body}</table></div>'


def plain_words(name: str) -> str:
    """Return a name without underscores."""
    return name.replace("_", " ")


def percent(value: float | None) -> str:
    """Return a share in percent, nothing for none."""
    return f"{100 * value:.3g} %" if value is not None and math.isfinite(value) else ""


def quantity(value: Any, unit: Any, digits: int = 4) -> str:
    """Return a value with its unit; angles in degrees."""
    if value is None or not math.isfinite(value):
        return "unbounded"
    if unit == "rad":
        return f"{math.degrees(value):.{digits}g} deg"
    return format_quantity(float(value), None if unit in ("", "1") else str(unit), digits)


def estimate(item: Mapping[str, Any]) -> list[str]:
    """Return value and 90 % interval of an estimate, with as many digits as its interval has."""
    low, high = item["interval90"]
    if item.get("at_bound"):
        return [quantity(item["value"], item["unit"], 3), "at its bound"]
    digits = 5
    if low is not None and high is not None and high > low and item["value"]:
        digits = int(np.clip(2 - math.floor(math.log10((high - low) / abs(item["value"]))), 2, 8))
    unit = item["unit"]
    ends = [quantity(end, unit, digits) if end is not None else "unbounded" for end in (low, high)]
    return [quantity(item["value"], unit, digits), f"{ends[0]} to {ends[1]}"]


def own_parameters(candidate: Candidate, fit: Fit) -> str:
    """Return the parameters of a candidate with their values in a fit."""
    known = estimates(fit)
    return ", ".join(
        f"{name.rpartition('.')[2]} {quantity(known[name].value, known[name].unit)}"
        for name in candidate.insertion.free
        if name in known
    )


def flat(data: Mapping[str, Any], prefix: str = "", *, speeds: Sequence[float] = ()) -> list[tuple[str, str]]:
    """Return nested plain data as (name, text); speeds: of the runs [rpm], beside what is given for each."""
    found: list[tuple[str, str]] = []
    for key, value in data.items():
        if key == "work_per_turn" and isinstance(value, Sequence) and len(value) == len(speeds):
            by_speed = sorted(zip(speeds, value, strict=True))
            text = ", ".join(f"{speed:.0f} rpm: {format_quantity(work, 'J', 3)}" for speed, work in by_speed)
            found.append((f"{prefix}{plain_words(key)}", text))
            continue
        if key == "terms" and isinstance(value, Mapping):
            found += [(f"{prefix}{plain_words(name)}", _term(name, size)) for name, size in value.items()]
            continue
        if key == "explains" and isinstance(value, float):
            found.append((f"{prefix}explains", f"{percent(value)} of the misfit"))
            continue
        unit = UNITS.get(str(key), "")
        name = f"{prefix}{plain_words(str(key).removesuffix('_deg'))}" + (f" [{unit}]" if unit else "")
        if isinstance(value, Mapping) and value and all(str(k).isdigit() for k in value):
            found.append((name, ", ".join(f"{k}X {v:.3g}" for k, v in value.items())))
        elif isinstance(value, Mapping):
            found += flat(value, f"{name}: ")
        elif isinstance(value, Sequence) and not isinstance(value, str):
            found.append((name, ", ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in value)))
        else:
            found.append((name, f"{value:.4g}" if isinstance(value, float) else str(value)))
    return found


def _term(name: str, size: Any) -> str:
    """Return the value of a term of a map with the unit that the block declares for it."""
    kind = all_types().get(MAP)
    declared = None if kind is None else kind.parameters.get(name)
    return f"{float(size):.4g} {'' if declared is None else declared.unit or ''}".strip()


def why_lost(fit: Fit, best: Fit, given: str) -> str:
    """Return why a rival lost; given: what the diagnosis says of it."""
    ratio = fit.misfit * best.freedom / (fit.freedom * best.misfit)
    if not fit.failure and (ratio > 2 or (ratio > 1.05 and not given.startswith("needs"))):
        return f"leaves {ratio:.3g} times as much"
    return given or "explains the data less well"


def document_hash(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a document, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(document, sort_keys=True, default=str).encode()).hexdigest()


def _recordings(found: Diagnosis) -> list[tuple[Any, str]]:
    if found.recordings:
        return [(item, "held-out recording" if k else "recording") for k, item in enumerate(found.recordings)]
    source = getattr(found.source, "recording", None)
    every = [(source, "recording")] if source is not None else []
    return every + [(part.recording, "held-out recording") for part in found.held if part.recording is not source]


def _samples(recording: Any) -> str:
    """Return the SHA-256 of all samples of a recording."""
    digest = hashlib.sha256()
    for run in recording.runs:
        for name in sorted(run.values):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(run.values[name]).tobytes())
    return digest.hexdigest()


def provenance(found: Diagnosis, command: str) -> str:
    """Return the table of what a diagnosis was made from and with."""
    rows = [("made", datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")), ("command", command)]
    rows.append(("diagram as given, sha256", document_hash(found.before.document)))
    rows.append(("repaired diagram, sha256", document_hash(repaired_document(found))))
    for recording, what in _recordings(found):
        text = f"{recording.name}, {len(recording.runs)} runs: {_samples(recording)}"
        rows += [(f"{what}, sha256 of the samples", text), ("source of the recording", str(recording.source))]
    libraries = ", ".join(f"{name} {version(name)}" for name in ("casadi", "numpy", "scipy", "matplotlib"))
    rows.append(("work", ", ".join(f"{value} {name}" for name, value in found.named.counts.items())))
    rows.append(("versions", f"rotorsim {version('rotorsim')}, Python {platform.python_version()}, {libraries}"))
    lines = [f"<tr><th>{escape(name)}</th><td><code>{escape(text)}</code></td></tr>" for name, text in rows if text]
    return f'<table class="small">{"".join(lines)}</table>'
