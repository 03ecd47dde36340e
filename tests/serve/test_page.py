"""The page in a browser: view, edit, run, conflicts, mistakes made by hand, keyboard only; nothing from elsewhere."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from click.testing import CliRunner

from rotorsim.cli.app import rotorsim
from rotorsim.diagram.parse.fmt import format_document
from rotorsim.serve.live import Live
from rotorsim.serve.session import Session
from rotorsim.serve.store import DiagramFile
from tests.serve.serving import TOKEN, Served, served

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
try:
    from playwright.sync_api import Browser, Page, expect, sync_playwright
except ImportError:
    sync_playwright = None  # type: ignore[assignment]
if "CI" not in os.environ:  # there both are installed, and a test that does not run is a failure
    if sync_playwright is None:
        pytest.skip("needs the package playwright", allow_module_level=True)
    if CHROMIUM is None:
        pytest.skip("needs the browser chromium", allow_module_level=True)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Return a browser for all tests of this file."""
    assert CHROMIUM is not None, "no chromium on this machine"
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


Open = Callable[..., Page]


@pytest.fixture
def at(mine: Path) -> Iterator[Served]:
    with served(Session(mine.parent, DiagramFile(mine))) as found:
        yield found


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Open]:
    """Return a function that opens the page; what it asks of other hosts, or says of mistakes, fails the test."""
    foreign: list[str] = []
    wrong: list[str] = []
    contexts = []

    def opened(at: Served, width: int = 1280, height: int = 800) -> Page:
        context = browser.new_context(viewport={"width": width, "height": height})
        contexts.append(context)

        def only_here(route: Any) -> None:
            if urlsplit(route.request.url).netloc == at.host:
                route.continue_()
            else:
                foreign.append(route.request.url)
                route.abort()

        context.route(re.compile("^(?!blob:|data:)"), only_here)
        page = context.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.goto(f"http://{at.host}/#{TOKEN}")
        if at.session.file is not None:
            expect(by(page, "block-rotor")).to_be_visible()
        return page

    yield opened
    for context in contexts:
        context.close()
    assert foreign == []
    assert wrong == []


def by(page: Page, name: str) -> Any:
    return page.get_by_test_id(name)


def document_of(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def drag(page: Page, start: Any, to: tuple[float, float]) -> None:
    """Drag the middle of an element by so many pixels."""
    box = start.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for k in range(1, 9):
        page.mouse.move(x + to[0] * k / 8, y + to[1] * k / 8)
    page.mouse.up()


def changed(path: Path, what: Callable[[dict[str, Any]], bool]) -> None:
    """Wait until a file says something."""
    for _ in range(100):
        try:
            if what(document_of(path)):
                return
        except ValueError:
            pass
        time.sleep(0.05)
    raise AssertionError(path.read_text())


def test_the_diagram_is_shown_and_the_token_leaves_the_address(at: Served, open_page: Open) -> None:
    page = open_page(at)
    for block in ("clock", "crack", "unbalance", "rotor", "controller", "amb", "reference", "bus"):
        expect(by(page, f"block-{block}")).to_be_visible()
    assert TOKEN not in page.url
    page.reload()
    expect(by(page, "block-rotor")).to_be_visible()
    by(page, "block-rotor").click()
    expect(by(page, "param-rotor.mass")).to_have_value("2 kg")


def test_without_a_token_nothing_is_shown(at: Served, browser: Browser) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"http://{at.host}/")
    expect(page.get_by_text("rotorsim serve")).to_be_visible()
    assert by(page, "block-rotor").count() == 0
    context.close()


def test_a_block_is_dragged_to_another_cell(at: Served, open_page: Open, mine: Path) -> None:
    page = open_page(at)
    start, goal = by(page, "block-bus").bounding_box(), by(page, "block-crack").bounding_box()
    drag(page, by(page, "block-bus"), (0.0, goal["y"] - start["y"]))
    changed(mine, lambda document: document["layout"]["bus"] != [4, 2])
    assert document_of(mine)["layout"]["bus"][1] < 1
    assert mine.read_text() == format_document(document_of(mine))


