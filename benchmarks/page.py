"""The page of `rotorsim serve` in a browser: python -m benchmarks.page speed | pictures [--out docs/images].

speed: the first view of 500 blocks, frames a second while one of them is dragged, and from a click to the picture of a
run of 60 000 samples. pictures: those of docs/serve.md. Needs the package playwright and Debian's chromium.
"""

from __future__ import annotations

import argparse
import json
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.harness import ROOT
from benchmarks.images import shrink_png
from rotorsim.diagram.resolve.resolution import shipped_diagrams

__all__ = ["SHOTS", "main"]

BLOCKS, ACROSS = 500, 25
TARGETS = {"first view": "<= 1.5 s", "dragging": ">= 30 frames/s", "click to picture": "<= 0.5 s"}
SIZE = {"width": 1280, "height": 800}
RUNS_WARM = 5


@contextmanager
def opened(folder: Path, file: str = "") -> Iterator[tuple[Any, str]]:
    """Serve a diagram as a user does, and give a page of a browser and the address."""
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "rotorsim", "serve", *([file] if file else []), "--no-browser", "--port", "0"]
    served = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert served.stdout is not None
    address = served.stdout.readline().strip()
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
            yield browser.new_page(viewport=SIZE), address
            browser.close()
    finally:
        served.terminate()
        served.wait(10)


