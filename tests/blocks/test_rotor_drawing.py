"""The rotor from a drawing against exact shafts, beam formulas, and the rotor of nodes."""

import numpy as np
import pytest
from rotorsim.blocks.common import beam
from rotorsim.blocks.common.drawing import cylinder
from rotorsim.blocks.common.mesh import meshed

from tests.blocks.evaluation import prepare
from tests.blocks.shafts import ExactShaft, cowper, drawn, frequencies, linear, receptance

E, RHO, NU = 2.1e11, 7850.0, 0.3
LENGTHS = [0.06, 0.10, 0.14, 0.30, 0.14, 0.10, 0.06]
OUTER = [0.030, 0.048, 0.040, 0.045, 0.040, 0.048, 0.030]
INNER = [0.0, 0.0, 0.0, 0.020, 0.0, 0.0, 0.0]
SIZES = {"outer_diameter": OUTER, "inner_diameter": INNER, "gravity": 0.0}
DISCS = {
    "drawn_disc_outer_diameter": [0.18, 0.16],
    "drawn_disc_inner_diameter": [0.045, 0.045],
    "drawn_disc_width": [0.05, 0.055],
}
AT = [0.32, 0.56]
STATIONS = [0.09, 0.11, 0.32, 0.56, 0.79, 0.81]


def discs_by_hand():
    """Return (z, m, I_p, I_d) of the discs as differences of solid cylinders."""
    found = []
    for z, outer, inner, width in zip(AT, *DISCS.values(), strict=True):
        solid = [(RHO * np.pi * r**2 * width, r) for r in (outer / 2, inner / 2)]
        mass = solid[0][0] - solid[1][0]
        polar = sum(s * m * r**2 / 2 for s, (m, r) in zip((1, -1), solid, strict=True))
        diametral = sum(s * m * (3 * r**2 + width**2) / 12 for s, (m, r) in zip((1, -1), solid, strict=True))
        found.append((z, mass, polar, diametral))
    return found


def exact():
    return ExactShaft(list(zip(LENGTHS, OUTER, INNER, strict=True)), discs_by_hand())


def machine(**options):
    return drawn(LENGTHS, STATIONS, {**SIZES, **DISCS}, drawn_disc_positions=AT, **options)


# --- natural frequencies ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_free_stepped_hollow_shaft_with_discs_has_the_frequencies_of_transfer_matrices():
    exactly = exact().frequencies(100.0, 1500.0)
    assert len(exactly) == 4
    errors = [frequencies(machine(subdivisions=n), above=20.0)[: 2 * 4 : 2] / exactly - 1 for n in (1, 2, 4)]
    assert np.all(errors[2] > 0)  # consistent masses: from above
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.05)  # with the square of the length of the elements
    assert errors[2].max() < 1e-4
    assert errors[0].max() < 2e-3  # the mesh that it makes by itself


@pytest.mark.slow
def test_gyroscopic_moments_of_shaft_and_discs_split_them_as_transfer_matrices_do():
    speed = 9000 * np.pi / 30
    both = np.sort(np.concatenate([exact().frequencies(100, 1300, w) for w in (speed, -speed)]))
    found = [frequencies(machine(subdivisions=n), speed, above=20.0) for n in (2, 4)]
    errors = [(f[(f > 100) & (f < 1300)] / both - 1) for f in found]
    assert len(both) == 7
    assert both[5] / both[4] > 1.2  # they do split
    assert np.abs(errors[1]).max() < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)


def test_a_free_uniform_slender_beam_has_the_published_frequencies():
    """Euler-Bernoulli, free-free: beta L of Blevins (1979), table 8-1."""
    d, length = 0.02, 1.0
    block = drawn([length], [0.0, 1.0], {"outer_diameter": d, "gravity": 0.0}, theory="euler_bernoulli",
                  rotary_inertia=False, shaft_gyroscopic=False, longest_element=0.025)  # fmt: skip
    beta = np.array([4.73004074, 7.85320462, 10.9956079])
    expected = beta**2 / (2 * np.pi * length**2) * np.sqrt(E * d**2 / (16 * RHO))
    assert frequencies(block)[:6:2] == pytest.approx(expected, rel=5e-6)


