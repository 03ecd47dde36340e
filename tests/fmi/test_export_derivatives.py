"""Derivatives that exported FMUs give: of states, directional, adjoint, of outputs by time."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from rotorsim.compile.part import open_part
from rotorsim.diagram import load
from rotorsim.simulate.run import simulate
from tests.compile.documents import sampled
from tests.fmi.opened import opened

VERSIONS = ("2.0", "3.0")


@pytest.fixture(params=VERSIONS)
def version(request):
    return request.param


def named(model, causality, prefix=""):
    return [
        v.name
        for v in model.description.modelVariables
        if v.causality == causality and v.name.startswith(prefix) and v.name != "time"
    ]


def states_of(model):
    rates = [v for v in model.description.modelVariables if v.derivative is not None]
    return [v.derivative.name for v in rates], [v.name for v in rates]


def jacobian(model, unknowns, knowns):
    u, k = model.references(unknowns), model.references(knowns)
    columns = [model.fmu.getDirectionalDerivative(u, k, list(seed)) for seed in np.eye(len(k))]
    return np.array(columns).T


def at_a_point(model, seed=1):
    """Put a model into continuous-time mode at some time, with some states and inputs; return them."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=len(states_of(model)[0])) * 1e-5
    inputs = named(model, "input")
    u = rng.normal(size=len(inputs))
    model.begin()
    model.update()
    model.fmu.enterContinuousTimeMode()
    model.fmu.setTime(0.0123)
    model.set_states(x)
    if inputs:
        model.put(inputs, u)
    return 0.0123, x, u


@pytest.mark.parametrize("name", ["jeffcott", "offset_disc", "fe_rigid", "fe_flexible"])
def test_rates_and_jacobian_are_those_of_the_diagram(fmu, version, name):
    part = open_part(load(name))
    with opened(fmu(name, version), "me") as model:
        t, x, _ = at_a_point(model)
        states, rates = states_of(model)
        outputs = named(model, "output")
        right = np.array(part.rhs(t, x, part.z0(), part.p0)).ravel()
        assert model.vector("derivatives", len(x)) == pytest.approx(right, rel=1e-9, abs=1e-12 * np.abs(right).max())
        a = np.array(part.jacobian(t, x, part.z0(), part.p0))
        assert jacobian(model, rates, states) == pytest.approx(a, rel=1e-9, abs=1e-13 * np.abs(a).max())
        y = ca.vertcat(*[part.expression(signal) for signal in part.record_names()])
        c = np.array(ca.Function("c", part._arguments, [ca.jacobian(y, part.trace.x)])(t, x, part.z0(), part.p0))
        assert jacobian(model, outputs, states) == pytest.approx(c, rel=1e-9, abs=1e-13 * np.abs(c).max())


def test_directional_derivatives_by_inputs_agree_with_differences(fmu, version):
    """Nonlinear magnetic force: central differences of the FMU itself, order 2, are the judge."""
    file = fmu(_nonlinear(), version, blocks=["rotor", "amb", "crack"])
    with opened(file, "me") as model:
        _, x, u = at_a_point(model)
        states, rates = states_of(model)
        inputs, outputs = named(model, "input"), named(model, "output")
        unknowns, knowns = [*rates, *outputs], [*states, *inputs]
        found = jacobian(model, unknowns, knowns)
        point = np.concatenate([x, u])

        def value(at):
            model.set_states(at[: len(x)])
            model.put(inputs, at[len(x) :])
            return model.get(*unknowns)

        for k, size in enumerate(np.where(np.arange(len(point)) < len(x), 1e-8, 1e-4)):
            step = np.zeros(len(point))
            step[k] = size
            slope = (value(point + step) - value(point - step)) / (2 * size)
            assert found[:, k] == pytest.approx(slope, rel=1e-5, abs=1e-6 * np.abs(slope).max() + 1e-9)


def _nonlinear():
    from rotorsim.diagram.load import shipped_diagrams
    from rotorsim.diagram.source import read_document

    made = dict(read_document(shipped_diagrams()["jeffcott"]).data)
    made["blocks"] = {**made["blocks"], "amb": {"type": "amb_nonlinear", "parameters": {}}}
    return made


