"""The report of a diagnosis: one HTML file that holds everything, and its figures as PNG beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude.result import Diagnosis
from rotorsim.diagnosis.evidence.evidence import Evidence
from rotorsim.diagnosis.files import diagnosis_data, repaired_document
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError, escape
from rotorsim.files import write_atomically
from rotorsim.jobs.jobs import Jobs, run_jobs
from rotorsim.report.amplitudes import amplitudes, shown_amplitudes
from rotorsim.report.diagnosis.compared import Compared, compared, is_unchanged, looks_of
from rotorsim.report.diagnosis.effects import what_is_missing
from rotorsim.report.diagnosis.parameters import parameters_figure
from rotorsim.report.diagnosis.places import NEW, SHADES, block_diagram, places_figure
from rotorsim.report.diagnosis.provenance import provenance
from rotorsim.report.diagnosis.rivals import fits_table, rivals_tables
from rotorsim.report.diagnosis.signals import missing_signals
from rotorsim.report.diagnosis.words import estimate, percent, plain_words
from rotorsim.report.page import Drawn, Page, Picture, paragraph, picture_of, table
from rotorsim.report.provenance import own_command

REPORT = "report.html"
VERDICT_WORDS = {
    "consistent": ("Nothing is missing", "#0b6b4f"),
    "missing_physics": ("Physics is missing", "#b33c00"),
    "outside_catalogue": ("Physics outside the catalogue is missing", "#6a2300"),
    "not_identifiable": ("Physics is missing, and the data do not say which", "#7a5c00"),
}
UNJUDGED = "Whether physics is missing cannot be judged"
ERROR = "Root mean square of the residual, in parts of the signal about its mean."


def save_report(
    diagnosis: Diagnosis, folder: str | Path, *, command: str | None = None, jobs: Jobs | None = None
) -> list[Path]:
    """Write report.html and its figures as PNG (the diagram as SVG) into a folder; return the files.

    command: what made the diagnosis (default: the command line of rotorsim, if this is one). jobs: processes that
    draw (default: this one).
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    page, both = Page(folder), _Beside.drawn(compared(diagnosis), jobs or Jobs(workers=1))
    title = f"Diagnosis of {diagnosis.document.get('name', 'diagram')} from {diagnosis.evidence.recording.name}"
    sections = _sections(diagnosis, both, page, title, own_command() if command is None else command)
    write_atomically(folder / REPORT, page.html(title, sections))
    return [folder / REPORT, *page.files]


@dataclass(frozen=True)
class _Beside:
    """Both diagrams beside what was measured: the speeds of the fitted runs [rad/s], and the figures."""

    speeds: Sequence[float]
    figures: Sequence[Picture]
    residuals: Picture | None

    @staticmethod
    def drawn(both: Compared, jobs: Jobs) -> _Beside:
        """Return the figures of a comparison; what is drawn apart, each by a process of its own."""
        tasks = [*((part, False, shown_amplitudes()) for part in both.parts), (both, True, shown_amplitudes())]
        *figures, residuals = run_jobs(_pictures, tasks, jobs=replace(jobs, progress=None))
        pictures = tuple(Picture(**one) for part in figures for one in part)
        return _Beside(both.speeds, pictures, Picture(**residuals[0]) if residuals else None)


def _pictures(task: tuple[Compared, bool, str]) -> list[dict[str, str]]:
    """Return the residuals, or the other figures, of a comparison as pixels."""
    both, residuals, amplitude = task
    with amplitudes(amplitude):
        drawn = [both.residuals()] if residuals else both.figures()
        pictures = [picture_of(one) for one in drawn if one is not None]
    return [one._asdict() for one in pictures if one is not None]


def _sections(diagnosis: Diagnosis, both: _Beside, page: Page, title: str, command: str) -> Iterator[str]:
    data = diagnosis_data(diagnosis)
    yield _head(diagnosis, title)
    yield _where(diagnosis, page)
    yield what_is_missing(diagnosis, data, both.speeds)
    yield from missing_signals(diagnosis, page)
    yield _before_and_after(diagnosis, both, page)
    yield fits_table(diagnosis, independent=diagnosis.evidence.independent and both.residuals is not None)
    yield page.picture(both.residuals)
    yield rivals_tables(diagnosis)
    yield _parameters(diagnosis, data["parameters"]["before"], data["parameters"]["after"], page)
    yield f"<h2>Next experiment</h2>\n{paragraph(_sentence(diagnosis.next_experiment))}"
    if data["warnings"]:
        yield f"<h3>Warnings</h3>\n<ul>{''.join(f'<li>{escape(text)}</li>' for text in data['warnings'])}</ul>"
    yield provenance(diagnosis, command)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _runs(diagnosis: Diagnosis) -> str:
    return "hold-out runs" if diagnosis.held_out else "leave-one-out cross-validation"


def _head(diagnosis: Diagnosis, title: str) -> str:
    words, colour = VERDICT_WORDS[diagnosis.verdict]
    words = UNJUDGED if diagnosis.verdict == "not_identifiable" and not diagnosis.effects else words
    return (
        f"<h1>{escape(title)}</h1>\n"
        f'<div class="verdict" style="border-color:{colour}"><b style="color:{colour}">{escape(words)}</b>'
        f"{escape(_verdict(diagnosis))}</div>\n{paragraph(diagnosis.statement)}"
    )


