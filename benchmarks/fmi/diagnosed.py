"""Whether a diagnosis is the same where a part of the diagram is its own FMU.

``python -m benchmarks.fmi.diagnosed RECORDINGS [--cases dev01 ...] [--block rotor] [--workers N]``
``python -m benchmarks.fmi.diagnosed RECORDINGS --diagram FILE --sets generic/development --cases kdev02 --block BLOCK``

A diagram (`jeffcott`) as it is, and with a block replaced by its FMU for Model Exchange (2.0, in this process), on sets
of a folder of RECORDINGS (concealed_development): verdict, what is missing and where, and how far free parameters are
off, by their standard deviation. Exit 1 where a verdict, a name or a place differs. Some minutes a set.
"""

from __future__ import annotations

import argparse
import copy
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.markers import table_text
from rotorsim.fmi.export.export import export_fmu
from rotorsim.model.load import load

SIX = ("dev01", "dev02", "dev03", "dev04", "dev06", "dev08")  # nothing, four kinds of physics, an imitator


def main() -> int:
    """Print a line for each set."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--cases", nargs="+", default=list(SIX))
    parser.add_argument("--block", default="rotor")
    parser.add_argument("--diagram", default="jeffcott")
    parser.add_argument("--sets", default="concealed_development")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    sets = sorted((given.recordings / given.sets).iterdir())
    rows, same = [], True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        replaced = _replaced(folder, given.diagram, given.block)
        for case in given.cases:
            recording = next(path for path in sets if path.name.startswith(case))
            plain, plain_time = _diagnosis(given.diagram, recording, folder / f"{case}_plain", given.workers)
            other, other_time = _diagnosis(str(replaced), recording, folder / f"{case}_fmu", given.workers)
            alike = plain["verdict"] == other["verdict"] and _names(plain) == _names(other)
            same = same and alike
            rows.append(
                (
                    recording.name,
                    plain["verdict"],
                    _names(plain),
                    other["verdict"],
                    _names(other),
                    _off(plain, other),
                    plain_time,
                    other_time,
                )
            )
            print(rows[-1], file=sys.stderr, flush=True)
    head = (
        "set",
        "plain",
        "missing",
        "with the FMU",
        "missing",
        "free parameters off by [std]",
        "plain [s]",
        "with it [s]",
    )
    print(table_text(head, [[str(cell) for cell in row] for row in rows]))
    return int(not same)


def _replaced(folder: Path, diagram: str, block: str) -> Path:
    """Write a diagram with a block replaced by its FMU."""
    plain = load(diagram)
    export_fmu(plain, folder / "part.fmu", blocks=[block])
    document = copy.deepcopy(dict(plain.document))
    values = {"in_process": True, "interface": "me"}
    for key, value in document["blocks"][block].get("parameters", {}).items():
        values[key] = value  # those that follow a parameter of the diagram still do
    document["blocks"][block] = {"type": "fmu", "file": "part.fmu", "parameters": values}
    path = folder / "replaced.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def _diagnosis(diagram: str, recording: Path, out: Path, workers: int) -> tuple[dict[str, Any], str]:
    program = Path(sys.executable).with_name("rotorsim")
    command = [program, "diagnose", diagram, recording, "--out", out, "--workers", str(workers), "--trust-blocks"]
    begun = time.perf_counter()
    done = subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}, check=False
    )
    file = out / "diagnosis.json"
    if not file.exists():
        return {"verdict": f"failed: {done.stderr.strip()[-200:]}"}, "-"
    return json.loads(file.read_text(encoding="utf-8")), f"{time.perf_counter() - begun:.0f}"


def _names(diagnosis: dict[str, Any]) -> str:
    """Return what is missing, and the places."""
    names = [str(item["physics"]) for item in diagnosis.get("missing", [])]
    places = [f"{item['block']}.{item['port']}" for item in diagnosis.get("where", [])]
    return ", ".join(sorted(names)) + (f" at {', '.join(sorted(places))}" if places else "") or "-"


def _off(plain: dict[str, Any], other: dict[str, Any]) -> str:
    """Return the largest difference of a free parameter, in standard deviations."""
    values, others = (made.get("parameters", {}).get("after") or {} for made in (plain, other))
    pairs = [abs(one["value"] - others[key]["value"]) / one["std"] for key, one in values.items() if key in others]
    return f"{max(pairs):.2g}" if pairs else "-"


if __name__ == "__main__":
    sys.exit(main())
