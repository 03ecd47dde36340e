"""The cracked Jeffcott rotor in PathSim, bdsim and jaxonomy, from blocks of each.

Run by ``benchmarks.engine.peers`` with the Python of the environment that holds the peer; imports nothing of
this project: ``python peer_models.py PEER STEPS [RUNS]`` prints one line of JSON; RUNS: so many runs with other gains
K_P, instead of one. The equations are those of ``baselines/jeffcott.c``; seven or eight blocks, vector signals (x, y)
where the peer has them.
"""

from __future__ import annotations

import json
import math
import sys
import time
from importlib.metadata import version

import numpy as np

MASS, STIFFNESS, DAMPING = 2.0, 7.6e5, 76.0
CRACK, SAG, ECCENTRICITY, PHASE = 3e5, 2.6e-5, 24e-6, math.radians(30)
KS, KI, KP, INTEGRAL, KD = 105210.0, 42.1, 12200.0, 2000.0, 3.0
GAINS = 9000.0, 16000.0  # K_P of the first and the last run of an ensemble
SPEED = 1500 * 2 * math.pi / 60
STEP = 1e-4


def crack(theta, xp=np):
    """Return the crack force, five-term switching function (thesis eqs. 2.11, 2.28)."""
    s = 0.5 + 2 / math.pi * sum((-1) ** k / (2 * k + 1) * xp.cos((2 * k + 1) * theta) for k in range(5))
    return 0.5 * s * CRACK * SAG * (1 + xp.cos(2 * theta)), 0.5 * s * CRACK * SAG * xp.sin(2 * theta)


def unbalance(theta, xp=np):
    """Return the unbalance force (thesis eq. 2.28)."""
    f = MASS * ECCENTRICITY * SPEED**2
    return f * xp.cos(theta + PHASE), f * xp.sin(theta + PHASE)


def timed(run):
    """Return the CPU and wall time [s] of a call."""
    cpu, wall = time.process_time(), time.perf_counter()
    run()
    return time.process_time() - cpu, time.perf_counter() - wall


def pathsim(steps, gain=KP):
    """Run in PathSim with RK4 of fixed step: clock, crack, unbalance, controller, AMB, rotor, integral."""
    from pathsim import Connection, Simulation
    from pathsim.blocks import ODE, Function, Integrator, Scope, Source
    from pathsim.solvers import RK4

    clock = Source(lambda t: SPEED * t)
    crack_block, unbalance_block = Function(crack), Function(unbalance)

    def current(ux, uy, vx, vy, zx, zy):
        return gain * ux + INTEGRAL * zx + KD * vx, gain * uy + INTEGRAL * zy + KD * vy

    def magnet(ux, uy, ix, iy):
        return KS * ux - KI * ix, KS * uy - KI * iy

    def rotor_equations(x, u, t):
        ax = (u[0] + u[2] + u[4] - STIFFNESS * x[0] - DAMPING * x[2]) / MASS
        ay = (u[1] + u[3] + u[5] - STIFFNESS * x[1] - DAMPING * x[3]) / MASS
        return np.array([x[2], x[3], ax, ay])

    controller, amb = Function(current), Function(magnet)
    rotor, integral = ODE(rotor_equations, np.zeros(4)), Integrator(np.zeros(2))
    scope = Scope(labels=["x", "y", "ix", "iy"])
    simulation = Simulation(
        [clock, crack_block, unbalance_block, controller, amb, rotor, integral, scope],
        [
            Connection(clock, crack_block, unbalance_block),
            Connection(crack_block[0:2], rotor[0:2]),
            Connection(unbalance_block[0:2], rotor[2:4]),
            Connection(amb[0:2], rotor[4:6]),
            Connection(rotor[0:2], controller[0:2], amb[0:2], integral[0:2], scope[0:2]),
            Connection(rotor[2:4], controller[2:4]),
            Connection(integral[0:2], controller[4:6]),
            Connection(controller[0:2], amb[2:4], scope[2:4]),
        ],
        dt=STEP,
        Solver=RK4,
        log=False,
    )
    cpu, wall = timed(lambda: simulation.run(steps * STEP, reset=True, adaptive=False))
    _, data = scope.read()
    return cpu, wall, 7, "RK4, fixed step", [data[0][-1], data[1][-1]]


