"""Some blocks as an FMU: inputs, what depends on what, and parts put together again."""

from __future__ import annotations

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from rotorsim.model.load import load
from rotorsim.simulation.run import simulate
from tests.fmi.opened import opened

H = 1e-4
SAMPLED = {"controller": {"type": "discrete_pid", "parameters": {"delay_samples": 0, "sample_time": 2e-4}}}


def sampled_jeffcott():
    from rotorsim.diagram.parse.source import read_document
    from rotorsim.diagram.resolve.resolution import shipped_diagrams

    made = dict(read_document(shipped_diagrams()["jeffcott"]).data)
    made["blocks"] = {**made["blocks"], **SAMPLED}
    return made


@pytest.fixture(params=[pytest.param("2.0", marks=pytest.mark.slow), "3.0"])
def version(request):
    return request.param


@pytest.mark.parametrize(
    ("name", "blocks"),
    [
        *(
            pytest.param(name, ["rotor"], marks=pytest.mark.slow)
            for name in ("jeffcott", "offset_disc", "fe_rigid", "fe_flexible")
        ),
        ("jeffcott", ["controller"]),
        ("offset_disc", ["rotor", "amb"]),
    ],
)
def test_parts_pass_the_validator(fmu, name, blocks):
    for version in ("2.0", "3.0"):
        file = fmu(name, version, blocks=blocks, platforms=())
        assert validate_fmu(str(file)) == []


def test_a_part_has_the_ports_of_its_blocks(fmu, version):
    description = fmpy.read_model_description(str(fmu("jeffcott", version, blocks=["rotor"], platforms=())))
    kinds = {v.name: (v.causality, v.unit, v.start) for v in description.modelVariables}
    assert kinds["rotor.force[2]"] == ("input", "N", "0.0")
    assert kinds["rotor.displacement[1]"][:2] == ("output", "m")
    assert kinds["rotor.velocity[1]"][:2] == ("output", "m/s")
    assert kinds["rotor.velocity_state[1]"][0] == "local"  # not to be taken for the port
    assert kinds["viscous_damping"] == ("parameter", "N s/m", "76.0")
    assert "speed" not in kinds  # of blocks outside
    assert description.modelName == "jeffcott: rotor"


@pytest.mark.slow
def test_the_part_put_together_with_its_sampled_controller_is_the_whole(fmu, version):
    """Rotor first, then the controller with what it reached: at the hits this is the sampled loop itself."""
    made = sampled_jeffcott()
    whole = simulate(load(made), stop=400 * H)["rotor.displacement"]
    others = [name for name in load(made).nodes if name != "controller"]
    plant_file = fmu(made, version, blocks=others, outputs=("rotor.displacement", "rotor.velocity"))
    with opened(plant_file, "cs") as plant, opened(fmu(made, version, blocks=["controller"]), "cs") as controller:
        inputs = [n for n, v in controller.variables.items() if v.causality == "input"]
        assert inputs == [f"controller.{p}[{k}]" for p in ("displacement", "velocity") for k in (1, 2)]
        sources = [f"rotor.{name[11:]}" for name in inputs]
        current = ["controller.current[1]", "controller.current[2]"]
        (to,) = {n.partition("[")[0] for n, v in plant.variables.items() if v.causality == "input"}
        plant.enter()
        controller.enter()
        controller.put(inputs, plant.get(*sources))
        controller.leave()
        plant.put([f"{to}[1]", f"{to}[2]"], controller.get(*current))
        plant.leave()
        found = [plant.get(*sources[:2])]
        for k in range(400):
            plant.step(k * H, H)
            controller.put(inputs, plant.get(*sources))
            controller.step(k * H, H)
            plant.put([f"{to}[1]", f"{to}[2]"], controller.get(*current))
            found.append(plant.get(*sources[:2]))
    assert np.abs(np.array(found) - whole).max() < 1e-12 * np.abs(whole).max()


