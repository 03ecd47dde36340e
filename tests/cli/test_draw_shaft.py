"""rotorsim draw --shaft: the file that it writes, and what it refuses."""

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Run


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_a_shaft_is_drawn_into_a_file(run: Run, tmp_path: Path, suffix: str):
    file = tmp_path / f"shaft.{suffix}"
    result = run("draw", "drawn_rotor", "--shaft", "--out", str(file), "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout) == {"diagram": "drawn_rotor", "file": str(file)}
    start = file.read_bytes()[:200]
    assert b"PNG" in start if suffix == "png" else b"<?xml" in start


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("drawn_rotor", "--shaft"), "--shaft: a shaft is drawn into a file\n\nhint: add --out shaft.png"),
        (
            ("drawn_rotor", "-o", "a.png"),
            "draw: a.png: a diagram is drawn as .svg\n\nhint: add --shaft, or write FILE.svg",
        ),
        (("drawn_rotor", "--rotor", "rotor"), "draw: --rotor is for --shaft\n\nhint: add --shaft, or write FILE.svg"),
        (
            ("jeffcott", "--shaft", "-o", "a.png"),
            "jeffcott: no rotor with a shaft to draw\n\nhint: rotor_drawing and rotor_fe have one",
        ),
    ],
)
def test_what_cannot_be_drawn_is_said(run: Run, tmp_path: Path, monkeypatch, words: tuple[str, ...], said: str):
    monkeypatch.chdir(tmp_path)
    result = run("draw", *words)
    assert result.exit_code == 2
    assert result.stderr.strip() == f"error: {said}"
    assert not list(tmp_path.iterdir())