def _verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    scores, runs = (diagnosis.score_before.total, diagnosis.score_after.total), _runs(diagnosis)
    before, after = map(percent, scores)
    if diagnosis.verdict == "consistent":
        return (
            f"The diagram explains the recording within its noise{f'; its error is {before} in {runs}' * bool(before)}."
        )
    if not diagnosis.effects and diagnosis.verdict == "not_identifiable":
        return "The diagram explains the recording within its noise, which does not say that nothing is missing."
    if diagnosis.verdict == "outside_catalogue":
        place = f"; it acts most likely at {diagnosis.places[0].words}" if diagnosis.places else ""
        return f"No fault candidate of the catalogue explains the residual{place}."
    effects = ", and ".join(
        " or ".join(f"{plain_words(name)} at {effect.spot_of(name)}" for name in effect.members)
        for effect in diagnosis.effects
    )
    said = f"The diagram lacks {effects}"
    if before and after:
        falls = "falls" if (scores[1] or 0) < (scores[0] or 0) else "goes"
        said += f"; with it the error in {runs} {falls} from {before} to {after}"
    if diagnosis.proof is not None and diagnosis.proof.status == "unproved":
        said += f"; in {runs} this is unproved"
    return f"{said}."


def _where(diagnosis: Diagnosis, page: Page) -> str:
    parts = ["<h2>Where</h2>"]
    given = _loaded(diagnosis.evidence, values_in(diagnosis.before.document, diagnosis.before.values))
    if given is not None:
        made = places_figure(given, diagnosis.places, diagnosis.evidence.recorded)
        parts.append(page.figure(Drawn("where", made, "Places where faults were tried, by the best fault at each.")))
    if diagnosis.places:
        parts.append(
            table(["place", "probability"], [[one.words, f"{one.probability:.2f}"] for one in diagnosis.places[:10]])
        )
    repaired = _loaded(diagnosis.evidence, repaired_document(diagnosis))
    if repaired is not None:
        parts.append(_diagram(diagnosis, repaired, page))
    return "\n".join(parts)


def _loaded(evidence: Evidence, document: Mapping[str, Any]) -> Diagram | None:
    try:
        return evidence.load(document)
    except RotorsimError:
        return None


def _diagram(diagnosis: Diagnosis, repaired: Diagram, page: Page) -> str:
    new = [effect.candidate.insertion.name for effect in diagnosis.effects]
    svg = block_diagram(repaired, diagnosis.places, new, diagnosis.signals)
    page.write("diagram.svg", svg)
    frames = {colour: f"probability {least:g} and more" if least else "less probable" for least, colour in SHADES}
    key = "".join(
        f'<span class="key" style="border-color:{colour}"></span>{escape(text)}'
        for colour, text in {**frames, NEW: "put in by the diagnosis"}.items()
    )
    what = "Frames, and wires with a letter for their class of places" if diagnosis.signals else "Frames"
    caption = f"The {looks_of(diagnosis)[-1].label}. " + (f"{what}:{key}" if diagnosis.places or new else "")
    return f'<figure class="wide">{svg}<figcaption>{caption}</figcaption></figure>'


def _before_and_after(diagnosis: Diagnosis, both: _Beside, page: Page) -> str:
    looks, scores, kind = looks_of(diagnosis), (diagnosis.score_before, diagnosis.score_after), _runs(diagnosis)
    parts = [f"<h2>{'Fit' if is_unchanged(diagnosis) else 'Before and after'}, {kind}</h2>"]
    floor = {**scores[0].floor, **scores[1].floor}
    rows = []
    for name in [name for name in scores[0].ports if name] or [name for name in scores[1].ports if name]:
        errors = [percent(score.ports.get(name)) or "no settled motion" for score in scores[: len(looks)]]
        rows.append([name, *errors, percent(floor.get(name))])
    if rows:
        parts.append(table(["error of", *(look.label for look in looks), "noise floor"], rows, right=range(1, 4)))
        parts.append(paragraph(ERROR, small=True))
    if diagnosis.proof is not None:
        parts.append(paragraph(_sentence(f"{diagnosis.proof.status} on {kind}: {diagnosis.proof.reason}")))
    figures = [page.picture(one) for one in both.figures]
    if figures and not diagnosis.held_out:
        parts.append(paragraph("There were no hold-out runs: the figures show fitted runs."))
    return "\n".join([*parts, *figures])


def _parameters(
    diagnosis: Diagnosis, before: Mapping[str, Mapping[str, Any]], after: Mapping[str, Mapping[str, Any]], page: Page
) -> str:
    looks = looks_of(diagnosis)
    both = (before, after)[: len(looks)]
    rows = [
        [name, *(cell for some in both for cell in (estimate(some[name]) if name in some else ("", "")))]
        for name in {**before, **after}
    ]
    header = ["parameter", *(text for look in looks for text in (look.label, "90 % interval"))]
    made = parameters_figure(before, after, looks) if len(looks) > 1 else None
    drawn = Drawn("parameters", made, "What the missing physics had been taken for.")
    return "\n".join(["<h2>Identified parameters</h2>", table(header, rows, right=range(1, 5)), page.figure(drawn)])
