"""The report of a diagnosis: one HTML file that holds everything, and its figures as PNG beside it."""

from __future__ import annotations

import base64
import io
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from rotorsim.diagnosis.catalogue.values import values_in
from rotorsim.diagnosis.conclude.conclusions import Diagnosis, Effect
from rotorsim.diagnosis.evidence.harmonic import Fit
from rotorsim.diagnosis.files import diagnosis_data, repaired_document
from rotorsim.diagnosis.search.trials import Candidate, Round
from rotorsim.diagram.diagram import Diagram
from rotorsim.errors import RotorsimError, escape
from rotorsim.files import write_atomically
from rotorsim.report.diagnosis.comparison import Pair, fitted_pair, held_pair, labels_of, traces
from rotorsim.report.diagnosis.evidence import parameters_figure, residuals_figure, traces_figure
from rotorsim.report.diagnosis.figures import orbits_figure, spectra_figure, speed_curves_figure
from rotorsim.report.diagnosis.places import NEW, SHADES, block_diagram, places_figure
from rotorsim.report.diagnosis.tables import (
    CRITERION,
    EVIDENCE,
    STYLE,
    VERDICTS,
    Right,
    estimate,
    flat,
    own_parameters,
    percent,
    plain_words,
    provenance,
    quantity,
    table,
    why_lost,
)
from rotorsim.report.style import rpm, styled

__all__ = ["save_report"]

REPORT = "report.html"
RIVALS = 15  # rows of a table of evidence


