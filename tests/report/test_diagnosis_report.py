"""The report of a diagnosis: what stands in it, that nothing of a user's is taken for HTML, and what figures show."""

from __future__ import annotations

import base64
import io
import re
import tempfile
from contextlib import nullcontext
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from matplotlib.patches import Rectangle

from rotorsim.diagnosis.catalogue.insertion import Spot
from rotorsim.diagnosis.diagnosis import Diagnosis, diagnose
from rotorsim.diagnosis.evidence.missing_signal import PlaceClass
from rotorsim.diagnosis.files import diagnosis_data
from rotorsim.errors import RotorsimError
from rotorsim.jobs.jobs import Jobs, local_workers
from rotorsim.model.load import load
from rotorsim.recordings.recording import Recording
from rotorsim.report import provenance
from rotorsim.report.amplitudes import amplitudes
from rotorsim.report.comparison import speed_curves
from rotorsim.report.comparison.harmonics import Comparison
from rotorsim.report.comparison.speed_curves import speed_curve
from rotorsim.report.diagnosis.compared import GIVEN, REPAIRED, OfHarmonics, OfResonances, compared
from rotorsim.report.diagnosis.parameters import parameters_figure
from rotorsim.report.diagnosis.places import NEW, SHADES, block_diagram, places_figure
from rotorsim.report.diagnosis.report import save_report
from rotorsim.report.diagnosis.rivals import rivals_tables
from rotorsim.report.diagnosis.words import estimate, flat
from rotorsim.report.figures.orbits import orbits_figure
from rotorsim.report.figures.spectra import residuals_figure, spectra_figure
from rotorsim.report.figures.speed_curves import speed_curves_figure
from tests.diagnosis.evidence.waveform.machines import OSCILLATOR
from tests.diagnosis.test_diagnosis import HELD, SPEEDS, recording
from tests.identification import OTHER_GAINS, changed, shipped
from tests.report import undrawn

FIGURES = {"where.png", "spectra.png", "orbits.png", "speed_curves.png", "residuals.png", "parameters.png"}
NASTY = "<script>alert('x')</script> & \"y\""
VOID = {"meta", "img", "br"}


@cache
def bowed() -> Diagnosis:
    measured, held = (
        recording(True, speeds, seed, all_gains=(OTHER_GAINS,)) for speeds, seed in ((SPEEDS, 1), (HELD, 50))
    )
    return diagnose(shipped("jeffcott"), measured, hold_out=held, physics=("residual_bow", "runout"), workers=1)


@cache
def healthy() -> Diagnosis:
    return diagnose(shipped("jeffcott"), recording(False, SPEEDS[:2]), physics=("residual_bow",), workers=1)


@cache
def nasty() -> Diagnosis:
    """Return a diagnosis whose names would be HTML if they were not escaped."""

    def rename(document: dict[str, Any]) -> None:
        document["name"] = NASTY

    measured = recording(True, SPEEDS, all_gains=(OTHER_GAINS,))
    named = Recording(NASTY, NASTY, measured.folder, measured.channels, measured.runs, measured.warnings)
    found = diagnose(changed("jeffcott", rename), named, physics=("residual_bow",), workers=1)
    return replace(found, statement=NASTY, next_experiment=NASTY)