def test_a_wire_is_cut_and_drawn_from_port_to_port(at: Served, open_page: Open, mine: Path) -> None:
    page = open_page(at)
    by(page, "wire-rotor.displacement-amb.displacement").dispatch_event("click")
    page.keyboard.press("Delete")
    changed(mine, lambda document: ["rotor.displacement", "amb.displacement"] not in document["wires"])
    expect(by(page, "problem").first).to_contain_text("input is not wired")
    source = by(page, "port-rotor.displacement-out").locator(".dot").bounding_box()
    target = by(page, "port-amb.displacement-in").locator(".dot").bounding_box()
    page.mouse.move(source["x"] + source["width"] / 2, source["y"] + source["height"] / 2)
    page.mouse.down()
    page.mouse.move(target["x"] - 40, target["y"] + 20)
    page.wait_for_timeout(300)  # which ports fit is asked
    page.mouse.move(target["x"] + target["width"] / 2, target["y"] + target["height"] / 2, steps=5)
    page.mouse.up()
    changed(mine, lambda document: ["rotor.displacement", "amb.displacement"] in document["wires"])


def test_a_value_is_set_undone_and_done_again(at: Served, open_page: Open, mine: Path) -> None:
    page = open_page(at)
    by(page, "block-rotor").click()
    field = by(page, "param-rotor.mass")
    field.fill("3 kgg")
    expect(by(page, "param-error")).to_contain_text("unknown unit 'kgg'")
    field.fill("3 kg")
    field.press("Enter")
    changed(mine, lambda document: document["blocks"]["rotor"]["parameters"]["mass"] == "3 kg")
    by(page, "undo").click()
    changed(mine, lambda document: document["blocks"]["rotor"]["parameters"]["mass"] == "2 kg")
    by(page, "redo").click()
    changed(mine, lambda document: document["blocks"]["rotor"]["parameters"]["mass"] == "3 kg")


def test_a_value_typed_before_the_page_is_painted_is_kept(at: Served, open_page: Open, mine: Path) -> None:
    page = open_page(at)
    page.evaluate(
        """async () => {
          const find = (name) => document.querySelector(`[data-testid="${name}"]`);
          const drawn = async () => { for (let k = 0; k < 20; k++) await null; };  // not painted
          window.requestAnimationFrame = () => 0;
          find("block-rotor").focus();
          await drawn();
          const field = find("param-rotor.mass");
          field.value = "3 kg";
          field.dispatchEvent(new InputEvent("input", { bubbles: true }));
          await drawn();
          field.dispatchEvent(new KeyboardEvent("keydown", { key: "Enter", bubbles: true }));
        }"""
    )
    changed(mine, lambda document: document["blocks"]["rotor"]["parameters"]["mass"] == "3 kg")