def save_report(found: Diagnosis, folder: str | Path, *, command: str | None = None) -> list[Path]:
    """Write report.html and its figures as PNG (the diagram as SVG) into a folder; return the files.

    command: what made the diagnosis (default: the command line of rotorsim, if this is one).
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    page = _Page(found, folder)
    text = page.html(_command() if command is None else command)
    write_atomically(folder / REPORT, text)
    return [folder / REPORT, *page.files]


def _command() -> str:
    name = Path(sys.argv[0]).stem
    return shlex.join(["rotorsim", *sys.argv[1:]]) if name in ("rotorsim", "__main__") else ""


class _Page:
    def __init__(self, found: Diagnosis, folder: Path) -> None:
        self.found, self.folder = found, folder
        self.data = diagnosis_data(found)
        self.files: list[Path] = []
        self.source: Any = found.source
        self.labels = labels_of(found)
        self.same = not found.effects and found.after is found.before
        self.name = str(found.document.get("name", "diagram"))
        recording = getattr(self.source, "recording", None)
        self.recording = "" if recording is None else str(recording.name)

    def html(self, command: str) -> str:
        """Return the page; figures are written as they are made."""
        title = f"Diagnosis of {self.name}" + (f" from {self.recording}" if self.recording else "")
        fitted = fitted_pair(self.found)
        shown = held_pair(self.found) if any(part.harmonics for part in self.found.held) else fitted
        parts = [
            self._head(title),
            self._where(),
            self._what(),
            self._before_and_after(shown, fitted),
            self._evidence(fitted),
            self._parameters(),
            self._next(),
            f"<h2>Provenance</h2>\n{provenance(self.found, command)}",
        ]
        body = "\n".join(part for part in parts if part)
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
        )

    # -- sections ------------------------------------------------------------------------------------------------------

    def _head(self, title: str) -> str:
        words, colour = VERDICTS[self.found.verdict]
        sentence = self._sentence()
        return (
            f"<h1>{escape(title)}</h1>\n"
            f'<div class="verdict" style="border-color:{colour}"><b style="color:{colour}">{escape(words)}</b>'
            f"{escape(sentence)}</div>\n<p>{escape(self.found.statement)}</p>"
        )

    def _sentence(self) -> str:
        """Return the verdict in one sentence."""
        found = self.found
        before, after = (percent(score.total) for score in (found.score_before, found.score_after))
        runs = "on held-out runs" if found.held else "on runs left out one by one"
        if found.verdict == "consistent":
            error = f"; its error is {before} {runs}" if before else ""
            return f"The diagram explains the recording within its noise{error}."
        if found.verdict == "outside_catalogue":
            place = f"; it acts most likely at {found.places[0][0]}" if found.places else ""
            return f"No effect of the catalogue explains what the diagram leaves over{place}."
        effects = ", and ".join(
            " or ".join(f"{plain_words(name)} at {effect.spot_of(name)}" for name in effect.members)
            for effect in found.effects
        )
        lower = before and after and (found.score_after.total or 0) < (found.score_before.total or 0)
        falls = f"; with it the error {runs} {'falls' if lower else 'goes'} from {before} to {after}"
        unproved = found.proof is not None and found.proof.status == "unproved"
        said = (falls if before and after else "") + (f"; {runs} this is unproved" if unproved else "")
        return f"The diagram lacks {effects}{said}."

    def _where(self) -> str:
        found, parts = self.found, ["<h2>Where</h2>"]
        given = self._load(values_in(found.before.document, found.before.values))
        if given is not None:
            made = places_figure(given, found.places, getattr(self.source, "recorded", ()))
            parts.append(self._figure("where", made, "Places that faults were tried at, by the best fault at each."))
        if found.places:
            rows = [[str(spot), f"{p:.2f}"] for spot, p in found.places[:10]]
            parts.append(table(["place", "probability"], rows))
        repaired = self._load(repaired_document(found))
        if repaired is not None:
            new = [effect.candidate.insertion.name for effect in found.effects]
            parts.append(self._diagram(repaired, new))
        return "\n".join(parts)

    def _diagram(self, repaired: Diagram, new: Sequence[str]) -> str:
        svg = block_diagram(repaired, self.found.places, new)
        file = self.folder / "diagram.svg"
        write_atomically(file, svg)
        self.files.append(file)
        key = "".join(
            f'<span class="key" style="border-color:{colour}"></span>{escape(text)}'
            for colour, text in (
                *(
                    (colour, f"probability {least:g} and more" if least else "less probable")
                    for least, colour in SHADES
                ),
                (NEW, "put in by the diagnosis"),
            )
        )
        what = "The diagram as given" if self.same else f"The {self.labels['after']}"
        caption = f"{escape(what)}. " + (f"Frames:{key}" if self.found.places or new else "")
        return f'<figure class="wide">{svg}<figcaption>{caption}</figcaption></figure>'

    def _what(self) -> str:
        found, parts = self.found, ["<h2>What</h2>"]
        if found.verdict == "consistent":
            none = "No effect of the catalogue explains more than noise would"
            parts.append(f"<p>{none}{'' if found.residual is None else ' in runs that took no part'}.</p>")
            if found.residual is not None:
                parts.append(self._residual(found.residual))
            if found.detectable:
                rows = [
                    [
                        plain_words(name),
                        plain_words(str(item.get("parameter", ""))),
                        quantity(item.get("value"), item.get("unit")),
                    ]
                    for name, item in sorted(found.detectable.items())
                ]
                parts.append("<h3>What would have been seen</h3>")
                parts.append(table(["effect", "its", "smallest size seen"], rows))
            return "\n".join(parts)
        if found.verdict == "outside_catalogue":
            parts.append(self._outside())
        for number, effect in enumerate(found.effects):
            parts.append(self._effect(effect, number))
        if found.residual is not None:
            parts.append(f"<h3>Left over</h3>{self._residual(found.residual)}")
        if found.open:
            parts.append("<h3>Tried, but not fitted to the end: not rejected</h3>")
            parts.append(table(["effect", ""], [[plain_words(name), why] for name, why in found.open]))
        return "\n".join(parts)

    def _outside(self) -> str:
        text = str(self.found.outside.get("description", ""))
        speeds = [float(rpm(item.fit.speed)) for item in getattr(self.source, "harmonics", ())]
        rows = [[name, value] for name, value in flat(self.found.outside, speeds=speeds) if name != "description"]
        parts = [f"<p>{escape(text)}</p>"] if text else []
        if rows:
            parts.append(table(["of the unknown force", ""], rows))
        if self.found.effects:
            parts.append("<p>The nearest effects of the catalogue, which do not explain it:</p>")
        return "\n".join(parts)

    def _effect(self, effect: Effect, number: int) -> str:
        insertion, fault = effect.candidate.insertion, effect.candidate.insertion.fault
        place = f" at {effect.spot_of(effect.physics)}"
        parts = [f"<h3>{escape(plain_words(effect.physics))}{escape(place)}</h3>"]
        values = self._values(self.found.after)
        rows = [[name.rpartition(".")[2], *estimate(values[name])] for name in insertion.free if name in values]
        if rows:
            parts.append(table(["parameter", "value", "90 % interval"], rows))
        told = [
            ("law", fault.law),
            ("block", f"{insertion.name} ({insertion.kind.type_name})"),
            ("source", fault.source),
            ("explains", self._share(number)),
        ]
        parts.append(table(["", ""], [[name, text] for name, text in told if text], head=False))
        if len(effect.members) > 1:
            parts.append("<p>These explain the data as well:</p>")
            rows = []
            for name, probability in effect.members.items():
                rival = effect.rivals.get(name)
                own = effect.candidate if name == effect.physics else rival
                fit = self.found.after if name == effect.physics else None if rival is None else rival.fit
                text = "" if own is None or fit is None else own_parameters(own, fit)
                rows.append([plain_words(name), f"{probability:.2f}", str(effect.spot_of(name) or ""), text])
            parts.append(table(["effect", "probability", "at", "with"], rows))
            if fault.told_apart_by:
                parts.append(f"<p>Told apart by: {escape(fault.told_apart_by)}.</p>")
        return "\n".join(parts)

    def _residual(self, residual: Mapping[str, Any]) -> str:
        """Return a table of what is left over beyond noise."""
        rows = [
            ["share of what was to be explained", percent(residual["share"])],
            ["variance left / noise", f"{residual['excess_variance']:.3g}"],
        ]
        if residual["place"] is not None:
            place, size = residual["place"], residual["size"]
            node = "" if place["node"] is None else f"[{place['node']}]"
            rows.append(["acts most likely at", f"{place['block']}.{place['port']}{node}"])
            rows.append(["its size there, rms", quantity(size["value"], size["unit"], 2)])
            sizes = ", ".join(f"{k}X {quantity(value, size['unit'], 2)}" for k, value in size["orders"].items())
            rows.append(["of orders, rms", sizes])
        return table(["", ""], rows, head=False)

    def _share(self, number: int) -> str:
        """Return the share that an effect explains with its interval, as diagnosis.json has it."""
        missing = self.data["missing"]
        item = missing[number].get("explained") if number < len(missing) else None
        if item is None:
            return ""
        ends = item["interval90"]
        between = "" if ends is None else f" ({percent(ends[0])} to {percent(ends[1])})"
        return f"{percent(item['share'])}{between} of what could be explained there, in runs that took no part"

    def _before_and_after(self, shown: Pair | None, fitted: Pair | None) -> str:
        found = self.found
        scores = found.score_before, found.score_after
        kind = "held-out runs" if found.held else "runs left out one by one"
        parts = [f"<h2>{'Fit' if self.same else 'Before and after'}, {kind}</h2>"]
        ports = [name for name in scores[0].ports if name] or [name for name in scores[1].ports if name]
        rows: list[list[str | Right]] = []
        for name in ports:
            errors = [
                percent(score.ports.get(name)) or "no settled motion" for score in scores[: 1 if self.same else 2]
            ]
            floor = percent({**scores[0].floor, **scores[1].floor}.get(name))
            rows.append([name, *(Right(text) for text in (*errors, floor))])
        if rows:
            names = [self.labels["before"]] if self.same else [self.labels["before"], self.labels["after"]]
            parts.append(table(["error of", *names, "noise"], rows))
            note = "Root mean square of what is left over, in parts of the signal about its mean."
            parts.append(f'<p class="small">{note}</p>')
        if found.proof is not None:
            said = f"{found.proof.status[:1].upper()}{found.proof.status[1:]} on {kind}: {found.proof.reason}."
            parts.append(f"<p>{escape(said)}</p>")
        in_time = traces(found)
        if in_time:
            made = traces_figure(in_time, self.labels, self.same)
            parts.append(self._figure("traces", made, "The stretch that the diagram as given explains least."))
        if shown is None:
            return "\n".join(parts)
        if not found.held:
            parts.append("<p>There were no held-out runs: the figures show runs that were fitted.</p>")
        figures: list[tuple[str, Callable[[], Figure | None], str]] = [
            (
                "spectra",
                lambda: spectra_figure(shown),
                "Full spectra: what noise alone would give is grey; crosses below it are explained. Small marks, where "
                "there are any: lines beside the harmonics, at kX + nu.",
            ),
            (
                "orbits",
                lambda: orbits_figure(shown),
                "Motion that is synchronous with the shaft, over one turn; the arrow shows its direction.",
            ),
            (
                "speed_curves",
                lambda: speed_curves_figure(shown, fitted),
                "Amplitude and phase against shaft angle zero over speed, for each set of settings; "
                "thin lines: beyond the held-out speeds.",
            ),
        ]
        for name, make, caption in figures:
            made_one = make()
            if made_one is not None:
                parts.append(self._figure(name, made_one, caption))
        return "\n".join(parts)

    def _evidence(self, fitted: Pair | None) -> str:
        found = self.found
        fits = [(self.labels["before"], found.before), (self.labels["after"], found.after)]
        rows: list[list[str | Right]] = []
        for name, fit in fits[: 1 if self.same else 2]:
            left = f"{fit.misfit / fit.freedom:.3g}"
            probability = f"{fit.goodness:.2g}" if fit.goodness > 1e-12 else "< 1e-12"
            numbers = f"{fit.misfit:.4g}", str(fit.freedom), left, f"{fit.left_out.sum():.4g}", probability
            rows.append([name, *map(Right, numbers if fitted is not None else numbers[:-1])])
        header = ["", "misfit", "freedom", "variance left / noise", "misfit, runs left out", "probability"]
        note = EVIDENCE if fitted is not None else EVIDENCE.partition(" Probability")[0]
        header = header if fitted is not None else header[:-1]  # samples in time are not independent
        parts = ["<h2>Evidence</h2>", table(header, rows), f'<p class="small">{note}</p>']
        if fitted is not None:
            made = residuals_figure(fitted)
            parts.append(
                self._figure("residuals", made, "White is what noise alone makes; 2 is exceeded in 2 % of cases.")
            )
        reasons = dict(found.rejected)
        for number, item in enumerate(found.named.rounds, 1):
            if number > 1 and number > len(found.searched):
                break
            parts.append(self._rivals(item, number, reasons if number == 1 else {}))
        return "\n".join(parts)

    def _rivals(self, item: Round, number: int, reasons: Mapping[str, str]) -> str:
        effects = self.found.searched
        best: dict[str, Candidate] = {}
        for candidate in item.tried:
            best.setdefault(candidate.insertion.physics, candidate)
        kept = effects[number - 1] if number <= len(effects) else None
        base = kept.candidate.fit.criterion if kept is not None else item.before.criterion
        rows: list[list[str | Right]] = []
        for name, candidate in list(best.items())[:RIVALS]:
            fit = candidate.fit
            why = ""
            if kept is not None and name in kept.members:
                chosen = "nearest" if self.found.verdict == "outside_catalogue" else "kept"
                why = chosen if name == kept.physics else "explains the data as well"
            elif not candidate.final:
                why = "not fitted to the end: not rejected"
            elif kept is not None:
                why = why_lost(fit, kept.candidate.fit, reasons.get(name, ""))
            if fit.failure:
                rows.append(
                    [
                        plain_words(name),
                        str(candidate.insertion.spot),
                        *map(Right, ("", "", "", "")),
                        why or fit.failure,
                    ]
                )
                continue
            numbers = (
                str(len(candidate.parameters)),
                f"{fit.misfit / fit.freedom:.3g}",
                f"{fit.left_out.sum():.4g}",
                f"{fit.criterion - base:+.4g}",
            )
            rows.append([plain_words(name), str(candidate.insertion.spot), *map(Right, numbers), why])
        if not rows:
            return ""
        others = [effect.physics for k, effect in enumerate(effects) if k != number - 1]
        beside = f", beside {', '.join(map(plain_words, others))}" if len(effects) > 1 else ""
        against = "the one kept" if kept is not None else "the diagram as given"
        header = [
            "effect, at its best place",
            "at",
            "parameters",
            "variance left / noise",
            "misfit, runs left out",
            f"criterion against {against}",
            "why it lost",
        ]
        if not any(row[-1] for row in rows):
            header, rows = header[:-1], [row[:-1] for row in rows]
        tried = len({(c.insertion.physics, c.insertion.spot) for c in item.tried})
        title = f"<h3>Rivals{escape(beside)}: the {len(rows)} nearest of {tried} tried</h3>"
        note = f'<p class="small">{CRITERION}</p>' if number == 1 else ""
        return f"{title}\n{table(header, rows)}\n{note}"

    def _values(self, fit: Fit) -> dict[str, Mapping[str, Any]]:
        """Return the parameters of a fit with their intervals, marked where they stand at a bound."""
        values: Mapping[str, Mapping[str, Any]] = self.data["parameters"][
            "before" if fit is self.found.before else "after"
        ]
        return dict(values)

    def _parameters(self) -> str:
        found = self.found
        before, after = self._values(found.before), self._values(found.after)
        rows: list[list[str | Right]] = []
        for name in {**before, **after}:
            cells = [estimate(some[name]) if name in some else ["", ""] for some in (before, after)]
            rows.append([name, *map(Right, cells[0] if self.same else [*cells[0], *cells[1]])])
        header = ["parameter", "value", "90 % interval"]
        if not self.same:
            header = ["parameter", self.labels["before"], "90 % interval", self.labels["after"], "90 % interval"]
        parts = ["<h2>Identified parameters</h2>", table(header, rows)]
        if not self.same:
            made = parameters_figure(before, after, self.labels)
            if made is not None:
                parts.append(self._figure("parameters", made, "What the missing physics had been taken for."))
        return "\n".join(parts)

    def _next(self) -> str:
        parts = [
            "<h2>Next experiment</h2>",
            f"<p>{escape(self.found.next_experiment[:1].upper() + self.found.next_experiment[1:])}.</p>",
        ]
        if self.data["warnings"]:
            parts.append("<h3>Warnings</h3>")
            parts.append("<ul>" + "".join(f"<li>{escape(str(text))}</li>" for text in self.data["warnings"]) + "</ul>")
        return "\n".join(parts)

    # -- parts ---------------------------------------------------------------------------------------------------------

    def _load(self, document: Mapping[str, Any]) -> Diagram | None:
        try:
            loaded: Diagram = self.source.load(document)
        except (RotorsimError, AttributeError):
            return None
        return loaded

    def _figure(self, name: str, made: Figure, caption: str) -> str:
        """Write a figure as PNG and return it for the page, with its pixels inside."""
        buffer = io.BytesIO()
        with styled():
            made.savefig(buffer, format="png", dpi=130)
        pixels = buffer.getvalue()
        file = self.folder / f"{name}.png"
        write_atomically(file, pixels)
        self.files.append(file)
        title = " ".join(str(made.get_suptitle()).split())
        text = base64.b64encode(pixels).decode("ascii")
        return (
            f'<figure><img alt="{escape(title)}" src="data:image/png;base64,{text}">'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
        )