class _Page(HTMLParser):
    """Reads a page and notes tags that do not match, images, and what is loaded from elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.wrong: list[str] = []
        self.images: list[str] = []
        self.outside: list[str] = []
        self.scripts = 0
        self.words: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self._note(tag, attrs)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._note(tag, attrs)

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open[-1] != tag:
            self.wrong.append(tag)
        else:
            self.open.pop()

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.words.append(data)

    def _note(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.scripts += tag == "script"
        for name, value in attrs:
            if tag == "img" and name == "src":
                self.images.append(value or "")
            elif name in ("src", "href", "xlink:href"):
                self.outside.append(value or "")
            assert not name.startswith("on"), (tag, name)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@cache
def _reported(which: str, drawn: bool = True) -> tuple[_Page, dict[str, bytes], tuple[str, ...]]:
    with tempfile.TemporaryDirectory() as folder, nullcontext() if drawn else undrawn():
        found = {"bowed": bowed, "healthy": healthy, "nasty": nasty}[which]()
        files = save_report(found, folder, command="rotorsim diagnose jeffcott <b>there</b> --hold-out 'a b'")
        assert all(file.is_file() for file in files)
        page = _Page(files[0].read_text(encoding="utf-8"))
        return page, {f.name: f.read_bytes() for f in Path(folder).iterdir()}, tuple(f.name for f in files)


@pytest.mark.slow
@pytest.mark.parametrize("which", ["bowed", "healthy", "nasty"])
def test_one_valid_file_that_needs_no_other(which: str) -> None:
    page, files, names = _reported(which)
    assert page.wrong == []
    assert page.open == []
    assert page.outside == []
    assert page.scripts == 0
    assert names[0] == "report.html"
    assert set(names) == set(files)
    pictures = [name for name in names if name.endswith(".png")]
    assert len(page.images) == len(pictures) >= 5
    for source, name in zip(page.images, pictures, strict=True):
        head, _, code = source.partition(",")
        assert head == "data:image/png;base64"
        assert base64.b64decode(code, validate=True) == files[name]
        pixels = matplotlib.image.imread(io.BytesIO(files[name]))
        assert min(pixels.shape[:2]) > 200
        assert np.ptp(pixels) > 0.5  # something is drawn


@pytest.mark.slow
def test_what_a_user_wrote_is_text() -> None:
    page, files, _ = _reported("nasty", drawn=False)
    assert b"<script" not in files["report.html"]
    assert page.text.count(NASTY) >= 5  # title, diagram, statement, recording, next experiment
    assert "rotorsim diagnose jeffcott <b>there</b> --hold-out 'a b'" in page.text


@pytest.mark.slow
def test_numbers_are_those_of_the_diagnosis() -> None:
    page, files, _ = _reported("bowed", drawn=False)
    found = bowed()
    data = diagnosis_data(found)
    assert set(files) == FIGURES | {"report.html", "diagram.svg"}
    before, after = (100 * data["fit"][which]["hold_out"] for which in ("before", "after"))
    sentence = "The diagram lacks residual bow at rotor.force; with it the error in hold-out runs falls from"
    assert f"{sentence} {before:.3g} % to {after:.3g} %." in page.text
    for name, score in found.score_after.ports.items():
        row = f"{name} {100 * found.score_before.ports[name]:.3g} % {100 * score:.3g} %"
        assert row in page.text
    phase = np.degrees(data["missing"][0]["parameters"]["phase"]["value"])
    shown = re.search(r"phase (-?[\d.]+) deg (-?[\d.]+) deg to (-?[\d.]+) deg", page.text)
    assert shown is not None
    low, high = (float(shown[k]) for k in (2, 3))
    assert low < phase < high
    assert abs(float(shown[1]) - phase) < 0.1 * (high - low)
    rival = next(item.fit for item in found.selection.rounds[0].tried if item.insertion.physics == "runout")
    best = found.effects[0].candidate.fit
    ratio = (rival.misfit / rival.freedom) / (best.misfit / best.freedom)
    assert ratio > 2
    assert f"residual variance {ratio:.3g} times as large" in page.text  # the rival, and why it lost


@pytest.mark.slow
def test_a_report_of_nothing_missing() -> None:
    page, files, _ = _reported("healthy", drawn=False)
    assert "Nothing is missing" in page.text
    assert "What would have been detected" in page.text
    assert "residual bow amplitude" in page.text
    assert "repaired" not in page.text.replace("repaired diagram, sha256", "")
    assert "There were no hold-out runs: the figures show fitted runs." in page.text
    assert "parameters.png" not in files


# -- figures -----------------------------------------------------------------------------------------------------------


def of_harmonics(found: Diagnosis) -> OfHarmonics:
    both = compared(found)
    assert isinstance(both, OfHarmonics)
    return both


def fitted_runs(found: Diagnosis) -> Comparison:
    fitted = of_harmonics(found).fitted
    assert fitted is not None
    return fitted


def held_runs(found: Diagnosis) -> Comparison:
    held = of_harmonics(found).held
    assert held is not None
    return held


@pytest.mark.slow
def test_the_residual_is_noise_after_and_not_before() -> None:
    """In units of the noise the squares have a mean of one: of N harmonics the mean of them scatters by sqrt(1 / N)."""
    both = fitted_runs(bowed())
    before, after = (
        np.concatenate([runs.residual(r, signal) ** 2 for signal in runs.signals for r in range(len(runs.speeds))])
        for _, runs in both.diagrams
    )
    assert len(after) > 150
    assert abs(after.mean() - 1) < 4 / np.sqrt(len(after))
    assert before.mean() > 100


@pytest.mark.slow
def test_spectra_show_measured_and_both_diagrams() -> None:
    both = held_runs(bowed())
    made = spectra_figure(both)
    labels = [text.get_text() for text in made.legends[0].get_texts()]
    assert {"diagram as given", "repaired diagram", "measured, 90 % interval"} <= set(labels)
    axes = made.axes[0]
    signal, r = both.signals[0], both.runs.spread(4)[0]
    assert signal.title in axes.get_title(loc="left")
    assert "rpm" in axes.get_title(loc="left")
    drawn = next(line for line in axes.lines if line.get_label() == "repaired diagram")
    np.testing.assert_allclose(drawn.get_ydata(), np.abs(both.runs.prediction(r, signal)) * 1e6)  # um
    np.testing.assert_array_equal(drawn.get_xdata(), both.runs.orders(signal))
    assert axes.get_yscale() == "log"


@pytest.mark.slow
def test_curves_over_speed_go_through_what_the_diagram_says_at_the_runs() -> None:
    found = bowed()
    both = held_runs(found)
    made = speed_curves_figure(both, fitted_runs(found))
    assert made is not None
    upper = made.axes[0]
    assert upper.get_title(loc="left").startswith("1X (forward)")
    line = next(line for line in upper.lines if line.get_label() == "repaired diagram")
    signal, after = both.signals[0], both.runs
    column = int(np.flatnonzero(after.orders(signal) == 1)[0])
    for r, speed in enumerate(after.speeds):
        expected = abs(after.prediction(r, signal)[column]) * 1e6
        at = np.interp(speed * 30 / np.pi, line.get_xdata(), line.get_ydata())
        assert abs(at / expected - 1) < 0.02  # between points of the curve
    speeds = [path.get_offsets() for path in upper.collections]
    assert speeds is not None
    assert {"measured, 90 % interval", "measured, fitted runs"} <= {
        text.get_text() for text in made.legends[0].get_texts()
    }


@pytest.mark.slow
def test_orbits_close_and_have_both_axes() -> None:
    made = orbits_figure(held_runs(bowed()))
    assert made is not None
    for axes in made.axes:
        line = next(line for line in axes.lines if line.get_label() == "repaired diagram")
        x, y = line.get_xdata(), line.get_ydata()
        assert np.hypot(x[-1] - x[0], y[-1] - y[0]) < 1e-9 * np.ptp(x)
        assert axes.get_xlabel() == "x [um]"
        assert axes.get_ylabel() == "y [um]"


@pytest.mark.slow
def test_without_a_motion_of_the_diagram_as_given_the_figures_show_the_other() -> None:
    both = held_runs(bowed())
    alone = replace(both, diagrams=both.diagrams[1:])
    for made in (spectra_figure(alone), orbits_figure(alone), speed_curves_figure(alone), residuals_figure(alone)):
        assert made is not None
    labels = [text.get_text() for text in spectra_figure(alone).legends[0].get_texts()]
    assert "diagram as given" not in labels


@pytest.mark.slow
def test_residuals_are_drawn_for_every_run_and_order() -> None:
    both = fitted_runs(bowed())
    made = residuals_figure(both)
    drawn = [axes.collections[0].get_array() for axes in made.axes if axes.collections and axes.get_xlabel() != ""]
    runs = len(both.runs.speeds)
    assert all(array is not None and array.shape[-1] == runs for array in drawn[:2])
    titles = [axes.get_title(loc="left") for axes in made.axes]
    assert any("diagram as given" in title for title in titles)
    assert any("repaired diagram" in title for title in titles)


def test_parameters_move_by_parts_of_the_later_value() -> None:
    def item(value: float, unit: str = "1") -> dict[str, Any]:
        return {"value": value, "interval90": [0.9 * value, 1.1 * value], "unit": unit}

    before = {"k": item(150.0), "phase": item(0.1 + 2 * np.pi, "rad"), "old": item(1.0)}
    after = {"k": item(100.0), "phase": item(0.2, "rad"), "new": item(5.0)}
    looks = GIVEN, REPAIRED
    made = parameters_figure(before, after, looks)
    assert made is not None
    left, right = made.axes
    assert [text.get_text() for text in left.get_yticklabels()] == ["k"]
    assert [text.get_text() for text in right.get_yticklabels()] == ["phase"]
    places = [float(box.lines[0].get_xdata()[0]) for box in left.containers]
    assert places == pytest.approx([50.0, 0.0])
    turned = [float(box.lines[0].get_xdata()[0]) for box in right.containers]
    assert turned == pytest.approx([np.degrees(-0.1), 0.0])
    assert parameters_figure({}, after, looks) is None


def test_a_parameter_at_its_bound_has_no_interval_and_is_nothing_to_compare_with() -> None:
    """FAULT: a stiffness of 2 nN/m at its bound made the axis reach to 600 000 %."""
    low = {"value": 2e-9, "interval90": [2e-9, 2e-9], "unit": "N/m", "at_bound": True}
    free = {"value": 1e5, "interval90": [0.5e5, 1.5e5], "unit": "N/m"}
    made = parameters_figure({"k": free, "c": low}, {"k": low, "c": low}, (GIVEN, REPAIRED))
    assert made is not None
    [axes] = made.axes
    assert [text.get_text() for text in axes.get_yticklabels()] == ["k"]  # c says nothing
    assert [float(box.lines[0].get_xdata()[0]) for box in axes.containers] == pytest.approx([0.0, -100.0])
    assert "repaired diagram, at its bound" in [text.get_text() for text in made.legends[0].get_texts()]
    assert estimate(low) == ["2 nN/m", "at its bound"]


def test_a_large_change_is_written_at_the_edge() -> None:
    before = {"k": {"value": 55.0, "interval90": [54.0, 56.0], "unit": "1"}}
    after = {"k": {"value": 1.0, "interval90": [0.9, 1.1], "unit": "1"}}
    made = parameters_figure(before, after, (GIVEN, REPAIRED))
    assert made is not None
    [axes] = made.axes
    assert axes.get_xlim()[1] == 150.0
    assert [text.get_text() for text in axes.texts] == ["+5.4e+03 % "]


def test_an_unknown_force_is_told_with_units_and_speeds() -> None:
    data = {
        "orders": {"1": 0.178},
        "work_per_turn": [-1.6e-6, 2e-9],
        "map": {"terms": {"cubic": 2e9}, "explains": 0.357},
    }
    assert flat(data, speeds=[2408.0, 122.0]) == [
        ("orders [N, 0-peak]", "1X 0.178"),
        ("work per turn", "122 rpm: 2 nJ, 2408 rpm: -1.6 uJ"),
        ("map: cubic", "2e+09 N/m^3"),
        ("map: explains", "35.7 % of the misfit"),
    ]


def test_places_stand_at_their_nodes() -> None:
    probes = [f"rotor.displacement[{node},{axis}]" for node in (2, 4) for axis in (1, 2)]
    pairs = (Spot("rotor", "force", 4), 0.7), (Spot("rotor", "displacement", 2), 0.2), (Spot("amb", "force"), 0.1)
    places = [PlaceClass((spot,), probability) for spot, probability in pairs]
    made = places_figure(shipped("fe_rigid"), places, probes)
    bars = {round(p.get_height(), 3): p for axes in made.axes for p in axes.patches if isinstance(p, Rectangle)}
    assert bars[0.7].get_x() < 0.3 < bars[0.7].get_x() + bars[0.7].get_width()  # node 4 of elements of 100 mm
    assert abs(bars[0.2].get_x() + bars[0.2].get_width() / 2 - 0.1) < bars[0.2].get_width()  # beside bars of the force
    texts = [text.get_text() for axes in made.axes for text in axes.texts]
    assert texts.count("probe") == 2
    assert "amb" in texts
    assert any("amb.force" in label.get_text() for axes in made.axes for label in axes.get_yticklabels())


@pytest.mark.parametrize("name", ["jeffcott", "offset_disc", "fe_rigid", "fe_flexible", "two_amb_rotor", "drawn_rotor"])
def test_every_machine_is_drawn(name: str) -> None:
    made = places_figure(shipped(name), [], ["rotor.displacement[1]"])
    assert made.axes[0].patches
    assert made.get_suptitle() == "The machine as the diagram has it; no place is suspect"


def test_a_diagram_without_a_rotor_has_no_machine_to_draw() -> None:
    assert places_figure(load(OSCILLATOR), [PlaceClass((Spot("spring", "force"),), 0.8)], []) is None


def test_blocks_are_framed_by_probability() -> None:
    pairs = (Spot("rotor", "force"), 0.9), (Spot("amb", "force"), 0.2), (Spot("clock", "theta"), 0.01)
    places = [PlaceClass((spot,), probability) for spot, probability in pairs]
    svg = block_diagram(shipped("jeffcott"), places, ["bus"])
    frames = dict(re.findall(r'stroke="(#[0-9a-f]+)" stroke-width="3.0"/>\n<text[^>]*>(\w+)<', svg, re.IGNORECASE))
    assert {name: colour for colour, name in frames.items()} == {
        "rotor": SHADES[0][1],
        "amb": SHADES[1][1],
        "clock": SHADES[2][1],
        "bus": NEW,
    }


def test_rivals_are_compared_with_what_was_tried_beside_them():
    """FAULT: after the noise was measured anew, the criterion of the one kept stood thousands off its rivals."""
    found = bowed()
    effect = found.effects[0]
    quieter = replace(effect.candidate, fit=replace(effect.candidate.fit, misfit=effect.candidate.fit.misfit / 10))
    anew = replace(found, effects=(replace(effect, candidate=quieter), *found.effects[1:]))
    assert rivals_tables(anew) == rivals_tables(found)
    assert ">+0<" in rivals_tables(anew)


def test_curves_over_speed_pass_through_the_motion_of_the_runs() -> None:
    both = held_runs(bowed())
    signal, repaired = both.signals[0], both.runs
    orders = np.array([1, 2])
    every = repaired.orders(signal).tolist()
    for group, runs in repaired.groups.items():
        curve = speed_curve(repaired, group, signal, orders)
        assert curve is not None
        speeds, values = curve
        for r in runs:
            [at] = np.flatnonzero(speeds == repaired.speeds[r])
            there = repaired.prediction(r, signal)[[every.index(1), every.index(2)]]
            np.testing.assert_allclose(values[at], there, rtol=0.01, atol=0.01 * np.abs(there).max())


def test_a_curve_of_another_motion_is_not_drawn(monkeypatch) -> None:
    """The repaired diagram was once drawn at 66.7 mm beside 11 um measured."""
    both = held_runs(bowed())
    group = next(iter(both.runs.groups))
    far = lambda runs, r, speeds, signal, orders: np.full((len(speeds), len(orders)), 66.7e-3 + 0j)  # noqa: E731
    monkeypatch.setattr(speed_curves, "settled_harmonics", far)
    assert speed_curve(both.runs, group, both.signals[0], np.array([1, 2])) is None


def test_a_diagnosis_by_resonances_says_that_it_draws_nothing(monkeypatch):
    """FAULT: plot() of such a diagnosis was an IndexError."""
    monkeypatch.setattr("rotorsim.report.diagnosis.compared.compared", lambda found: OfResonances(found, None, None))
    with pytest.raises(RotorsimError, match="can be drawn beside its recording"):
        bowed().plot()


@pytest.mark.slow
def test_a_diagnosis_is_drawn_over_speed():
    assert bowed().plot().get_suptitle() == "Main harmonics of rotor.displacement over speed, hold-out runs"


@pytest.mark.slow
def test_figures_drawn_by_other_processes_are_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = datetime.now(UTC)
    monkeypatch.setattr(provenance, "datetime", SimpleNamespace(now=lambda _: now))  # a minute may pass between them
    with local_workers(Jobs(2)) as jobs, amplitudes("peak-peak"):
        several = save_report(bowed(), tmp_path / "several", command="", jobs=jobs)
        one = save_report(bowed(), tmp_path / "one", command="")
    assert [file.name for file in several] == [file.name for file in one]
    for here, there in zip(several, one, strict=True):
        assert here.read_bytes() == there.read_bytes(), here.name


@pytest.mark.slow
def test_what_is_left_and_what_is_open_stand_in_the_report(tmp_path):
    left = {
        "share": 0.0057,
        "excess_variance": 24.5,
        "place": {"block": "rotor", "port": "force", "node": 3},
        "size": {"value": 0.0234, "unit": "N", "orders": {"1": 0.02, "3": 0.012}},
    }
    found = replace(bowed(), residual=left, open=(("rub", "was not fitted to the end"),))
    with undrawn():
        save_report(found, tmp_path)
    words = " ".join(_Page((tmp_path / "report.html").read_text()).words)
    for text in (
        "0.57 %",
        "rotor.force[3]",
        "23 mN",
        "1X 20 mN, 3X 12 mN",
        "Tried, but not fitted to the end: not rejected",
    ):
        assert text in words, text
    assert "Proved on hold-out runs: its residual variance there" in words
