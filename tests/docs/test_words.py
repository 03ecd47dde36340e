"""The pages use the words of the glossary, and the glossary has those of the field that the program uses."""

from __future__ import annotations

import re

import pytest

from tests.docs.pages import FENCE, ROOT, page_text

GENERATED = {"docs/blocks.md", "docs/glossary.md"}  # the glossary names the words that are not used
PAGES = sorted({"README.md", "CONTRIBUTING.md", *(str(f.relative_to(ROOT)) for f in (ROOT / "docs").glob("*.md"))})
NOT_USED = re.compile(
    r"\b(left over|leaves? over|t(?:old|ells?) apart|rows? of the catalogue|slopes? (?:of|by)|second frequency"
    r"|(?:runs|stretches) left out|took no part|take no part|does not follow the shaft|do not follow the shaft)\b"
)
TERMS = """residual, residual variance, misfit, noise level, degrees of freedom, fault candidate, fault catalogue,
isolable, detectable, Jacobian, sensitivity, hold-out run, asynchronous frequency, quantisation step, lower bound of
the misfit, forward selection, selection result, equivalence class, rival, periodic solution, harmonic balance,
continuation, Floquet multiplier, covariance, whitening, likelihood, profile likelihood, confidence interval, prior,
bootstrap, slow roll, runout, turn, order, forward, participant, master, communication point, extrapolation, Picard,
start value, nominal value, tunable parameter, direct feedthrough, algebraic loop, mains hum, cross-talk, drift,
outlier, dropped samples, saturation, model error, unknown force"""


@pytest.mark.parametrize("page", [page for page in PAGES if page not in GENERATED])
def test_pages_use_the_words_of_the_field(page: str) -> None:
    text = " ".join(FENCE.sub("", page_text(page)).split())
    assert [match[0] for match in NOT_USED.finditer(text)] == []


def test_the_glossary_defines_each_term_once_and_names_what_is_not_used() -> None:
    text, _, not_used = page_text("docs/glossary.md").partition("## Words that are not used")
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    terms = [cells[0] for cells in rows if cells[0] != "term"]
    assert len(terms) > 80
    assert sorted(set(terms)) == sorted(terms)
    named = " ".join(terms).lower()
    assert [term for term in " ".join(TERMS.split()).split(", ") if term.lower() not in named] == []
    assert [term for term in terms if not rows[[r[0] for r in rows].index(term)][1].strip()] == []
    assert all(
        word in not_used for word in ("left over", "row of the catalogue", "told apart", "slope", "second frequency")
    )
