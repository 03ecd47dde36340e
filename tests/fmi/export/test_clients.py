"""Exported FMUs in independent clients; those that are not installed are skipped (CI installs them)."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest

from rotorsim.model.load import load
from rotorsim.model.part import open_part
from rotorsim.simulation.run import simulate

THESIS = [
    "jeffcott",
    "offset_disc",
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("fe_rigid", "fe_flexible")),
]
N = 200


def described(file: Path, causality: str = "output"):
    description = fmpy.read_model_description(str(file))
    chosen = [v for v in description.modelVariables if v.causality == causality]
    return description, {v.name: v.valueReference for v in chosen}


def whole(name: str) -> tuple[float, dict[str, np.ndarray]]:
    diagram = load(name)
    h = diagram.solver.step
    return h, dict(simulate(diagram, stop=N * h, record_every=1).columns())


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize(
    ("name", "blocks"),
    [("jeffcott", None), ("offset_disc", ["rotor"])]
    + [
        pytest.param(*each, marks=pytest.mark.slow)
        for each in (("offset_disc", None), ("fe_rigid", None), ("fe_flexible", None), ("fe_flexible", ["rotor"]))
    ],
)
def test_casadi_imports_it_with_our_jacobian(fmu, tmp_path, version, name, blocks):
    part = open_part(load(name), blocks)
    folder = str(fmpy.extract(str(fmu(name, version, blocks=blocks)), str(tmp_path)))
    dae = ca.DaeBuilder("model", folder, {})
    f = dae.create("f", ["t", "x", "u"], ["ode", "y"])
    rng = np.random.default_rng(3)
    t, x, u = 0.0123, rng.normal(size=dae.nx()) * 1e-5, rng.normal(size=dae.nu())
    z = part.z0()
    z[len(z) - len(u) :] = u
    ode, y = f(t, x, u)
    right = np.array(part.rhs(t, x, z, part.p0)).ravel()
    assert np.abs(np.array(ode).ravel() - right).max() < 1e-12 * np.abs(right).max()
    found = f.jacobian()(t, x, u, ode, y)
    names = dict(zip(f.jacobian().name_out(), found, strict=True))
    exact = np.array(part.jacobian(t, x, z, part.p0))
    assert np.abs(np.array(names["jac_ode_x"]) - exact).max() < 1e-14 * np.abs(exact).max()
    assert names["jac_ode_x"].nnz() == part.jacobian.sparsity_out(0).nnz()  # the sparsity that the XML tells
    if blocks:
        columns = part.trace.z[len(z) - len(u) :]
        by_input = ca.Function("b", part._arguments, [ca.jacobian(part.trace.xdot, columns)])
        exact = np.array(by_input(t, x, z, part.p0))
        assert np.abs(np.array(names["jac_ode_u"]) - exact).max() < 1e-14 * np.abs(exact).max()


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_casadi_gets_derivatives_by_parameters(fmu, tmp_path, version):
    """What the FMU leaves out counts as zero there: the judge is the diagram with other parameters, differences."""
    part = open_part(load("jeffcott"))
    dae = ca.DaeBuilder("model", str(fmpy.extract(str(fmu("jeffcott", version)), str(tmp_path))), {})
    f = dae.create("f", ["t", "x", "u", "p"], ["ode", "y"])
    rng = np.random.default_rng(3)
    t, x, u = 0.0123, rng.normal(size=dae.nx()) * 1e-5, np.zeros(0)
    p = np.array(dae.start(dae.p()), float).ravel()
    ode, y = f(t, x, u, p)
    jacobian = f.jacobian()
    found = dict(zip(jacobian.name_out(), jacobian(t, x, u, p, ode, y), strict=True))
    for name, size in (("rotor.mass", 1e-4), ("rotor.stiffness", 10.0), ("controller.KD", 1e-3), ("speed", 1e-3)):
        start = float(p[dae.p().index(name)])
        sides = []
        for value in (start + size, start - size):
            other = open_part(load("jeffcott", set={name: f"{value!r} rad/s" if name == "speed" else value}))
            sides.append(np.array(part.rhs(t, x, part.z0(), other.p0)).ravel())
        slope = (sides[0] - sides[1]) / (2 * size)
        column = np.array(found["jac_ode_p"])[:, dae.p().index(name)]
        assert np.abs(slope).max() > 0
        assert column == pytest.approx(slope, rel=1e-5, abs=1e-6 * np.abs(slope).max())
    if version == "3.0":  # acceleration by mass and stiffness, not the rate of position; current by its gains
        listed = found["jac_y_p"].sparsity()
        outputs = [
            o.name
            for o in fmpy.read_model_description(str(fmu("jeffcott", version))).modelVariables
            if o.causality == "output"
        ]
        assert listed.has_nz(outputs.index("controller.current[1]"), dae.p().index("controller.KP"))
        assert not listed.has_nz(outputs.index("rotor.displacement[1]"), dae.p().index("rotor.mass"))


@pytest.mark.parametrize("name", THESIS)
def test_fmuloader_of_fmi_2_steps_bit_for_bit(fmu, name):
    client = pytest.importorskip("fmuloader.fmi2")
    file = fmu(name)
    description, outputs = described(file)
    h, right = whole(name)
    slave = client.Fmi2Slave(str(file), model_identifier=description.coSimulation.modelIdentifier)
    slave.instantiate("one", client.Fmi2Type.CO_SIMULATION, guid=description.guid)
    slave.setup_experiment(start_time=0.0, stop_time=N * h)
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    rows = [slave.get_real(list(outputs.values()))]
    for k in range(N):
        slave.do_step(k * h, h)
        rows.append(slave.get_real(list(outputs.values())))
    slave.terminate()
    slave.free_instance()
    assert np.array_equal(np.array(rows).T, [right[n] for n in outputs])


@pytest.mark.parametrize("name", THESIS)
def test_fmuloader_of_fmi_3_solves_the_states(fmu, name):
    """Model exchange by a Runge-Kutta loop of this test: the run in process to rounding."""
    client = pytest.importorskip("fmuloader.fmi3")
    file = fmu(name, "3.0")
    description, outputs = described(file)
    h, right = whole(name)
    model = client.Fmi3Slave(str(file), model_identifier=description.modelExchange.modelIdentifier)
    model.instantiate_model_exchange("one", instantiation_token=description.guid)
    model.enter_initialization_mode(start_time=0.0)
    model.exit_initialization_mode()
    model.update_discrete_states()
    model.enter_continuous_time_mode()
    n = model.get_number_of_continuous_states()

    def rate(t, x):
        model.set_time(t)
        model.set_continuous_states(list(x))
        return np.array(model.get_continuous_state_derivatives(n))

    x, rows = np.array(model.get_continuous_states(n)), []
    for k in range(N):
        t = k * h
        k1 = rate(t, x)
        rows.append(model.get_float64(list(outputs.values())))
        k2 = rate(t + h / 2, x + h / 2 * k1)
        k3 = rate(t + h / 2, x + h / 2 * k2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(t + h, x + h * k3))
    model.terminate()
    model.free_instance()
    for name_, values in zip(outputs, np.array(rows).T, strict=True):
        assert np.abs(values - right[name_][:N]).max() <= 1e-10 * np.abs(right[name_]).max()


@pytest.mark.parametrize("name", THESIS)
def test_libcosimpy_steps_bit_for_bit(fmu, name):
    execution_of = pytest.importorskip("libcosimpy.CosimExecution").CosimExecution
    slave_of = pytest.importorskip("libcosimpy.CosimSlave").CosimLocalSlave
    observer_of = pytest.importorskip("libcosimpy.CosimObserver").CosimObserver
    file = fmu(name)
    _, outputs = described(file)
    h, right = whole(name)
    execution = execution_of.from_step_size(round(h * 1e9))
    index = execution.add_local_slave(slave_of(fmu_path=str(file), instance_name="one"))
    observer = observer_of.create_last_value()
    execution.add_observer(observer)
    for k in range(1, N + 1):
        assert execution.step()
        values = observer.last_real_values(index, list(outputs.values()))
        assert values == [right[n][k] for n in outputs]


@pytest.mark.parametrize("name", THESIS)
def test_ecospy_steps_bit_for_bit(fmu, name):
    client = pytest.importorskip("ecospy", exc_type=(ImportError, OSError))
    file = fmu(name)
    _, outputs = described(file)
    h, right = whole(name)
    with client.EcosSimulationStructure() as structure:
        structure.add_model("one", str(file))
        with client.EcosSimulation(structure=structure, step_size=h) as simulation:
            simulation.init()
            for k in range(1, N + 1):
                simulation.step()
                assert [simulation.get_real(f"one::{n}") for n in outputs] == [right[n][k] for n in outputs]
