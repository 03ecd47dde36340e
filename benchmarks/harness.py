"""Measure honestly: CPU time, interleaved runs, medians, ratios; tables in JSON and Markdown.

Absolute times are machine-dependent, so only ratios of figures measured in one run are judged. Runs of
the things compared are interleaved, so that a busy moment of the machine meets all of them.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
REPEATS = 5


@dataclass(frozen=True)
class Line:
    """One figure beside its target; ok is None when nothing is promised."""

    what: str
    figure: str
    target: str = ""
    ok: bool | None = None

    def __str__(self) -> str:
        mark = "" if self.ok is None else ("ok" if self.ok else "NOT")
        return f"{self.what:<72} {self.figure:>26}   {self.target:<22} {mark}".rstrip()


def at_most(what: str, value: float, limit: float, form: str = "{:.3g}", unit: str = "", also: str = "") -> Line:
    """Return a line that is ok when value <= limit; ``also`` is said beside the figure."""
    suffix = f" {unit}" if unit else ""
    return Line(what, form.format(value) + suffix + also, f"<= {form.format(limit)}{suffix}", bool(value <= limit))


def at_least(what: str, value: float, limit: float, form: str = "{:.3g}", unit: str = "", also: str = "") -> Line:
    """Return a line that is ok when value >= limit."""
    suffix = f" {unit}" if unit else ""
    return Line(what, form.format(value) + suffix + also, f">= {form.format(limit)}{suffix}", bool(value >= limit))


def within(what: str, value: float, center: float, tolerance: float, form: str = "{:.6g}", unit: str = "") -> Line:
    """Return a line that is ok when |value - center| <= tolerance."""
    suffix = f" {unit}" if unit else ""
    target = f"{form.format(center)} +- {tolerance:.3g}{suffix}"
    return Line(what, form.format(value) + suffix, target, bool(abs(value - center) <= tolerance))


def cpu_seconds(action: Callable[[], Any]) -> float:
    """Return the CPU time of this process that an action takes."""
    begun = time.process_time()
    action()
    return time.process_time() - begun


def medians(actions: Mapping[str, Callable[[], Any]], repeats: int = REPEATS, warm_up: int = 1) -> dict[str, float]:
    """Return the median CPU time [s] of every action; runs are interleaved, the first ones thrown away.

    Every other round goes backwards: what ran before leaves the caches in a state that is worth a few per cent.
    """
    times: dict[str, list[float]] = {name: [] for name in actions}
    for k in range(warm_up + repeats):
        for name, action in list(actions.items())[:: 1 if k % 2 else -1]:
            seconds = cpu_seconds(action)
            if k >= warm_up:
                times[name].append(seconds)
    return {name: statistics.median(values) for name, values in times.items()}


@dataclass(frozen=True)
class Process:
    """What a whole process took: wall and CPU time [s], peak resident memory [MB], exit code and output."""

    wall: float
    cpu: float
    peak: float
    code: int
    output: str


def run_process(command: Sequence[str], environment: Mapping[str, str] | None = None, cwd: Path = ROOT) -> Process:
    """Run a command to its end and return what it took, with its children (a compiler) in the CPU time.

    peak: the largest resident memory of the command or of any of its children.
    """
    watcher = (
        "import json, resource, subprocess, sys, time\n"
        "begun = time.perf_counter()\n"
        "done = subprocess.run(sys.argv[1:], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)\n"
        "wall = time.perf_counter() - begun\n"
        "use = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(json.dumps([wall, use.ru_utime + use.ru_stime, use.ru_maxrss, done.returncode,"
        " done.stdout.decode(errors='replace')]))\n"
    )
    whole = {**os.environ, **(environment or {})}
    done = subprocess.run(
        [sys.executable, "-S", "-c", watcher, *command], capture_output=True, text=True, env=whole, cwd=cwd, check=True
    )
    wall, cpu, peak, code, output = json.loads(done.stdout)
    scale = 1e6 if sys.platform == "darwin" else 1e3  # ru_maxrss is in bytes on macOS, in kB elsewhere
    return Process(wall, cpu, peak / scale, code, output)


def reset_peak() -> float:
    """Forget the peak memory of this process where the system can (Linux); return what it occupies now [MB]."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
        return _status("VmRSS")
    except OSError:
        return own_peak()


def peak_since_reset() -> float:
    """Return the peak resident memory [MB] since `reset_peak`, or of the whole life of the process."""
    try:
        return _status("VmHWM")
    except OSError:
        return own_peak()


def _status(key: str) -> float:
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(key + ":"):
            return float(line.split()[1]) / 1024
    raise OSError(key)


def own_peak() -> float:
    """Return the peak resident memory of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def markdown(lines: Sequence[Line]) -> str:
    """Return the lines as a Markdown table."""
    rows = ["| what | figure | target | |", "|---|---|---|---|"]
    for line in lines:
        mark = "" if line.ok is None else ("ok" if line.ok else "**NOT**")
        rows.append(f"| {line.what} | {line.figure} | {line.target} | {mark} |")
    return "\n".join(rows) + "\n"


def as_json(lines: Sequence[Line]) -> str:
    """Return the lines as JSON."""
    return json.dumps([asdict(line) for line in lines], indent=1, ensure_ascii=False) + "\n"


def write(lines: Sequence[Line], path: Path) -> None:
    """Write the lines beside each other as .json and .md."""
    path.with_suffix(".json").write_text(as_json(lines), encoding="utf-8")
    path.with_suffix(".md").write_text(markdown(lines), encoding="utf-8")