def test_the_adjoint_is_the_transpose(fmu):
    with opened(fmu("fe_flexible", "3.0"), "me") as model:
        at_a_point(model)
        states, rates = states_of(model)
        unknowns, knowns = [*rates, *named(model, "output")], [*states, "time"]
        a = jacobian(model, unknowns, knowns)
        u, k = model.references(unknowns), model.references(knowns)
        rows = [model.fmu.getAdjointDerivative(u, k, list(seed), len(k)) for seed in np.eye(len(u))]
        assert np.array(rows) == pytest.approx(a, rel=1e-9, abs=1e-12 * np.abs(a).max())


def test_derivatives_by_parameters_are_refused_by_name(fmu, version):
    with opened(fmu("jeffcott", version), "me") as model:
        at_a_point(model)
        with pytest.raises(Exception, match="Derivative"):
            jacobian(model, ["der(rotor.position[1])"], ["speed"])
        assert model.messages[-1][2].endswith("Derivative: speed is no state, input or time")


def test_output_derivatives_are_slopes_of_the_trajectory(fmu, version):
    h = 1e-4
    names = ["rotor.displacement[1]", "controller.current[2]", "clock.theta"]
    with opened(fmu("jeffcott", version), "cs") as slave:
        slave.begin()
        rows = slave.walk(names, 300, h)
        vr = slave.references(names)
        get = slave.fmu.getRealOutputDerivatives if slave.two else slave.fmu.getOutputDerivatives
        slope = get(vr, [1, 1, 1])
        after = slave.walk(names, 2, h, first=300)
    around = np.array([rows[-3], rows[-2], rows[-1], after[1], after[2]])
    differences = (around[0] - 8 * around[1] + 8 * around[3] - around[4]) / (12 * h)  # order 4
    assert slope == pytest.approx(differences, rel=1e-4)


def test_input_derivatives_are_followed(fmu):
    """A ramp of force given as a slope, over communication steps of 20 ms: the motion to order 2 of the inner step."""
    file = fmu("jeffcott", "2.0", blocks=["rotor"])
    x, ramp, big = "rotor.displacement[1]", 1000.0, 0.02
    with opened(file, "cs", "cs") as (slopes, fine):
        slopes.begin()
        fine.begin()
        for k in range(5):
            slopes.put(["rotor.force[1]"], [ramp * k * big])
            slopes.fmu.setRealInputDerivatives(slopes.references(["rotor.force[1]"]), [1], [ramp])
            slopes.step(k * big, big)
        for k in range(10000):
            fine.put(["rotor.force[1]"], [ramp * (k + 0.5) * 1e-5])
            fine.step(k * 1e-5, 1e-5)
        assert slopes.get("rotor.force[1]") == pytest.approx(ramp * 0.1)
        assert slopes.get(x) == pytest.approx(fine.get(x), rel=1e-4)


@pytest.mark.parametrize("period", [5e-3, 3.3e-3])
def test_sampled_blocks_announce_their_hits_as_time_events(fmu, version, period):
    made = sampled(period, 2e-3)
    right = dict(simulate(load(made), stop=0.02).columns())
    with opened(fmu(made, version), "me") as model:
        model.begin()
        time, rows = 0.0, []
        more, hit = model.update()
        model.fmu.enterContinuousTimeMode()
        while time < 0.02:
            rows.append((time, model.get(*right)))
            time = min(hit, time + 1e-3) if more else time + 1e-3
            model.fmu.setTime(time)
            if more and time == hit:
                model.fmu.enterEventMode()
                more, hit = model.update()
                model.fmu.enterContinuousTimeMode()
    grid = [(t, row) for t, row in rows if abs(t * 1e3 - round(t * 1e3)) < 1e-9]
    for t, row in grid[:10]:
        k = round(t * 1e3)
        states = [name.startswith(("noise", "hold")) for name in right]
        told = np.array([values[k] for values in right.values()])
        assert row[states] == pytest.approx(told[states], rel=1e-12, abs=1e-12)


def test_zero_crossings_are_event_indicators(fmu, version):
    file = fmu("jeffcott", version, set={"crack.opening": "exact"})
    with opened(file, "me") as model:
        model.begin()
        model.update()
        model.fmu.enterContinuousTimeMode()
        speed = model.get("speed")[0]
        assert speed == pytest.approx(50 * np.pi)
        model.fmu.setTime(0.004)
        assert model.vector("events", 1) == pytest.approx(np.cos(speed * 0.004), rel=1e-12)
        if not model.two:
            assert model.get("crack.switch") == pytest.approx(np.cos(speed * 0.004), rel=1e-12)
