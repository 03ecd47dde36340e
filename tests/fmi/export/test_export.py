"""Exported diagrams: valid, and the same trajectories as a run in process."""

from __future__ import annotations

import zipfile

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from rotorsim.errors import RotorsimError
from rotorsim.fmi.export.export import export_fmu
from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from tests.fmi.opened import opened
from tests.model.documents import document, oscillator, sampled

VERSIONS = ("2.0", "3.0")


def columns(diagram, stop, **options):
    return dict(simulate(diagram, stop=stop, record_every=1, **options).columns())


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(
    "name", ["jeffcott", *(pytest.param(n, marks=pytest.mark.slow) for n in ("offset_disc", "fe_rigid", "fe_flexible"))]
)
def test_thesis_diagrams_pass_the_validator_and_run_bit_for_bit(fmu, name, version):
    file, diagram = fmu(name, version), load(name)
    assert validate_fmu(str(file)) == []
    h, n = diagram.solver.step, 200
    right = columns(diagram, n * h)
    with opened(file, "cs") as slave:
        slave.begin()
        rows = slave.walk(list(right), n, h)
    for k, values in enumerate(right.values()):
        assert np.array_equal(rows[:, k], values)


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_simulates_both_kinds(fmu, version):
    diagram = load("jeffcott")
    right = columns(diagram, 0.1)
    told = {"stop_time": 0.1, "output_interval": diagram.solver.step}
    stepped = fmpy.simulate_fmu(str(fmu("jeffcott", version)), fmi_type="CoSimulation", **told)
    solved = fmpy.simulate_fmu(str(fmu("jeffcott", version)), fmi_type="ModelExchange", relative_tolerance=1e-9, **told)
    exact = columns(diagram, 0.1, method="dop853")
    for name, values in right.items():
        assert np.array_equal(stepped[name], values)
        assert np.abs(solved[name][: len(values)] - exact[name]).max() < 1e-5 * np.abs(values).max()


@pytest.mark.parametrize("arrays", [False, True])
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.slow
def test_every_kind_of_diagram_passes_the_validator(fmu, version, arrays):
    if arrays and version == "2.0":
        pytest.skip("FMI 2.0 has no arrays")
    for source in (sampled(3.3e-3), oscillator(), _stateless()):
        assert validate_fmu(str(fmu(source, version, arrays=arrays, platforms=()))) == []
    exact = {"crack.opening": "exact"}
    assert validate_fmu(str(fmu("jeffcott", version, arrays=arrays, set=exact, platforms=()))) == []


def _stateless():
    return document(
        {"wave": ("sine", {}), "twice": ("gain", {"gain": 2.0})}, [["wave.output", "twice.input"]], ["twice.output"]
    )


def test_a_diagram_without_states_runs(fmu):
    right = columns(load(_stateless()), 0.05)["twice.output"]
    with opened(fmu(_stateless()), "cs") as slave:
        slave.begin()
        assert np.array_equal(slave.walk(["twice.output"], 50, 1e-3)[:, 0], right)


@pytest.mark.parametrize("period", [5e-3, 3.3e-3])
@pytest.mark.parametrize("version", VERSIONS)
def test_sample_hits_and_noise_are_those_of_a_run_in_process(fmu, version, period):
    made = sampled(period, 2e-3)
    right = columns(load(made), 0.05)
    with opened(fmu(made, version), "cs") as slave:
        slave.begin()
        rows = slave.walk(list(right), 50, 1e-3)
    assert np.array_equal(rows.T, list(right.values()))


def test_a_communication_step_of_many_steps_is_the_same_run(fmu):
    right = columns(load("jeffcott"), 0.1)["rotor.displacement[1]"]
    with opened(fmu("jeffcott"), "cs") as slave:
        slave.begin()
        rows = slave.walk(["rotor.displacement[1]"], 10, 0.01)[:, 0]
    assert np.array_equal(rows, right[::100])


def test_a_communication_step_off_the_grid_is_cut_into_equal_steps(fmu):
    diagram = load("jeffcott")
    exact = columns(diagram, 0.1, method="dop853")["rotor.displacement[1]"]
    with opened(fmu("jeffcott"), "cs") as slave:
        slave.begin()
        rows = slave.walk(["rotor.displacement[1]"], 16, 0.00625)[:, 0]
        slave.step(0.1, 1.23e-6)  # shorter than a step of the model
    own = columns(diagram, 0.1)["rotor.displacement[1]"]
    assert np.abs(rows[::2] - exact[::125]).max() <= 1.1 * np.abs(own - exact).max()


@pytest.mark.slow
def test_scalars_have_structured_names_units_and_bounds(fmu):
    description = fmpy.read_model_description(str(fmu("fe_rigid", platforms=())))
    variables = {v.name: v for v in description.modelVariables}
    assert variables["rotor.displacement[3,2]"].unit == "m"
    assert variables["speed"].unit == "rad/s"
    assert variables["speed"].displayUnit == "rpm"
    assert variables["controller.KP"].variability == "tunable"
    assert float(variables["rotor.disc_mass[1]"].min) == 0.0
    assert variables["der(rotor.position[1,1])"].derivative.name == "rotor.position[1,1]"
    units = {u.name: u.baseUnit for u in description.unitDefinitions}
    assert (units["N/m"].kg, units["N/m"].s, units["N/m"].m, units["N/m"].factor) == (1, -2, 0, 1.0)
    assert "clock.speed_parameter" not in variables  # it follows the diagram parameter


@pytest.mark.parametrize("version", VERSIONS)
def test_the_same_export_gives_the_same_bytes(tmp_path, version):
    for name in ("a.fmu", "b.fmu"):
        export_fmu(load("jeffcott"), tmp_path / name, version=version)
    assert (tmp_path / "a.fmu").read_bytes() == (tmp_path / "b.fmu").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.fmu") as archive:
        names = archive.namelist()
    assert "modelDescription.xml" in names
    assert f"sources/fmi{version[0]}.c" in names


@pytest.mark.slow
def test_the_sources_compile_alone_with_one_command(fmu, tmp_path):
    import subprocess

    from rotorsim.model.emit.toolchain import find_compiler

    compiler = find_compiler()
    assert compiler is not None
    for version in VERSIONS:
        with zipfile.ZipFile(fmu("jeffcott", version)) as archive:
            archive.extractall(tmp_path / version)
        command = [*compiler.command, "-std=c99", "-O0", "-Wall", "-Werror", "-Wno-unused-function", "-fPIC", "-shared"]
        command += [f"fmi{version[0]}.c", "-o", "x.so", "-lm"]
        done = subprocess.run(command, cwd=tmp_path / version / "sources", capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def test_mistakes_of_the_caller(tmp_path):
    diagram = load("jeffcott")
    for options, said in (
        ({"version": "1.0"}, "unknown version of FMI '1.0'"),
        ({"arrays": True}, "FMI 2.0 has no arrays"),
        ({"blocks": ["roter"]}, "no such block"),
        ({"platforms": ["linux46"]}, "did you mean 'linux64'"),
        ({"outputs": ["rotor.place"]}, "no such signal"),
        ({"inputs": ["rotor.nothing"]}, "no such"),
    ):
        with pytest.raises(RotorsimError, match=said):
            export_fmu(diagram, tmp_path / "x.fmu", **options)
    assert not list(tmp_path.iterdir())