def bdsim(steps):
    """Run in bdsim, which has adaptive solvers only: RK45 at its default tolerances, recorded every step."""
    import bdsim as package

    sim = package.BDSim(graphics=False, animation=False, banner=False, progress=False, quiet=True, argv=[])
    bd = sim.blockdiagram()
    clock = bd.TIME()
    crack_block = bd.FUNCTION(lambda t: np.array(crack(SPEED * t)), name="crack")
    unbalance_block = bd.FUNCTION(lambda t: np.array(unbalance(SPEED * t)), name="unbalance")
    controller = bd.FUNCTION(lambda u, v, z: KP * u + INTEGRAL * z + KD * v, nin=3, name="controller")
    rotor = bd.FUNCTION(
        lambda fc, fu, i, u, v: (fc + fu + KS * u - KI * i - STIFFNESS * u - DAMPING * v) / MASS, nin=5, name="rotor"
    )
    velocity = bd.INTEGRATOR(x0=np.zeros(2), name="velocity")
    displacement = bd.INTEGRATOR(x0=np.zeros(2), name="displacement")
    integral = bd.INTEGRATOR(x0=np.zeros(2), name="integral")
    bd.connect(clock, crack_block, unbalance_block)
    bd.connect(crack_block, rotor[0])
    bd.connect(unbalance_block, rotor[1])
    bd.connect(controller, rotor[2])
    bd.connect(displacement, rotor[3], controller[0], integral)
    bd.connect(velocity, rotor[4], controller[1], displacement)
    bd.connect(integral, controller[2])
    bd.connect(rotor, velocity)
    bd.compile(report=False, verbose=False)
    found = []
    cpu, wall = timed(
        lambda: found.append(sim.run(bd, T=steps * STEP, dt=STEP, watch=[displacement, controller], block=False))
    )
    last = np.asarray(found[0].y)[-1]
    return cpu, wall, 8, "RK45, adaptive (default tolerances; it has no fixed step)", [float(last[0]), float(last[1])]


def pathsim_many(steps, runs):
    """Run one after another in PathSim, which has no ensembles."""
    done = [pathsim(steps, gain) for gain in np.linspace(*GAINS, runs)]
    cpu, wall = (sum(one[k] for one in done) for k in (0, 1))
    return cpu, wall, 7, "one after another, RK4, fixed step", done[-1][-1]


def scipy_many(steps, runs):
    """Run all together in SciPy's solve_ivp, NumPy arrays over the runs as one large system."""
    from scipy.integrate import solve_ivp

    gain = np.linspace(*GAINS, runs)[:, None]

    def equations(t, flat):
        z, u, v = flat.reshape(3, runs, 2)
        current = gain * u + INTEGRAL * z + KD * v
        force = np.array(crack(SPEED * t)) + np.array(unbalance(SPEED * t)) + KS * u - KI * current
        return np.concatenate([u, v, (force - STIFFNESS * u - DAMPING * v) / MASS]).ravel()

    found, at = [], np.arange(steps + 1) * STEP
    options = {"method": "DOP853", "t_eval": at, "rtol": 1e-8, "atol": 1e-12}
    cpu, wall = timed(lambda: found.append(solve_ivp(equations, (0.0, at[-1]), np.zeros(6 * runs), **options)))
    last = found[0].y[:, -1].reshape(3, runs, 2)[1, -1]
    return cpu, wall, "", "DOP853, all runs one system, rtol 1e-8", [float(last[0]), float(last[1])]