def test_an_edit_whose_answer_is_lost_can_be_undone(
    at: Served, open_page: Open, mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = open_page(at)
    send, broken = Live.send, []

    def lose(self: Live, data: Any) -> None:
        if data.get("kind") == "done" and not broken:
            broken.append(data)
            self.close()
        else:
            send(self, data)

    monkeypatch.setattr(Live, "send", lose)
    by(page, "block-rotor").click()
    by(page, "param-rotor.mass").fill("3 kg")
    by(page, "param-rotor.mass").press("Enter")
    changed(mine, lambda document: document["blocks"]["rotor"]["parameters"]["mass"] == "3 kg")
    expect(by(page, "undo")).to_be_enabled(timeout=15_000)
    assert len(broken) == 1
    by(page, "undo").click()
    changed(mine, lambda document: document["blocks"]["rotor"]["parameters"]["mass"] == "2 kg")


def test_a_controller_is_swapped_with_its_values_kept(at: Served, open_page: Open, mine: Path) -> None:
    page = open_page(at)
    by(page, "block-controller").click()
    by(page, "swap").click()
    page.get_by_role("button", name="discrete_pid", exact=True).click()
    changed(mine, lambda document: document["blocks"]["controller"]["type"] == "discrete_pid")
    assert document_of(mine)["blocks"]["controller"]["parameters"]["KP"] == "12200 A/m"


def test_blocks_are_grouped_entered_edited_inside_and_dissolved(at: Served, open_page: Open, mine: Path) -> None:
    page = open_page(at)
    by(page, "block-controller").click()
    by(page, "block-amb").click(modifiers=["Shift"])
    expect(page.get_by_role("heading", name="2 blocks")).to_be_visible()
    by(page, "group").click()
    by(page, "group-name").fill("bearing")
    by(page, "group-name").press("Enter")
    expect(by(page, "block-bearing")).to_be_visible()
    expect(by(page, "group-name")).to_have_count(0)
    assert document_of(mine)["blocks"]["bearing"] == {
        "type": "diagram",
        "file": "bearing.json",
        "parameters": document_of(mine)["blocks"]["bearing"]["parameters"],
    }
    by(page, "enter-part").click()
    expect(by(page, "block-rotor")).to_have_count(0)
    by(page, "block-controller").click()
    by(page, "param-controller.KP").fill("12000 A/m")
    by(page, "param-controller.KP").press("Enter")
    part = mine.with_name("bearing.json")
    changed(part, lambda document: document["blocks"]["controller"]["parameters"]["KP"] == "12000 A/m")
    by(page, "undo").click()
    changed(part, lambda document: document["blocks"]["controller"]["parameters"]["KP"] == "12200 A/m")
    by(page, "run").click()  # the whole diagram
    expect(by(page, "chart").first).to_be_visible()
    page.reload()
    expect(by(page, "block-rotor")).to_be_visible()
    by(page, "block-bearing").click()
    by(page, "dissolve").click()
    changed(mine, lambda document: "bearing" not in document["blocks"])
    expect(by(page, "block-controller")).to_be_visible()


def test_several_blocks_are_chosen_moved_copied_and_removed_with_keys(at: Served, open_page: Open, mine: Path) -> None:
    page = open_page(at)
    before = document_of(mine)["layout"]
    page.get_by_test_id("block-controller").focus()
    page.keyboard.press("Shift+ArrowRight")
    expect(page.get_by_role("heading", name="2 blocks")).to_be_visible()
    page.keyboard.press("Alt+ArrowDown")
    changed(mine, lambda document: document["layout"]["amb"][1] > before["amb"][1])
    after = document_of(mine)["layout"]
    assert [after[one][1] - before[one][1] for one in ("controller", "amb")] == [1, 1]
    page.keyboard.press("d")
    changed(mine, lambda document: {"controller2", "amb2"} <= set(document["blocks"]))
    assert ["controller2.current", "amb2.current"] in document_of(mine)["wires"]
    expect(by(page, "block-amb2")).to_have_attribute("aria-pressed", "true")
    expect(by(page, "block-controller2")).to_have_attribute("aria-pressed", "true")
    page.keyboard.press("Control+a")
    expect(page.get_by_role("heading", name="10 blocks")).to_be_visible()
    page.keyboard.press("Escape")
    page.keyboard.press("u")
    changed(mine, lambda document: "amb2" not in document["blocks"])
    expect(by(page, "block-amb2")).to_have_count(0)
    page.keyboard.press("f")
    box = by(page, "sheet").bounding_box()
    page.keyboard.down("Shift")
    page.mouse.move(box["x"] + 3, box["y"] + 3)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] - 3, box["y"] + box["height"] - 3, steps=4)
    page.mouse.up()
    page.keyboard.up("Shift")
    expect(page.get_by_role("heading", name="8 blocks")).to_be_visible()
    drag(page, by(page, "block-bus"), (0.0, 60.0))
    changed(mine, lambda document: document["layout"] != after)
    page.keyboard.press("Delete")
    expect(page.locator(".said")).to_contain_text("not done")  # a diagram without blocks cannot be drawn
    page.keyboard.press("Escape")
    page.keyboard.press("g")
    expect(by(page, "group-name")).to_have_count(0)


def test_a_block_is_added_from_the_palette(at: Served, open_page: Open, mine: Path) -> None:
    page = open_page(at)
    page.keyboard.press("a")
    by(page, "palette").get_by_role("searchbox").fill("low")
    by(page, "palette").get_by_role("searchbox").fill("gain")
    by(page, "palette-gain").click()
    changed(mine, lambda document: document["blocks"].get("gain") == {"type": "gain"})
    expect(by(page, "block-gain")).to_be_visible()


def test_a_run_is_drawn_and_follows_a_slider(at: Served, open_page: Open) -> None:
    page = open_page(at)
    by(page, "run").click()
    expect(by(page, "chart").first).to_be_visible()
    expect(by(page, "orbit").first).to_be_visible()
    expect(page.get_by_text("mine, 1500 rpm").first).to_be_visible()
    slider = by(page, "slider-speed")
    slider.focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    expect(page.get_by_text(re.compile(r"mine, 1522\.5 rpm")).first).to_be_visible()


