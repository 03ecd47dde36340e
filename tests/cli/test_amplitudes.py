"""The option --amplitude: 0-peak, peak-peak or rms, of every verb that shows amplitudes of sinusoids."""

from __future__ import annotations

from importlib import import_module

from rotorsim.cli.app import VERBS
from tests.cli.conftest import Run

HELP = "How figures and tables show amplitudes of sinusoids; --json stays 0-peak, in SI."


def test_every_verb_that_shows_amplitudes_has_the_option() -> None:
    having = {
        verb
        for verb in VERBS
        for option in import_module(f"rotorsim.cli.{verb}").command.params
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