def jaxonomy(steps, runs=0):
    """Run in jaxonomy with rk4 of fixed step; the second call is timed, the first one compiles."""
    import jax.numpy as jnp
    import jaxonomy as package
    from jaxonomy.library import Gain, Integrator, ReduceBlock, SourceBlock

    builder = package.DiagramBuilder()
    add, connect = builder.add, builder.connect
    crack_block = add(SourceBlock(lambda t: jnp.stack(crack(SPEED * t, jnp)), name="crack"))
    unbalance_block = add(SourceBlock(lambda t: jnp.stack(unbalance(SPEED * t, jnp)), name="unbalance"))
    proportional = add(Gain(KP, name="proportional"))
    controller = add(ReduceBlock(3, lambda i: i[0] + KD * i[1] + INTEGRAL * i[2], name="controller"))
    amb = add(ReduceBlock(2, lambda i: KS * i[0] - KI * i[1], name="amb"))
    rotor = add(ReduceBlock(5, lambda i: (i[0] + i[1] + i[2] - STIFFNESS * i[3] - DAMPING * i[4]) / MASS, name="rotor"))
    velocity = add(Integrator(jnp.zeros(2), name="velocity"))
    displacement = add(Integrator(jnp.zeros(2), name="displacement"))
    integral = add(Integrator(jnp.zeros(2), name="integral"))
    wires = [
        (displacement, proportional, 0),
        (proportional, controller, 0),
        (velocity, controller, 1),
        (integral, controller, 2),
        (displacement, amb, 0),
        (controller, amb, 1),
        (crack_block, rotor, 0),
        (unbalance_block, rotor, 1),
        (amb, rotor, 2),
        (displacement, rotor, 3),
        (velocity, rotor, 4),
        (rotor, velocity, 0),
        (velocity, displacement, 0),
        (displacement, integral, 0),
    ]
    for source, target, port in wires:
        connect(source.output_ports[0], target.input_ports[port])
    diagram = builder.build()
    context = diagram.create_context()
    options = package.SimulatorOptions(
        ode_solver_method="rk4",
        max_minor_step_size=STEP * (1 + 1e-6),
        max_major_step_length=STEP,
        max_major_steps=steps + 10,
        buffer_length=2 * steps + 100,
        math_backend="jax",
    )
    recorded = {"displacement": displacement.output_ports[0], "current": controller.output_ports[0]}
    found = []

    span, gains = (0.0, steps * STEP), {"proportional.gain": jnp.linspace(*GAINS, runs)}

    def run():
        if runs:
            given = {"options": options, "recorded_signals": recorded, "use_vmap": True}
            found.append(package.simulate_batch(diagram, span, gains, **given))
        else:
            found.append(package.simulate(diagram, context, span, options=options, recorded_signals=recorded))

    first = timed(run)
    cpu, wall = timed(run)
    last = np.asarray(found[-1].outputs["displacement"])
    last = last[-1, -1] if runs else last[-1]
    how = "simulate_batch with vmap, rk4" if runs else "rk4"
    note = f"{how}, fixed step; first call {first[1]:.1f} s with compiling"
    return cpu, wall, 9, note, [float(last[0]), float(last[1])]


def jaxonomy_many(steps, runs):
    """Run in jaxonomy's simulate_batch over all runs at once."""
    return jaxonomy(steps, runs)


def main():
    """Run one peer and print what it took."""
    name, *numbers = sys.argv[1], *map(int, sys.argv[2:])
    steps, many = numbers[0], {"pathsim": pathsim_many, "scipy": scipy_many, "jaxonomy": jaxonomy_many}
    try:
        run = (many if numbers[1:] else {"pathsim": pathsim, "bdsim": bdsim, "jaxonomy": jaxonomy})[name]
        cpu, wall, blocks, note, last = run(*numbers)
    except Exception as error:  # a peer that fails is a row of the table, not an end of it
        print(json.dumps({"peer": name, "error": f"{type(error).__name__}: {error}"[:300]}))
        return
    print(
        json.dumps(
            {
                "peer": name,
                "version": version(name),
                "steps": steps,
                "cpu": cpu,
                "wall": wall,
                "blocks": blocks,
                "note": note,
                "last": [float(v) for v in last],
            }
        )
    )


if __name__ == "__main__":
    main()