def test_both_values_of_a_conflict_are_shown(at: Served, open_page: Open, mine: Path) -> None:
    one, two = open_page(at), open_page(at)
    for page in (one, two):
        by(page, "block-rotor").click()
    expect(by(two, "param-rotor.mass")).to_have_value("2 kg")
    by(two, "param-rotor.mass").fill("4 kg")
    by(one, "param-rotor.mass").fill("3 kg")
    by(one, "param-rotor.mass").press("Enter")
    changed(mine, lambda document: document["blocks"]["rotor"]["parameters"]["mass"] == "3 kg")
    by(two, "param-rotor.mass").press("Enter")
    expect(by(two, "conflict")).to_contain_text("3 kg")
    expect(by(two, "conflict")).to_contain_text("4 kg")
    assert document_of(mine)["blocks"]["rotor"]["parameters"]["mass"] == "3 kg"
    by(two, "conflict-mine").first.click()
    changed(mine, lambda document: document["blocks"]["rotor"]["parameters"]["mass"] == "4 kg")


def test_a_hand_edit_appears_and_one_with_mistakes_is_said(at: Served, open_page: Open, mine: Path) -> None:
    page = open_page(at)
    expect(by(page, "block-rotor")).to_be_visible()
    good = mine.read_text()
    mine.write_text(good.replace('"rotor_2dof"', '"rotor_2dofs"'))
    expect(by(page, "banner")).to_contain_text("unknown block type 'rotor_2dofs'")
    expect(by(page, "block-rotor")).to_be_visible()  # the last good picture
    mine.write_text(good.replace('"2 kg"', '"2.5 kg"'))
    expect(by(page, "banner")).to_have_count(0)
    by(page, "block-rotor").click()
    expect(by(page, "param-rotor.mass")).to_have_value("2.5 kg")


def test_names_with_markup_are_shown_as_text(at: Served, open_page: Open, mine: Path) -> None:
    name = "<img src=x onerror=alert(1)>"
    mine.write_text(json.dumps(document_of(mine) | {"name": name, "description": f"<b>{name}</b>"}))
    page = open_page(at)
    expect(page.get_by_text(name).first).to_be_visible()
    assert page.locator("img[src=x]").count() == 0


def test_everything_is_done_by_the_keyboard(at: Served, open_page: Open, mine: Path) -> None:
    page = open_page(at)
    expect(by(page, "block-rotor")).to_be_visible()
    by(page, "block-amb").focus()
    page.keyboard.press("Alt+ArrowRight")
    changed(mine, lambda document: document["layout"]["amb"][0] > 4)
    page.keyboard.press("Control+z")
    changed(mine, lambda document: document["layout"]["amb"] == [4, 1])
    by(page, "block-bus").focus()
    page.keyboard.press("Delete")
    changed(mine, lambda document: "bus" not in document["blocks"])
    page.keyboard.press("Control+z")
    changed(mine, lambda document: "bus" in document["blocks"])
    page.keyboard.press("p")
    expect(by(page, "chart").first).to_be_visible()