def test_what_depends_on_what_is_told(fmu, version):
    description = fmpy.read_model_description(str(fmu("jeffcott", version, blocks=["rotor"], platforms=())))
    told = {u.variable.name: {d.name for d in u.dependencies} for u in description.outputs + description.derivatives}
    assert told["rotor.displacement[1]"] == {"rotor.position[1]"}
    moving = {"rotor.force[1]", "rotor.position[1]", "rotor.velocity_state[1]"}
    parameters = {"viscous_damping", "rotor.mass", "rotor.stiffness"} if version == "3.0" else set()  # no knowns in 2.0
    assert told["der(rotor.velocity_state[1])"] == moving | parameters
    start = {u.variable.name: {d.name for d in u.dependencies} for u in description.initialUnknowns}
    assert start["rotor.displacement[2]"] == {"rotor.initial_displacement[2]"}
    damped = {"viscous_damping", "rotor.mass", "rotor.stiffness", "rotor.force[1]"}
    initial = {"rotor.initial_displacement[1]", "rotor.initial_velocity[1]"}
    assert start["der(rotor.velocity_state[1])"] >= damped | initial


def test_a_sampled_output_is_discrete_and_follows_from_its_inputs(fmu, version):
    description = fmpy.read_model_description(
        str(fmu(sampled_jeffcott(), version, blocks=["controller"], platforms=()))
    )
    kinds = {v.name: v.variability for v in description.modelVariables}
    assert kinds["controller.current[1]"] == "discrete"
    assert kinds["controller.sample_time"] == "fixed"
    assert kinds["controller.KP"] == "tunable"
    told = {u.variable.name: {d.name for d in u.dependencies} for u in description.outputs}
    gains = {"controller.KP", "controller.KI", "controller.KD", "controller.sample_time"} if version == "3.0" else set()
    assert told["controller.current[1]"] == {"controller.displacement[1]", "controller.velocity[1]"} | gains


def test_an_additive_input_can_be_added(fmu, version):
    with opened(fmu("jeffcott", version, inputs=("rotor.force",)), "cs") as slave:
        slave.begin()
        rows = slave.walk(["rotor.displacement[1]"], 50, H)
        slave.put(["rotor.force[1]"], [100.0])
        pushed = slave.walk(["rotor.displacement[1]"], 50, H, first=50)
    whole = simulate(load("jeffcott"), stop=100 * H)["rotor.displacement"][:, 0]
    assert rows[:, 0] == pytest.approx(whole[:51], rel=1e-10, abs=1e-16)
    # m x'' = f at first: 100 N on 2 kg for half a millisecond
    assert pushed[5, 0] - whole[55] == pytest.approx(0.5 * 50.0 * (5 * H) ** 2, rel=0.2)


def test_arrays_hold_what_the_scalars_hold(fmu):
    scalars, arrays = fmu("jeffcott", "3.0"), fmu("jeffcott", "3.0", arrays=True)
    with opened(scalars, "cs") as one, opened(arrays, "cs") as two:
        assert two.variables["rotor.displacement"].dimensions[0].start == 2
        two.fmu.setFloat64(two.references(["rotor.initial_velocity"]), [0.0, 0.01])
        one.put(["rotor.initial_velocity[2]"], [0.01])
        one.begin()
        two.begin()
        h = load("jeffcott").solver.step
        for k in range(20):
            one.step(k * h, h)
            two.step(k * h, h)
        found = two.get("rotor.displacement", size=2)
        assert np.array_equal(one.get("rotor.displacement[1]", "rotor.displacement[2]"), found)
        assert found[1] > 1e-5
        with pytest.raises(Exception, match="fmi3GetFloat64"):
            two.get("rotor.displacement", size=1)


def test_fixed_parameters(fmu, version):
    description = fmpy.read_model_description(str(fmu("jeffcott", version, fixed=True, platforms=())))
    assert {v.variability for v in description.modelVariables if v.causality == "parameter"} == {"fixed"}