def test_it_is_the_rotor_of_nodes_on_the_same_mesh():
    rng = np.random.default_rng(3)
    lengths, n = rng.uniform(0.05, 0.1, 6), 7
    sizes = {"outer_diameter": rng.uniform(0.03, 0.05, 6), "inner_diameter": rng.uniform(0.0, 0.02, 6)}
    discs = {"disc_mass": [3.0, 2.0], "disc_polar_inertia": [0.02, 0.01], "disc_diametral_inertia": [0.012, 0.007]}
    damping = {"mass_damping": 0.7, "stiffness_damping": 2e-5}
    ends = [0.0, *np.cumsum(lengths).tolist()]
    options = {"theory": "timoshenko", "rotary_inertia": True, "shaft_gyroscopic": True}
    ports = {"force": (n, 2), "moment": (n, 2), "speed": ()}
    values = {**sizes, **discs, **damping}
    nodes = prepare("rotor_fe", ports, {**values, "element_length": lengths},
                    {"elements": 6, "disc_nodes": [2, 5], "subdivisions": 2, **options})  # fmt: skip
    stations = drawn(lengths.tolist(), ends, {**values, "gravity": 0.0}, disc_positions=[ends[1], ends[4]],
                     longest_element=1.0, subdivisions=2)  # fmt: skip
    inputs = {"force": rng.normal(size=(n, 2)), "moment": rng.normal(size=(n, 2)), "speed": 700.0}
    states = {key: rng.normal(size=nodes.state_shapes[key]) * 1e-4 for key in ("position", "velocity")}
    one, other = nodes.evaluate(inputs, states), stations.evaluate(inputs, states)
    for kind in ("outputs", "derivatives"):
        for key, value in getattr(one, kind).items():
            assert getattr(other, kind)[key] == pytest.approx(value, rel=1e-10, abs=1e-10 * np.abs(value).max()), key


# --- gravity ----------------------------------------------------------------------------------------------------------


def held(block, rows):
    """Return displacements [station] and reactions in y of a rotor at rest that is held at these rows."""
    a, b, c, rest = linear(block)
    n = len(a) // 2
    at = [2 * row + 1 for row in rows]
    across = [2 * row for row in rows]
    system = np.block([[a[n:, :n], b[n:, at + across]], [c[at + across, :n], np.zeros((2 * len(at), 2 * len(at)))]])
    scale = np.abs(system).max(axis=1)
    found = np.linalg.solve(system / scale[:, None], np.concatenate([-rest[n:], np.zeros(2 * len(at))]) / scale)
    return (c[:, :n] @ found[:n])[1 : 2 * block.shapes["force"][0] : 2], found[n : n + len(at)]


@pytest.mark.parametrize("theory", ["euler_bernoulli", "timoshenko"])
def test_a_simply_supported_shaft_sags_under_its_weight_as_a_beam_does(theory):
    """5 w l^4 / (384 E I), with shear w l^2 / (8 kappa G A) more (Timoshenko); half the weight each."""
    d, length, g = 0.05, 0.8, 9.81
    area, second = np.pi * d**2 / 4, np.pi * d**4 / 64
    weight = RHO * area * g
    expected = 5 * weight * length**4 / (384 * E * second)
    if theory == "timoshenko":
        expected += weight * length**2 / (8 * cowper(0.0, d) * E / (2 * (1 + NU)) * area)
    block = drawn([length], [0.0, 0.4, length], {"outer_diameter": d}, theory=theory, longest_element=0.2)
    sag, reactions = held(block, [0, 2])
    assert sag[1] == pytest.approx(-expected, rel=1e-7)
    assert reactions == pytest.approx([weight * length / 2] * 2, rel=1e-7)


