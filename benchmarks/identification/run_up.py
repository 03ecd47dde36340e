"""How often 90 % intervals from run-ups hold the truth: python -m benchmarks.identification.run_up [MACHINES] [FIRST].

Jeffcott rotors of chance by matrix exponentials: a run-up, a coast-down, and a run-up with other gains; once-per-turn
pulses with jitter; white and slow noise, and 50 Hz pick-up.
"""

from __future__ import annotations

import sys

import numpy as np

from rotorsim.identification.identification import identify
from rotorsim.model.load import load
from tests.identification.waveform.run_up import drawn, runs_of

ANGLES = np.radians(0.5)  # that angles are to come back within, and shares of the value of others
SHARES = {"force_displacement_factor": 0.03}
USUAL = 0.01


def main() -> None:
    """Print a line per machine, and the shares of all."""
    machines, first = (int(sys.argv[k]) if len(sys.argv) > k else default for k, default in ((1, 50), (2, 0)))
    held: dict[str, list[bool]] = {}
    near: list[bool] = []
    scores: list[float] = []
    for seed in range(first, first + machines):
        machine = drawn(seed)
        found = identify(load("jeffcott"), runs_of(machine, seed))
        for name, truth in machine.parameters.items():
            one = found.parameters[name]
            held.setdefault(name, []).append(one.interval90[0] <= truth <= one.interval90[1])
            most = ANGLES if one.unit == "rad" else SHARES.get(name, USUAL) * truth
            near.append(abs(one.value - truth) <= most)
            scores.append((one.value - truth) / one.std)
        now = [own[-1] for own in held.values()]
        print(f"machine {seed}: {sum(now)} of {len(now)} held, adequate {found.adequate}", flush=True)
    for name, own in held.items():
        print(f"{name:28}{100 * np.mean(own):6.0f} % held")
    every = np.concatenate([*held.values()])
    print(
        f"all of {machines} machines: {100 * every.mean():.0f} % held, {100 * np.mean(near):.0f} % near enough, "
        f"errors {np.sqrt(np.mean(np.square(scores))):.2f} std rms"
    )


if __name__ == "__main__":
    main()
