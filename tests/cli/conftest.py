"""Running the command line in this process."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from rotorsim.cli.app import rotorsim

Run = Callable[..., Result]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Return a function that runs ``rotorsim`` with arguments, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Result:
        return CliRunner().invoke(rotorsim, list(arguments))

    return call


@pytest.fixture
def oscillator(tmp_path: Path) -> Path:
    """Return the file of a small diagram: x' = -rate x through an integrator and a gain."""
    file = tmp_path / "decay.json"
    file.write_text(
        json.dumps(
            {
                "schema_version": 1,
                "name": "decay",
                "blocks": {
                    "state": {"type": "integrator", "parameters": {"initial": 1.0}},
                    "rate": {"type": "gain", "parameters": {"gain": -1.0}},
                },
                "wires": [["state.output", "rate.input"], ["rate.output", "state.input"]],
                "solver": {"step": 0.01, "stop": 1.0},
                "record": ["state.output"],
            },
            indent=2,
        )
    )
    return file