def test_static_bearing_loads_are_those_of_the_lever_rule():
    block = drawn(LENGTHS, STATIONS, {**SIZES, **DISCS, "gravity": 9.81}, drawn_disc_positions=AT)
    ends = np.cumsum([0.0, *LENGTHS])
    masses = [np.pi / 4 * (o**2 - i**2) * w * RHO for o, i, w in zip(OUTER, INNER, LENGTHS, strict=True)]
    parts = [*zip((ends[1:] + ends[:-1]) / 2, masses, strict=True), *((z, m) for z, m, *_ in discs_by_hand())]
    right = sum(m * 9.81 * (z - 0.11) for z, m in parts) / (0.79 - 0.11)
    total = sum(m * 9.81 for _, m in parts)
    _, reactions = held(block, [1, 4])
    assert reactions == pytest.approx([total - right, right], rel=1e-7)


def test_gravity_accelerates_a_free_rotor_by_g_and_turns_nothing():
    values = {**SIZES, **DISCS, "disc_mass": 1.5, "gravity": 9.81}
    options = {"drawn_disc_positions": AT, "disc_positions": [0.005], "shortest_element": 0.01}  # a disc within a beam
    block = drawn(LENGTHS, STATIONS, values, **options)
    rates = block.evaluate({"speed": 300.0}).derivatives["velocity"]
    assert rates[:, 0] == pytest.approx(0.0, abs=1e-12)
    assert rates[::2, 1] == pytest.approx(-9.81, rel=1e-9)
    assert rates[1::2, 1] == pytest.approx(0.0, abs=1e-8)


# --- stations ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shortest", [0.0, 0.05])
def test_the_flexibility_between_any_two_stations_is_symmetric(shortest):
    """Betti: also between forces and moments, and where stations and a disc lie within a beam."""
    block = drawn(LENGTHS, STATIONS, {**SIZES, "disc_mass": 3.0, "disc_diametral_inertia": 0.01},
                  disc_positions=[0.173], shortest_element=shortest, longest_element=0.3)  # fmt: skip
    assert block.state_shapes["position"][0] == (2 * 10 if shortest else 2 * 15)
    found = receptance(block, 87.0)
    assert found == pytest.approx(found.T, rel=1e-9, abs=1e-9 * np.abs(found).max())
    assert abs(found[0, 6]) > 0.01 * np.abs(found[0, 0])


def test_a_station_too_near_to_a_node_is_softer_there_by_less_than_is_stated():
    """The beam between its ends: less than s^3 / (3 E I) + s / (kappa G A), s: how near."""
    near = 0.160 + 0.0044
    values = {**SIZES, **DISCS}
    one, exactly = (
        drawn(LENGTHS, [near], values, drawn_disc_positions=AT, shortest_element=shortest) for shortest in (0.0, 1e-5)
    )
    assert exactly.state_shapes["position"][0] == one.state_shapes["position"][0] + 2
    lost = (receptance(exactly, 10.0)[1, 1] - receptance(one, 10.0)[1, 1]).real
    d, s = 0.04, 0.0044
    area, second = np.pi * d**2 / 4, np.pi * d**4 / 64
    most = s**3 / (3 * E * second) + s / (cowper(0.0, d) * E / (2 * (1 + NU)) * area)
    assert 0.3 * most < lost < most


def test_shapes_within_a_beam_are_those_of_its_mass_matrices():
    length, phi = 0.13, 0.7
    points, weights = np.polynomial.legendre.leggauss(6)
    z, w = length * (points + 1) / 2, weights * length / 2
    both = [beam.shapes(length, phi, at) for at in z]
    for which, expected in (
        (0, beam.translation_mass(3.0 * length, length, phi)),
        (1, beam.rotary_mass(3.0, length, phi)),
    ):
        rows = np.array([pair[which] for pair in both])
        assert np.einsum("k,ki,kj->ij", 3.0 * w, rows, rows) == pytest.approx(np.array(expected), rel=1e-12, abs=1e-15)
    assert beam.shapes(length, phi, 0.0) == ([1, 0, 0, 0], [0, 1, 0, 0])
    assert np.array(beam.shapes(length, phi, length)) == pytest.approx(
        np.array([[0, 0, 1, 0], [0, 0, 0, 1]]), abs=1e-14
    )


