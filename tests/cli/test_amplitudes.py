"""The option --amplitude: 0-peak, peak-peak or rms, of every verb that shows amplitudes of sinusoids."""

from __future__ import annotations

import pytest

from rotorsim.cli.app import VERBS, verb
from tests.cli.conftest import Run

HELP = "How figures and tables show amplitudes of sinusoids; --json stays 0-peak, in SI."


def test_every_verb_that_shows_amplitudes_has_the_option() -> None:
    having = {
        name
        for name in VERBS
        for option in verb(name).params
        if getattr(option, "help", None)
        == "How figures and tables show amplitudes of sinusoids; --json stays 0-peak, in SI."
    }
    assert having == {"cosim", "diagnose", "identify", "orders", "periodic", "run", "spectrum", "sweep"}


def test_the_choice_ends_with_the_verb(run: Run) -> None:
    speed = ("periodic", "jeffcott", "--speeds", "1500 rpm")
    first, doubled, again = run(*speed), run(*speed, "--amplitude", "peak-peak"), run(*speed)
    assert "amplitude [um, peak-peak]" in doubled.output
    assert first.output == again.output
    assert "amplitude [um, 0-peak]" in again.output
    bad = run(*speed, "--amplitude", "peak")
    assert bad.exit_code == 2
    assert "'peak' is not one of '0-peak', 'peak-peak', 'rms'" in bad.output


def test_the_harmonics_of_a_run_are_shown_as_chosen(run: Run) -> None:
    """FAULT: the tables of harmonics of `run` stayed 0-peak whatever was chosen."""
    lines = {word: run("run", "jeffcott", "--amplitude", word).output.splitlines() for word in ("0-peak", "peak-peak")}
    sizes = {}
    for word, said in lines.items():
        first = next(k for k, line in enumerate(said) if f"amplitude [um, {word}]" in line)
        sizes[word] = {line.split()[0]: float(line.split()[1]) for line in said[first + 1 : first + 6]}
    assert sizes["peak-peak"]["1"] == pytest.approx(2 * sizes["0-peak"]["1"], rel=1e-5)
    assert sizes["0-peak"]["1"] == pytest.approx(3.178, rel=1e-3)  # um, thesis Table 2-2
    assert sizes["peak-peak"]["0"] == sizes["0-peak"]["0"]
