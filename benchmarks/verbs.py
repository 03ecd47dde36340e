"""CPU time of the verbs of commissioning and acceptance on beams: python -m benchmarks.verbs (target: 10 s each)."""

from __future__ import annotations

import platform
import resource
import shlex
import subprocess
import sys
import tempfile

__all__ = ["VERBS_ON_BEAMS", "main"]

TARGET = 10.0  # s
SAMPLED = "sampled_rotor.json"  # drawn_rotor with controllers that are sampled
MADE = (
    f'swap drawn_rotor controller_a discrete_pid --set "sample_time=0.05 ms" --out {SAMPLED}',
    f'swap {SAMPLED} controller_b discrete_pid --set "sample_time=0.05 ms" --in-place',
)
VERBS_ON_BEAMS = (
    'accept drawn_rotor --operating "6000 rpm:9000 rpm" --clearance "0.25 mm"',
    'accept two_amb_rotor --operating "2000 rpm:2500 rpm" --clearance "0.2 mm" --zone B',
    f'accept {SAMPLED} --operating "6000 rpm:9000 rpm" --clearance "0.25 mm"',
    "margins drawn_rotor",
    "modes drawn_rotor",
    'campbell drawn_rotor --speeds "0 rpm:500 rpm:12000 rpm"',
    'periodic drawn_rotor --speeds "6000 rpm:100 rpm:9000 rpm"',
    'frequency drawn_rotor --from controller_a.current --to "rotor.displacement[1]" --range "10 Hz:2000 Hz"',
)


def main() -> None:
    """Print the CPU time of each verb, in a process of its own, start included."""
    print(f"processor: {platform.machine()}; user and system, one process after the other; target {TARGET:g} s each")
    with tempfile.TemporaryDirectory() as folder:
        for text in MADE:
            subprocess.run([sys.executable, "-m", "rotorsim", *shlex.split(text)], cwd=folder, check=True)
        for text in VERBS_ON_BEAMS:
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [sys.executable, "-m", "rotorsim", *shlex.split(text)]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            said = "" if done.returncode in (0, 1) else f"  FAILED: {done.stderr.splitlines()[:1]}"
            print(f"{seconds:6.1f} s  {text}{said}")


if __name__ == "__main__":
    main()
