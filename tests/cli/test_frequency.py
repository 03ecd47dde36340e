"""The verb ``frequency``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import Run

UNBALANCE = ["frequency", "jeffcott", "--from", "unbalance.force", "--to", "rotor.displacement"]

ENTRY = "amb.force[3]: no such entry; 'amb.force' has shape 2, counted from 1\n\nhint: name 'amb.force' for all\n"


@pytest.mark.slow
def test_what_is_printed(run: Run) -> None:
    found = run(*UNBALANCE, "--plot", "bode.png")
    assert (found.exit_code, found.stderr) == (0, "written: bode.png\n")
    assert found.stdout.splitlines() == [
        "from                                   to  peak at [Hz]  0-peak per 0-peak  phase [deg]",
        "unbalance.force[1]  rotor.displacement[1]        121.11     6.4861e-06 m/N        -86.2",
        "unbalance.force[2]  rotor.displacement[2]        121.11     6.4861e-06 m/N        -86.2",
    ]
    assert Path("bode.png").stat().st_size > 10_000


def test_numbers(run: Run) -> None:
    data = json.loads(run(*UNBALANCE, "--range", "10 Hz:20 Hz", "--json").stdout)
    hz = np.array(data["frequencies"])
    s = 2j * np.pi * hz
    truth = 1 / (2 * s**2 + (76 + 42.1 * 3) * s + 7.6e5 - 105210 + 42.1 * (12200 + 2000 / s))
    response = np.array(data["response"])[:, 0, 0]
    np.testing.assert_allclose(response[:, 0] + 1j * response[:, 1], truth, rtol=1e-9)
    assert (hz[0], hz[-1]) == (10.0, pytest.approx(20.0))
    assert (data["peaks"], data["units"][0][0], data["stable"]) == ([], "m/N", True)


def test_the_loop_opened(run: Run) -> None:
    arguments = ["frequency", "jeffcott", "--from", "controller.current", "--to", "controller.current", "--open"]
    data = json.loads(run(*arguments, "--json").stdout)
    s = 2j * np.pi * np.array(data["frequencies"])
    truth = -(12200 + 2000 / s + 3 * s) * 42.1 / (2 * s**2 + 76 * s + 7.6e5 - 105210)
    response = np.array(data["response"])[:, 0, 0]
    np.testing.assert_allclose(response[:, 0] + 1j * response[:, 1], truth, rtol=1e-9)


def test_what_does_not_settle_is_said(run: Run) -> None:
    found = run(*UNBALANCE, "--set", "controller.KD=-10")
    assert found.exit_code == 0
    assert found.stderr == (
        "warning: jeffcott: not stable: the machine never settles to this response\n\n"
        "hint: 'rotorsim modes' shows what grows\n"
    )


def test_a_rate_that_passes_by_the_test_signal_is_said(run: Run) -> None:
    """FAULT of an earlier version: the response of a PID without its D, and nothing said."""
    found = run("frequency", "jeffcott", "--from", "controller.displacement", "--to", "controller.current")
    assert found.stderr == (
        "'controller.displacement' is disturbed, and 'controller.velocity' is not: `margins` disturbs both, as one "
        "sensor does\n"
    )


@pytest.mark.parametrize("verb", [("step", "--to", "rotor.displacement", "--from"), ("margins", "--at")])
def test_an_entry_that_is_not_there_is_refused_where_a_test_signal_enters(run: Run, verb: tuple[str, ...]) -> None:
    """FAULT of an earlier version: "did you mean 'force'?" of 'amb.force[1]'."""
    found = run(verb[0], "jeffcott", *verb[1:], "amb.force[3]")
    assert (found.exit_code, found.stderr) == (2, f"error: {ENTRY}")


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (["--range", "x"], "--range x: not a frequency\n\nhint: for example --range '5 Hz:2000 Hz'\n"),
        (["--range", "3 Hz"], "--range 3 Hz: not LOW:HIGH\n\nhint: for example --range '5 Hz:2000 Hz'\n"),
        (["--range", "3 rpm:4 rpm"], "--range 3 rpm: not a frequency\n\nhint: for example --range '5 Hz:2000 Hz'\n"),
        (["--from", "unbalance.forse"], "unbalance.forse: no such port\n\nhint: did you mean 'force'?\n"),
        (["--from", "unbalence.force"], "unbalence: no such block\n\nhint: did you mean 'unbalance'?\n"),
        (
            ["--from", "unbalance"],
            "unbalance: is a block, not a port\n\nhint: its ports: unbalance.theta, unbalance.speed, "
            "unbalance.acceleration, unbalance.force\n",
        ),
        (["--from", "amb.force[3]"], ENTRY),
        (["--from", "amb.force[3]", "--open"], ENTRY),
    ],
)
def test_what_is_refused(run: Run, more: list[str], text: str) -> None:
    found = run(*UNBALANCE, *more)
    assert (found.exit_code, found.stderr) == (2, f"error: {text}")
