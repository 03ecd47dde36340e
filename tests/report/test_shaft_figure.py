"""The picture of a shaft: to scale, in mm, with what is wired to it where it is."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import Polygon, Rectangle

from rotorsim.errors import RotorsimError
from rotorsim.model.load import load
from rotorsim.report.figures.run import save_figure
from rotorsim.report.figures.shaft import Mark, marks_of, shaft_figure, shaft_of, spread
from rotorsim.report.style import ORANGE
from tests.blocks.test_casing import between


def boxes(axes) -> list[tuple[float, ...]]:
    """Return left, bottom, width and height of all pieces [mm]."""
    corners = [p.get_xy() for p in axes.patches if isinstance(p, Polygon)]
    corners += [p.get_corners() for p in axes.patches if isinstance(p, Rectangle)]
    return [tuple(np.round([*c.min(axis=0), *np.ptp(c, axis=0)], 6).tolist()) for c in corners]


@pytest.mark.slow
def test_the_drawn_rotor_is_drawn_to_scale_with_what_is_wired_to_it(tmp_path: Path) -> None:
    diagram = load("drawn_rotor")
    made = shaft_figure(diagram)
    axes = made.axes[0]
    assert axes.get_aspect() == 1.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("along the shaft [mm]", "[mm]")
    found = boxes(axes)
    assert (160.0, -20.0, 140.0, 40.0) in found  # third section
    assert (300.0, -10.0, 300.0, 20.0) in found  # bore
    assert (295.0, 22.5, 50.0, 67.5) in found  # upper half of the first disc
    magnets = [p for p in axes.patches if isinstance(p, Rectangle) and p.get_facecolor()[:3] == rgb(ORANGE)]
    assert sorted({p.get_x() + p.get_width() / 2 for p in magnets}) == pytest.approx([110.0, 790.0])
    texts = {text.get_text() for text in axes.texts}
    assert {"magnet A\namb_a\n110 mm", "probe A\ncontroller_a\n90 mm", "disc 2\nunbalance2\n560 mm", "6"} <= texts
    [below] = made.legends
    labels = [text.get_text() for text in below.get_texts()]
    assert labels[:3] == ["shaft", "bore", "disc"]
    assert labels[-1] == "centre of gravity, 437.3 mm"
    assert made.get_suptitle() == "drawn_rotor: rotor, 900 mm, 26.63 kg"
    save_figure(made, tmp_path / "shaft.png")
    assert (tmp_path / "shaft.png").stat().st_size > 10_000


def rgb(colour: str) -> tuple[float, ...]:
    return tuple(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))


def test_mass_and_centre_of_gravity_are_those_of_its_parts() -> None:
    _, shaft = shaft_of(load("drawn_rotor"))
    values = load("drawn_rotor").nodes["rotor"].values
    ends = np.cumsum([0.0, 60, 100, 140, 300, 140, 100, 60]) / 1e3
    area = np.pi / 4 * (values["outer_diameter"] ** 2 - values["inner_diameter"] ** 2)
    masses = 7850.0 * area * np.diff(ends)
    discs = 7850 * np.pi / 4 * np.array([(0.18**2 - 0.045**2) * 0.05, (0.16**2 - 0.045**2) * 0.055])
    moment = masses @ (ends[1:] + ends[:-1]) / 2 + discs @ [0.32, 0.56]
    assert shaft.mass == pytest.approx(masses.sum() + discs.sum(), rel=1e-12)
    assert shaft.centre_of_gravity == pytest.approx(moment / shaft.mass, rel=1e-12)


def test_marks_of_nodes() -> None:
    found = set(marks_of(load("two_amb_rotor"), "rotor"))
    assert found == {
        Mark(4, "crack", "crack"),
        Mark(2, "probe", "controller_a"),
        Mark(6, "probe", "controller_b"),
        Mark(1, "magnet", "amb_a"),
        Mark(7, "magnet", "amb_b"),
        Mark(3, "unbalance", "unbalance1"),
        Mark(5, "unbalance", "unbalance2"),
    }


@pytest.mark.slow
def test_marks_are_found_through_a_casing() -> None:
    """A bearing between rotor and casing acts on both, through sums and gains."""
    wired = between()
    wired["blocks"]["rotor"] = {
        "type": "rotor_drawing",
        "parameters": {"section_lengths": [0.4], "outer_diameter": 0.03, "stations": [0.1, 0.3]},
    }
    wired["blocks"]["rest"] = {"type": "constant", "parameters": {"value": 0.0}}
    wired["blocks"]["pid"] = {"type": "pid"}
    ends = {"displacement": "[2]", "velocity": "[2]", "force": "[1]"}
    wired["wires"] = [
        [end + (ends[end[6:]] if end.startswith("rotor.") else "") for end in wire] for wire in wired["wires"]
    ]
    wired["wires"] += [["rest.output", "rotor.speed"], ["gap.output", "pid.displacement"]]
    assert set(marks_of(load(wired), "rotor")) == {Mark(0, "bearing", "bearing"), Mark(1, "probe", "pid")}


def test_a_disc_given_by_mass_and_inertias_is_drawn_as_the_cylinder_that_has_them() -> None:
    node = load("fe_flexible").nodes["rotor"]
    keys = ("disc_mass", "disc_polar_inertia", "disc_diametral_inertia")
    mass, polar, diametral = (float(node.values[key][0]) for key in keys)
    axes = shaft_figure(load("fe_flexible")).axes[0]
    [disc] = [p for p in axes.patches if isinstance(p, Rectangle) and p.get_linestyle() == "--" and p.get_x() < 150]
    radius, width = disc.get_height() / 2e3, disc.get_width() / 1e3
    assert disc.get_x() + disc.get_width() / 2 == pytest.approx(100.0)
    assert mass * radius**2 / 2 == pytest.approx(polar, rel=1e-12)
    assert mass * (3 * radius**2 + width**2) / 12 == pytest.approx(diametral, rel=1e-12)


def test_labels_are_moved_apart_in_their_order_and_no_further() -> None:
    assert spread([0.0, 10.0, 11.0, 50.0], [4.0] * 4) == pytest.approx([0.0, 8.5, 12.5, 50.0])
    assert spread([5.0], [3.0]) == [5.0]


def test_a_diagram_without_a_shaft_is_refused() -> None:
    with pytest.raises(RotorsimError, match="no rotor with a shaft to draw"):
        shaft_figure(load("jeffcott"))
    with pytest.raises(RotorsimError, match="'amb_a' has no shaft to draw"):
        shaft_figure(load("drawn_rotor"), block="amb_a")
    with pytest.raises(RotorsimError, match="no block 'rotr'"):
        shaft_figure(load("drawn_rotor"), block="rotr")


def test_cones_and_sleeves_have_the_mass_and_centre_of_their_slices() -> None:
    rotor = {
        "elements": 2,
        "element_length": [0.2, 0.1],
        "outer_diameter": [0.04, 0.06],
        "inner_diameter": [0.0, 0.01],
        "conical_elements": [1],
        "end_outer_diameter": [0.06],
        "end_inner_diameter": [0.02],
        "sleeve_elements": [2],
        "sleeve_outer_diameter": 0.09,
        "sleeve_inner_diameter": 0.06,
        "sleeve_density": 7000.0,
        "disc_nodes": [],
    }
    blocks = {"rotor": {"type": "rotor_fe", "parameters": rotor}, "rest": {"type": "constant"}}
    diagram = load({"blocks": blocks, "wires": [["rest.output", "rotor.speed"]]})
    _, shaft = shaft_of(diagram)
    points, weights = np.polynomial.legendre.leggauss(4)  # exact for the squares of diameters times z
    z, w = 0.1 * (points + 1), 0.1 * weights
    slices = 7850 * np.pi / 4 * ((0.04 + 0.1 * z) ** 2 - (0.1 * z) ** 2) * w
    straight = 7850 * np.pi / 4 * (0.06**2 - 0.01**2) * 0.1 + 7000 * np.pi / 4 * (0.09**2 - 0.06**2) * 0.1
    assert shaft.mass == pytest.approx(slices.sum() + straight, rel=1e-12)
    assert shaft.centre_of_gravity == pytest.approx((slices @ z + straight * 0.25) / shaft.mass, rel=1e-12)
    found = boxes(shaft_figure(diagram).axes[0])
    assert (0.0, -30.0, 200.0, 60.0) in found  # the cone
    assert (200.0, 30.0, 100.0, 15.0) in found  # upper half of the sleeve


@pytest.mark.slow
def test_cones_and_sleeves_of_a_drawing_are_drawn_to_scale() -> None:
    tapers = {"rotor.conical_sections": [3], "rotor.end_outer_diameter": [0.06], "rotor.end_inner_diameter": [0.0]}
    sleeve = {
        "begins": [0.4],
        "lengths": [0.08],
        "outer_diameter": 0.07,
        "inner_diameter": 0.045,
        "stiffness_share": 0.3,
    }
    made = {**tapers, **{f"rotor.sleeve_{key}": value for key, value in sleeve.items()}}
    diagram = load("drawn_rotor", set=made)
    plain, shaft = shaft_of(load("drawn_rotor"))[1], shaft_of(diagram)[1]
    grown = np.pi / 12 * 0.14 * (0.04**2 + 0.04 * 0.06 + 0.06**2) - np.pi / 4 * 0.14 * 0.04**2
    added = grown + np.pi / 4 * (0.07**2 - 0.045**2) * 0.08
    assert shaft.mass - plain.mass == pytest.approx(7850 * added, rel=1e-9)
    figure = shaft_figure(diagram)
    found = boxes(figure.axes[0])
    assert (160.0, -30.0, 140.0, 60.0) in found  # the cone
    assert (400.0, 22.5, 80.0, 12.5) in found  # upper half of the sleeve
    assert "sleeve" in [text.get_text() for text in figure.legends[0].get_texts()]
