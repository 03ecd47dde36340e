"""Casing on flexible feet."""

from rotorsim.block import Block, Equations, In, Option, Out, Param, State, rows, vec


class Casing(Block):
    """Move a rigid casing on springs and dampers, in two planes: what magnets push against and probes stand on.

    mass c'' = sum f_s + sum f_k,   f_k = -(stiffness_k u_k + damping_k u_k'),   u = c + (z - centre_of_gravity) b
    tilt_inertia b'' = sum (z_s - centre_of_gravity) f_s + sum (z_k - centre_of_gravity) f_k        with option tilts

    s: stations, where bearings push and probes stand; k: feet; x and y are apart. c: displacement of the centre of
    gravity, b: slope of the axis; without option tilts it stays parallel, b = 0. Displacements are those from rest
    under its own weight. A bearing between rotor and casing sees rotor.displacement - casing.displacement, and its
    force acts on the rotor, the opposite one on the casing.
    """

    category = "casing"
    source = "Friswell et al. (2010), ch. 6 (foundations); ISO 10814"

    force = In(shape=("station", 2), unit="N", additive=True, conjugate="displacement", doc="forces [station, xy]")
    displacement = Out(shape=("station", 2), unit="m", doc="displacement [station, xy]")
    velocity_port = Out(name="velocity", shape=("station", 2), unit="m/s", doc="velocity [station, xy]")
    tilts = Option(False, kind=bool, doc="tilt as well; needs two feet")
    stations = Param([0.0], shape=("station",), unit="m", doc="axial position of each station")
    feet = Param([0.0], shape=("foot",), unit="m", doc="axial position of each foot")
    mass = Param(100.0, unit="kg", above=0.0, doc="mass, with all that is fixed to it")
    tilt_inertia = Param(10.0, unit="kg m^2", above=0.0, doc="moment of inertia about an axis across, option tilts")
    centre_of_gravity = Param(0.0, unit="m", doc="axial position of the centre of gravity, option tilts")
    stiffness = Param(1e8, shape=("foot", 2), unit="N/m", low=0.0, doc="stiffness of each foot [foot, xy]")
    damping = Param(1e3, shape=("foot", 2), unit="N s/m", low=0.0, doc="viscous damping of each foot [foot, xy]")
    position = State(shape=2, unit="m", doc="displacement c of the centre of gravity [x, y]")
    velocity = State(shape=2, unit="m/s", doc="its rate")
    slope = State(shape=2, unit="rad", when=lambda option: option.tilts, doc="slope b in the planes of x and y")
    slope_rate = State(shape=2, unit="rad/s", when=lambda option: option.tilts, doc="its rate")

    def check_given(self, given):
        """Refuse a casing that turns over."""
        feet = given["feet"].ravel().tolist() if "feet" in given else []
        if self.option.tilts and len(set(feet)) < 2 and all(z == z for z in feet):
            hint = "give two positions or more in feet, or leave tilts out"
            return [("tilts", (), "a casing that tilts needs feet at two positions", hint)]
        return []

    def equations(self, p, u, x, t):
        tilts = self.option.tilts
        at = [z - p.centre_of_gravity for z in rows(p.stations)]
        feet = [z - p.centre_of_gravity for z in rows(p.feet)]

        def along(arms, centre, slope):
            return [(centre + arm * slope if tilts else centre).T for arm in arms]

        slope, rate = (x.slope, x.slope_rate) if tilts else (0.0, 0.0)
        strain = zip(along(feet, x.position, slope), along(feet, x.velocity, rate), strict=True)
        pushed = [-(k * q + c * v) for k, c, (q, v) in zip(rows(p.stiffness), rows(p.damping), strain, strict=True)]
        forces = [*zip(at, rows(u.force), strict=True), *zip(feet, pushed, strict=True)]
        derivatives = {"position": x.velocity, "velocity": sum((force.T for _, force in forces), 0.0) / p.mass}
        if tilts:
            derivatives["slope"] = x.slope_rate
            derivatives["slope_rate"] = sum((arm * force.T for arm, force in forces), 0.0) / p.tilt_inertia
        return Equations(
            outputs={"displacement": vec(*along(at, x.position, slope)), "velocity": vec(*along(at, x.velocity, rate))},
            derivatives=derivatives,
        )
