"""Derivatives that exported FMUs give: of states, directional, adjoint, of outputs by time."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from rotorsim.model.load import load
from rotorsim.model.part import open_part
from rotorsim.simulation.run import simulate
from tests.fmi.opened import opened
from tests.model.documents import sampled


@pytest.fixture(params=[pytest.param("2.0", marks=pytest.mark.slow), "3.0"])
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


@pytest.mark.parametrize(
    "name",
    ["jeffcott", "offset_disc", *(pytest.param(beam, marks=pytest.mark.slow) for beam in ("fe_rigid", "fe_flexible"))],
)
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
    from rotorsim.diagram.parse.source import read_document
    from rotorsim.diagram.resolve.resolution import shipped_diagrams

    made = dict(read_document(shipped_diagrams()["jeffcott"]).data)
    made["blocks"] = {**made["blocks"], "amb": {"type": "amb_nonlinear", "parameters": {}}}
    return made


def test_the_adjoint_is_the_transpose(fmu):
    with opened(fmu("offset_disc", "3.0"), "me") as model:
        at_a_point(model)
        states, rates = states_of(model)
        unknowns, knowns = [*rates, *named(model, "output")], [*states, "time", "rotor.mass", "speed"]
        a = jacobian(model, unknowns, knowns)
        u, k = model.references(unknowns), model.references(knowns)
        rows = [model.fmu.getAdjointDerivative(u, k, list(seed), len(k)) for seed in np.eye(len(u))]
        assert np.array(rows) == pytest.approx(a, rel=1e-9, abs=1e-12 * np.abs(a).max())


def parameters_of(model):
    return {v.name: float(v.start) for v in model.description.modelVariables if v.causality == "parameter"}


def by_differences(model, names, sizes, unknowns):
    """Central differences of the FMU itself, order 2."""
    columns = []
    for name, size in sizes.items():
        sides = []
        for sign in (1.0, -1.0):
            model.put([name], [names[name] + sign * size])
            sides.append(model.get(*unknowns))
        model.put([name], [names[name]])
        columns.append((sides[0] - sides[1]) / (2 * size))
    return np.array(columns).T


SIZES = {
    "rotor.mass": 1e-4,
    "rotor.stiffness": 1.0,
    "speed": 1e-4,
    "eccentricity": 1e-8,
    "controller.KP": 1e-1,
    "crack_stiffness": 1.0,
    "force_displacement_factor": 1.0,
}


def test_directional_derivatives_by_parameters_agree_with_differences(fmu, version):
    with opened(fmu("jeffcott", version), "me") as model:
        at_a_point(model)
        start = parameters_of(model)
        unknowns = [*states_of(model)[1], *named(model, "output")]
        found = jacobian(model, unknowns, list(SIZES))
        slopes = by_differences(model, start, SIZES, unknowns)
    scale = np.abs(slopes).max(axis=0)
    assert (scale > 0).all()
    assert np.abs(found - slopes).max(axis=0) == pytest.approx(np.zeros(len(SIZES)), abs=1e-6 * scale.max())
    assert found / scale == pytest.approx(slopes / scale, abs=1e-6)


def test_what_is_not_listed_does_not_depend_on_the_parameter(fmu):
    """FMI 3.0: a known that is not among the dependencies has derivative zero, also a parameter."""
    with opened(fmu("jeffcott", "3.0"), "me") as model:
        at_a_point(model)
        start = parameters_of(model)
        unknowns = [*model.description.derivatives, *model.description.outputs]
        told = {u.variable.name: {d.name for d in u.dependencies} for u in unknowns}
        tunable = [v.name for v in model.description.modelVariables if v.variability == "tunable" and start[v.name]]
        slopes = by_differences(model, start, {n: 1e-3 * abs(start[n]) for n in tunable}, list(told))
    depends = {u for u in told if "rotor.mass" in told[u]}
    assert depends == {"der(rotor.velocity_state[1])", "der(rotor.velocity_state[2])"}
    assert told["controller.current[1]"] >= {"controller.KP", "controller.KI", "controller.KD", "rotor.position[1]"}
    assert len(tunable) > 10
    for k, name in enumerate(tunable):
        for row, unknown in enumerate(told):
            assert name in told[unknown] or slopes[row, k] == 0.0, (unknown, name)


def test_in_initialization_mode_the_states_follow_the_parameters(fmu, version):
    """Knowns are then what is exact: the start position is not, it is set by a parameter."""
    with opened(fmu("jeffcott", version), "me") as model:
        model.enter()
        knowns = ["rotor.initial_displacement[1]", "rotor.mass", "speed"]
        unknowns = ["rotor.position[1]", "der(rotor.velocity_state[1])", "rotor.displacement[1]", "clock.theta"]
        sizes = dict(zip(knowns, (1e-7, 1e-4, 1e-3), strict=True))
        found = jacobian(model, unknowns, knowns)
        slopes = by_differences(model, parameters_of(model), sizes, unknowns)
        assert found[0] == pytest.approx([1.0, 0.0, 0.0])
        assert abs(found[1, 0]) > 1e4  # stiffness by mass
        assert found == pytest.approx(slopes, rel=1e-6, abs=1e-6)
        if not model.two:
            u, k = model.references(unknowns), model.references(knowns)
            rows = [model.fmu.getAdjointDerivative(u, k, list(seed), len(k)) for seed in np.eye(len(u))]
            assert np.array(rows) == pytest.approx(found, rel=1e-9)
        model.leave()


def test_what_is_no_known_is_refused_by_name(fmu, version):
    with opened(fmu("jeffcott", version), "me") as model:
        at_a_point(model)
        with pytest.raises(Exception, match="Derivative"):
            jacobian(model, ["der(rotor.position[1])"], ["rotor.displacement[1]"])
        right = "Derivative: rotor.displacement[1] is no state, input, parameter or time"
        assert model.messages[-1][2].endswith(right)


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
