"""rotorsim check, identify and diagnose with orders over the speed."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from rotorsim.identification.identification import identify
from rotorsim.model.load import load
from rotorsim.recordings.orders import load_orders
from rotorsim.report.identification.figures import identification_figures
from tests.cli.conftest import Run
from tests.identification.orders import ROTOR, noisy, passage, write
from tests.report import undrawn


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("orders")
    (folder / "disc.json").write_text(json.dumps(ROTOR))
    speed, _, vectors = passage(1250.0, 230.0, 1)
    write(folder / "up", speed, noisy(vectors, 5e-8))
    return folder


def test_identify_prints_and_writes_what_orders_say(case, run: Run, tmp_path):
    with undrawn():
        done = run("identify", str(case / "disc.json"), str(case / "up"), "--out", "out")
    assert done.exit_code == 0, done.output
    assert "1X of rotor.displacement[1]" in done.stdout
    data = json.loads((tmp_path / "out/identification.json").read_text())
    assert data["slow_roll"]["1X of rotor.displacement[1]"]["amplitude"] == pytest.approx(1.5e-6, rel=0.05)
    assert (tmp_path / "out/orders_up_1.png").exists()
    assert load(str(tmp_path / "out/diagram.json")).name == "disc"


def test_the_figure_is_a_bode_plot_in_recorded_units_and_rpm(case):
    recording = load_orders(case / "up")
    figures = identification_figures(identify(load(str(case / "disc.json")), recording), recording)
    amplitude, phase, left = figures["orders_up_1"].axes
    assert amplitude.get_ylabel() == "amplitude [um, 0-peak]"
    assert phase.get_ylabel() == "phase lag [deg]"
    assert left.get_xlabel() == "speed [rpm]"
    measured, simulated = amplitude.lines
    assert [line.get_label() for line in amplitude.lines] == ["measured", "order-tracked simulation"]
    [run] = recording.runs
    np.testing.assert_allclose(measured.get_xdata(), run.speed * 30 / np.pi)
    np.testing.assert_allclose(measured.get_ydata(), np.abs(run.vectors["x 1X"]) * 1e6)
    np.testing.assert_allclose(simulated.get_ydata(), measured.get_ydata(), atol=0.4)
    lag = phase.lines[0].get_ydata()
    np.testing.assert_allclose(np.exp(-1j * np.radians(lag)), np.exp(1j * np.angle(run.vectors["x 1X"])), rtol=1e-9)


def test_run_compares_a_diagram_as_it_is_with_orders(case, run: Run):
    with undrawn():
        done = run("run", str(case / "disc.json"), "--input", str(case / "up"), "--plot", "beside.png", "--json")
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    error = data["errors"]["1X of rotor.displacement[1]"]
    assert 0.1 < error["nrmse"] < 1.0  # values of the diagram are off by 4 to 40 %
    assert data["files"] == ["beside.png"]
    close = ["--set", "rotor.stiffness=28000", "--set", "rotor.viscous_damping=8"]
    close += ["--set", "unbalance.eccentricity=2 um", "--set", "unbalance.phase=0.6 rad"]
    data = json.loads(run("run", str(case / "disc.json"), "--input", str(case / "up"), "--json", *close).stdout)
    name = "1X of rotor.displacement[1]"
    assert data["errors"][name]["rms"] == pytest.approx(5e-8 * np.sqrt(2), rel=0.15)
    assert complex(*data["slow_roll"][name]) == pytest.approx(1.5e-6 * np.exp(-2.0j), abs=2e-8)


def test_run_refuses_what_orders_do_not_have(case, run: Run):
    done = run("run", str(case / "disc.json"), "--input", str(case / "up"), "--start", "diagram", "--out", "x.csv")
    assert done.exit_code == 2
    assert "--start does not go with orders" in done.stderr
    assert "--out does not go with orders" in done.stderr
    done = run("run", str(case / "disc.json"), "--input", str(case / "up"), "--run", "upp")
    assert done.exit_code == 2
    assert "no run 'upp'" in done.stderr


def test_check_takes_orders_and_compares_them_with_a_diagram(case, run: Run):
    done = run("check", str(case / "disc.json"), str(case / "up"))
    assert done.exit_code == 0
    assert "orders of 1 channel, 1 run, 90 rows, no mistakes" in done.stdout
    done = run("check", "emps", str(case / "up"))
    assert done.exit_code == 2
    assert "channel x 1X: no such signal" in done.stderr


def test_verbs_that_need_samples_refuse_orders(case, run: Run):
    done = run("locate", str(case / "disc.json"), str(case / "up"))
    assert done.exit_code == 2
    assert "recording.json:2:10: error: these are orders over the speed, not samples in time" in done.stderr
    assert "hint: 'identify', 'diagnose', 'run --input' and 'check' take them" in done.stderr


@pytest.mark.slow
def test_diagnose_takes_orders_and_writes_bode_plots(case, run: Run, tmp_path):
    physics = ("--physics", "cubic_stiffness", "--workers", "1")
    with undrawn():
        done = run("diagnose", str(case / "disc.json"), str(case / "up"), "--out", "out", *physics)
    assert done.exit_code == 1, done.output
    assert done.stdout.startswith("verdict: not_identifiable")
    assert "Next experiment: a second probe at right angles: " in done.stdout
    data = json.loads((tmp_path / "out/diagnosis.json").read_text())
    assert data["fit"]["before"]["adequate"]
    assert data["fit"]["before"]["goodness"] > 1e-4
    assert (tmp_path / "out/orders_up_1.png").exists()
    assert (tmp_path / "out/residuals.png").exists()
    assert "Amplitude (0-peak) and phase lag of order vectors" in (tmp_path / "out/report.html").read_text()
    assert load(str(tmp_path / "out/diagram.json")).name == "disc"


def test_the_example_of_the_page_is_a_recording_of_orders(tmp_path):
    page = (Path(__file__).parents[2] / "docs/recordings.md").read_text(encoding="utf-8")
    [_, text] = re.findall(r"^```json\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "recording.json").write_text(text)
    rows = [f"{1000 + k},{10 + k},{90 + k},12,80" for k in range(20)]
    (tmp_path / "up.csv").write_text("\n".join(["rpm,amp_x,ph_x,amp_y,ph_y", *rows]))
    x, y = load_orders(tmp_path).runs[0].vectors.values()
    assert x[5] == pytest.approx(7.5e-6 * np.exp(-1j * np.radians(95)))
    assert y[5] == pytest.approx(6e-6 * np.exp(-1j * np.radians(80)))