def many_blocks() -> dict[str, Any]:
    """Return a diagram of 500 blocks in a grid: rows of gains behind a constant."""
    rows = BLOCKS // ACROSS
    names = [f"block{k}" for k in range(BLOCKS)]
    first = {"type": "constant", "parameters": {"value": 1.0}}
    blocks = {name: first if k % ACROSS == 0 else {"type": "gain"} for k, name in enumerate(names)}
    wires = [[f"{names[k - 1]}.output", f"{names[k]}.input"] for k in range(BLOCKS) if k % ACROSS]
    layout = {name: [k % ACROSS, k // ACROSS] for k, name in enumerate(names)}
    assert len(layout) == rows * ACROSS
    return {"schema_version": 1, "name": "many", "blocks": blocks, "wires": wires, "layout": layout}


FRAMES = """(seconds) => new Promise((done) => {
  let count = 0; const begun = performance.now();
  const frame = () => {
    count++;
    performance.now() - begun < 1000 * seconds ? requestAnimationFrame(frame) : done(count / seconds);
  };
  requestAnimationFrame(frame);
})"""
CLICKED = """() => new Promise((done) => {
  const shown = document.querySelectorAll(".kept li").length; const begun = performance.now();
  document.querySelector("[data-testid=run]").click();
  const drawn = () => done((performance.now() - begun) / 1000);
  const there = () => document.querySelectorAll(".kept li").length > shown && document.querySelector(".chart canvas");
  const look = () => there() ? requestAnimationFrame(() => requestAnimationFrame(drawn)) : setTimeout(look, 2);
  look();
})"""


def speed() -> dict[str, float]:
    """Return the seconds and frames that TARGETS name."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "many.json").write_text(json.dumps(many_blocks()))
        with opened(folder, "many.json") as (page, address):
            begun = time.perf_counter()
            page.goto(address)
            page.locator(".block").nth(BLOCKS - 1).wait_for(state="attached")
            found["first view"] = time.perf_counter() - begun
            box = page.get_by_test_id("block-block260").bounding_box()
            x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
            page.mouse.move(x, y)
            page.mouse.down()
            page.evaluate(f"() => {{ window.frames_ = ({FRAMES})(2); }}")
            begun, k = time.perf_counter(), 0
            while time.perf_counter() - begun < 2.2:
                k += 1
                page.mouse.move(x + k % 200, y + k % 90)
            found["dragging"] = page.evaluate("() => window.frames_")
            page.mouse.up()
        document = json.loads(shipped_diagrams()["jeffcott"].read_text())
        document["solver"]["stop"] = "6 s"
        (folder / "long.json").write_text(json.dumps(document))
        with opened(folder, "long.json") as (page, address):
            page.goto(address)
            page.get_by_test_id("block-rotor").wait_for()
            page.evaluate(CLICKED)  # compiles
            times = []
            for _ in range(RUNS_WARM):
                page.get_by_role("button", name="Remove", exact=False).last.click()
                times.append(page.evaluate(CLICKED))
            found["click to picture"] = sorted(times)[RUNS_WARM // 2]
    return found


def gallery(page: Any, address: str) -> None:
    page.goto(address)
    page.set_viewport_size({"width": 1000, "height": 560})
    page.get_by_test_id("gallery-jeffcott").wait_for()


def editor(page: Any, address: str) -> None:
    page.goto(address)
    page.get_by_test_id("block-rotor").wait_for()
    page.get_by_test_id("run").click()
    page.get_by_test_id("chart").first.wait_for()
    page.get_by_test_id("block-controller").click()
    page.wait_for_timeout(300)


def comparison(page: Any, address: str) -> None:
    page.goto(address)
    page.get_by_test_id("block-rotor").wait_for()
    page.get_by_test_id("run").click()
    page.get_by_test_id("chart").first.wait_for()
    page.get_by_test_id("block-controller").click()
    page.get_by_test_id("param-controller.KP").fill("20000 A/m")
    page.get_by_test_id("param-controller.KP").press("Enter")
    page.get_by_test_id("undo").is_enabled()
    page.wait_for_timeout(400)
    page.get_by_test_id("run").click()
    page.locator(".kept li").nth(1).wait_for()
    page.wait_for_timeout(400)


def recording(page: Any, address: str) -> None:
    page.set_viewport_size({"width": 1100, "height": 860})
    page.goto(address)
    page.get_by_test_id("block-rotor").wait_for()
    page.locator(".sliders summary").click()
    page.get_by_test_id("recorded-run").select_option("run06")
    page.get_by_test_id("compare").click()
    page.locator(".kept li").nth(1).wait_for(timeout=60_000)
    page.get_by_test_id("chart").first.wait_for()
    raised(page)


def raised(page: Any) -> None:
    """Give the results more room."""
    page.locator(".split").focus()
    for _ in range(5):
        page.keyboard.press("ArrowUp")
    page.get_by_role("button", name="Fit").click()
    page.wait_for_timeout(1500)


def diagnosis(page: Any, address: str) -> None:
    page.set_viewport_size({"width": 1100, "height": 860})
    page.goto(address)
    page.get_by_test_id("block-rotor").wait_for()
    page.locator(".sliders summary").click()
    page.get_by_test_id("diagnose").click()
    page.get_by_test_id("report").wait_for(timeout=240_000)
    raised(page)


HIDDEN = (  # a controller that damps a tenth more than the diagram says
    'record {file} --set "controller.KD=3.3 A s/m" --speeds "900 rpm:300 rpm:3000 rpm" --settle --noise "0.5 %" '
    "--out bench"
)
SHOTS: dict[str, tuple[str, str, Callable[[Any, str], None]]] = {  # picture -> diagram, what makes recordings, acts
    "serve_gallery.png": ("", "", gallery),
    "serve_editor.png": ("fe_flexible", "", editor),
    "serve_comparison.png": ("jeffcott", "", comparison),
    "serve_recording.png": ("jeffcott", HIDDEN, recording),
    "serve_diagnosis.png": ("jeffcott", HIDDEN, diagnosis),
}


def pictures(out: Path) -> list[Path]:
    """Write the pictures into a folder."""
    made = []
    for name, (diagram, recorded, act) in SHOTS.items():
        with tempfile.TemporaryDirectory() as folder:
            file = f"{diagram}.json" if diagram else ""
            if diagram:
                (Path(folder) / file).write_bytes(shipped_diagrams()[diagram].read_bytes())
            if recorded:
                command = [sys.executable, "-m", "rotorsim", *shlex.split(recorded.format(file=file))]
                subprocess.run(command, cwd=folder, check=True, capture_output=True)
            with opened(Path(folder), file) as (page, address):
                act(page, address)
                shot = Path(folder) / name
                page.screenshot(path=shot)
                shrink_png(shot, out / name)
        made.append(out / name)
    return made


def main(arguments: list[str] | None = None) -> None:
    """Print the speeds, or draw the pictures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.page", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=["speed", "pictures"])
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images")
    given = parser.parse_args(arguments)
    if given.what == "pictures":
        for file in pictures(given.out.resolve()):
            print(f"{file.name}  {file.stat().st_size / 1000:.0f} kB")
        return
    print(f"processor: {platform.processor() or platform.machine()}")
    for name, value in speed().items():
        unit = "frames/s" if name == "dragging" else "s"
        print(f"{name:18} {value:8.3g} {unit:9} target {TARGETS[name]}")


if __name__ == "__main__":
    main()