def test_a_recording_is_diagnosed_and_the_repair_applied_as_one_step(
    at: Served, open_page: Open, mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(mine.parent)
    made = 'record mine.json --set "controller.KD=3.3 A s/m" --speeds "900 rpm:300 rpm:3000 rpm" --settle --out bench'
    assert CliRunner().invoke(rotorsim, [*shlex.split(made), "--noise", "0.5 %"]).exit_code == 0
    page = open_page(at)
    expect(by(page, "recording")).to_have_value("bench")
    by(page, "diagnose").click()
    expect(by(page, "found")).to_contain_text("controller_gain_error", timeout=120_000)
    report = page.frame_locator("[data-testid=report]")
    expect(report.get_by_text("controller_gain_error").first).to_be_visible()
    before = mine.read_bytes()
    by(page, "repair").click()
    by(page, "apply").click()
    changed(mine, lambda document: "controller_gain_error" in document["blocks"])
    expect(by(page, "block-controller_gain_error")).to_be_visible()
    by(page, "undo").click()
    changed(mine, lambda document: "controller_gain_error" not in document["blocks"])
    assert mine.read_bytes() == before


def test_a_recording_stands_beside_the_diagram_in_the_charts(
    at: Served, open_page: Open, mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(mine.parent)
    made = 'record mine.json --set "controller.KD=3.3 A s/m" --speeds "1200 rpm, 1500 rpm" --settle --out bench'
    assert CliRunner().invoke(rotorsim, [*shlex.split(made), "--noise", "0.5 %"]).exit_code == 0
    page = open_page(at)
    by(page, "recorded-run").select_option("run02")
    by(page, "compare").click()
    kept = page.locator(".kept li")
    expect(kept).to_have_count(2, timeout=60_000)
    expect(kept.nth(0)).to_contain_text("measured, run02 of mine")
    expect(kept.nth(1)).to_contain_text("mine driven as run02 of mine")
    expect(kept.nth(1)).to_contain_text("NRMSE: it leaves")
    expect(by(page, "chart").first).to_contain_text("x, 1")
    expect(by(page, "orbit").first).to_be_visible()
    kept.nth(1).get_by_role("button", name="spectrum").click()
    expect(by(page, "figure")).to_be_visible()
    by(page, "over-speed").click()
    expect(page.get_by_text("measured [um, 0-peak]")).to_be_visible(timeout=60_000)
    with page.expect_download() as loading:
        page.get_by_text("Save the table as CSV").click()
    table = Path(loading.value.path()).read_text().splitlines()
    assert table[0] == 'speed [rpm],"1X of rotor.displacement [um, 0-peak]","measured [um, 0-peak]",motion'


def test_a_co_simulation_runs_from_the_page(at: Served, open_page: Open, mine: Path) -> None:
    mine.write_text(mine.read_text().replace('"stop": "5 s"', '"stop": "0.2 s"'))
    page = open_page(at)
    page.locator(".cosim summary").click()
    page.get_by_label("step").fill("100 us")
    page.get_by_label("parts").fill("controller")
    by(page, "cosim").click()
    expect(page.locator(".kept li").first).to_contain_text("gauss_seidel, step 100 us", timeout=60_000)
    expect(page.locator(".kept li").first).to_contain_text("damping kept by the coupling")


def test_a_block_is_copied_to_another_diagram_and_the_picture_saved(
    at: Served, open_page: Open, mine: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    other = tmp_path_factory.mktemp("other") / "mine.json"
    other.write_bytes(mine.read_bytes())
    page = open_page(at)
    by(page, "block-unbalance").focus()
    copied = page.evaluate(
        """() => {
          const data = new DataTransfer();
          window.dispatchEvent(new ClipboardEvent("copy", { clipboardData: data, cancelable: true }));
          return data.getData("text/plain");
        }"""
    )
    entry = json.loads(copied)["rotorsim-blocks"]["blocks"]["unbalance"]
    assert entry["parameters"]["eccentricity"] == "24 um"  # what it follows there, not the name
    with page.expect_download() as loading:
        by(page, "picture").click()
    assert loading.value.suggested_filename == "mine.svg"
    with served(Session(other.parent, DiagramFile(other))) as there:
        second = open_page(there)
        second.evaluate(
            """(text) => {
              const data = new DataTransfer();
              data.setData("text/plain", text);
              window.dispatchEvent(new ClipboardEvent("paste", { clipboardData: data, cancelable: true }));
            }""",
            copied,
        )
        changed(other, lambda document: "unbalance2" in document["blocks"])
        assert document_of(other)["blocks"]["unbalance2"]["parameters"]["mass"] == "2 kg"


def test_a_sub_diagram_is_opened_and_closed(tmp_path: Path, open_page: Open) -> None:
    inner = {
        "blocks": {"gain": {"type": "gain"}},
        "ports": {"inputs": {"u": "gain.input"}, "outputs": {"y": "gain.output"}},
    }
    outer = {
        "blocks": {"rotor": {"type": "constant"}, "inner": {"type": "diagram", "file": "inner.json"}},
        "wires": [["rotor.output", "inner.u"]],
    }
    for name, document in (("inner", inner), ("outer", outer)):
        (tmp_path / f"{name}.json").write_text(json.dumps({"schema_version": 1, **document}))
    with served(Session(tmp_path, DiagramFile(tmp_path / "outer.json"))) as at:
        page = open_page(at)
        by(page, "block-inner").focus()
        page.keyboard.press("o")
        expect(by(page, "block-inner/gain")).to_be_visible()
        by(page, "block-inner/gain").click()
        by(page, "close-part").click()
        expect(by(page, "block-inner")).to_be_visible()
        assert by(page, "block-inner/gain").count() == 0


def test_read_only_has_nothing_to_edit_with(mine: Path, open_page: Open) -> None:
    with served(Session(mine.parent, DiagramFile(mine, read_only=True), read_only=True)) as at:
        page = open_page(at)
        by(page, "block-rotor").click()
        assert by(page, "remove").count() == 0
        assert by(page, "undo").count() == 0
        page.keyboard.press("Delete")
        page.wait_for_timeout(200)
        assert "rotor" in document_of(mine)["blocks"]


def test_the_gallery_gives_a_copy(tmp_path: Path, open_page: Open) -> None:
    with served(Session(tmp_path)) as at:
        page = open_page(at)
        by(page, "gallery-jeffcott").click()
        expect(by(page, "block-rotor")).to_be_visible()
        assert (tmp_path / "jeffcott.json").exists()