def test_beams_end_at_sections_discs_and_stations_but_not_too_near_to_one_another():
    mesh = meshed([0.3, 0.3], [0.3000000000000001, 0.1, 0.102, 0.55, 0.7], longest=0.2, shortest=0.003, subdivisions=1)
    assert mesh.ends == pytest.approx([0.0, 0.1, 0.3, 0.425, 0.55, 0.6])
    assert mesh.sections == (0, 0, 1, 1, 1)
    assert mesh.place(0.3000000000000001) == (2, 0.0)
    assert mesh.place(0.102) == (1, pytest.approx(0.002))
    assert mesh.place(0.6) == (5, 0.0)
    assert len(meshed([0.3, 0.3], [0.1], 0.2, 0.003, 3).ends) == 3 * 4 + 1  # 0, 0.1, 0.3, 0.45, 0.6
    assert len(meshed([0.6], [], 0.0, 0.0, 1).ends) == 13


# --- discs ------------------------------------------------------------------------------------------------------------


def test_a_disc_by_dimensions_is_the_difference_of_two_solid_cylinders():
    for (_, *expected), size in zip(discs_by_hand(), zip(*DISCS.values(), strict=True), strict=True):
        assert cylinder(RHO, *size) == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow
def test_discs_by_dimensions_are_discs_of_their_mass_and_inertias():
    _, mass, polar, diametral = zip(*discs_by_hand(), strict=True)
    values = {"disc_mass": mass, "disc_polar_inertia": polar, "disc_diametral_inertia": diametral}
    given = drawn(LENGTHS, STATIONS, {**SIZES, **values}, disc_positions=AT)
    one, other = (frequencies(block, 600.0) for block in (machine(), given))
    rounding = 10 * np.finfo(float).eps * one[-1] ** 2  # of the largest eigenvalue, in each
    assert one[:10] ** 2 == pytest.approx(other[:10] ** 2, rel=1e-9, abs=rounding)


# --- other programs ---------------------------------------------------------------------------------------------------


def test_ross_finds_the_same_natural_frequencies():
    """ROSS (Timoshenko elements, Cowper's coefficient) on the same mesh: all else is its own code."""
    rs = pytest.importorskip("ross")
    speed = 9000 * np.pi / 30
    option = machine().block.option
    mesh = meshed(LENGTHS, [*AT, *STATIONS], option.longest_element, option.shortest_element, 1)
    steel = rs.Material(name="drawn", rho=RHO, E=E, Poisson=NU)
    shaft = [
        rs.ShaftElement(L=b - a, idl=INNER[s], odl=OUTER[s], material=steel, shear_effects=True, rotary_inertia=True,
                        gyroscopic=True, n=k)
        for k, (a, b, s) in enumerate(zip(mesh.ends[:-1], mesh.ends[1:], mesh.sections, strict=True))
    ]  # fmt: skip
    discs = [rs.DiskElement(n=mesh.place(z)[0], m=m, Ip=ip, Id=i) for z, m, ip, i in discs_by_hand()]
    bearings = [rs.BearingElement(n=mesh.place(z)[0], kxx=2e6, cxx=4e3) for z in (0.11, 0.79)]
    rotor = rs.Rotor(shaft, discs, bearings)
    theirs = np.sort(rotor.run_modal(speed, num_modes=60).wd) / (2 * np.pi)
    a, b, c, _ = linear(machine(), speed)
    n, rows = len(a) // 2, [2, 3, 8, 9]  # x and y of the magnets
    rates = np.hstack([np.zeros((len(rows), n)), c[rows, :n]])
    closed = a - b[:, rows] @ (2e6 * c[rows] + 4e3 * rates)
    ours = np.sort(np.linalg.eigvals(closed).imag) / (2 * np.pi)
    ours = ours[(ours > 20) & (ours < 1500)]
    assert len(ours) == 12
    nearest = theirs[np.abs(theirs[:, None] - ours).argmin(axis=0)]  # theirs has torsion and stretching, too
    assert ours == pytest.approx(nearest, rel=1e-6)  # of its sparse eigenvalue solver; 4e-8 was seen
