"""FMUs for tests, made of tests/fmi/c: a spring, a mass and a damper that can be told to misbehave."""

from __future__ import annotations

import re
import subprocess
import tempfile
import zipfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest

from rotorsim.fmi.description.platforms import SUFFIXES, folders, this_platform
from rotorsim.model.emit.toolchain import find_compiler

__all__ = ["FAULTS", "description2", "description3", "floats_only", "library", "make_fmu"]

FAULTS = (
    "ok",
    "segv",
    "hang",
    "fail",
    "nan",
    "discard",
    "hungry",
    "leave",
    "abort",
    "print",
    "fatal",
    "bad_free",
    "terminate",
    "child",
    "below",
    "flood",
    "leave_well",
    "bad_reset",
    "no_reset",
)
SOURCES = Path(__file__).parent / "c"
_FLAGS = 'canGetAndSetFMU{s}="true" canSerializeFMU{s}="true" canBeInstantiatedOnlyOncePerProcess="{once}"'
_UNITS = (
    '<UnitDefinitions><Unit name="m"><BaseUnit m="1"/><DisplayUnit name="mm" factor="1000"/></Unit>'
    '<Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit></UnitDefinitions>'
)
_LOG = '<LogCategories><Category name="logStatusError"/></LogCategories>'


def description2(*, once: bool = False, identifier: str = "plant") -> str:
    """Return the model description of the FMI 2.0 plant."""
    flags = _FLAGS.format(s="state", once=str(once).lower()) + ' providesDirectionalDerivative="true"'
    rows = [
        (0, "time", 'causality="independent"', "Real", ""),
        (1, "x", 'initial="exact"', "Real", 'start="1" unit="m"'),
        (2, "v", 'initial="exact"', "Real", 'start="0"'),
        (3, "der(x)", "", "Real", 'derivative="2"'),
        (4, "der(v)", "", "Real", 'derivative="3"'),
        (5, "u", 'causality="input"', "Real", 'start="0" unit="N"'),
        (6, "y", 'causality="output"', "Real", 'unit="m" displayUnit="mm"'),
        (7, "stiffness", 'causality="parameter" variability="tunable"', "Real", 'start="100" min="0"'),
        (8, "damping", 'causality="parameter" variability="fixed"', "Real", 'start="0.5"'),
        (9, "gain", 'causality="parameter" variability="fixed"', "Real", 'start="0"'),
        (10, "wall", 'causality="parameter" variability="fixed"', "Real", 'start="1e9"'),
        (11, "tick", 'causality="parameter" variability="fixed"', "Real", 'start="0"'),
        (12, "fault_time", 'causality="parameter" variability="fixed"', "Real", 'start="0"'),
        (20, "fault", 'causality="parameter" variability="fixed"', "Integer", 'start="0"'),
        (21, "count", 'causality="output" variability="discrete"', "Integer", ""),
        (22, "level", 'causality="input" variability="discrete"', "Integer", 'start="0"'),
        (30, "enabled", 'causality="input" variability="discrete"', "Boolean", 'start="true"'),
        (40, "label", 'causality="parameter" variability="fixed"', "String", 'start="none"'),
        (13, "fault_above", 'causality="parameter" variability="fixed"', "Real", 'start="0"'),
    ]
    variables = "\n".join(
        f'<ScalarVariable name="{name}" valueReference="{r}" {how}><{kind} {more}/></ScalarVariable>'
        for r, name, how, kind, more in rows
    )
    unknowns = '<Unknown index="7" dependencies="2 6"/><Unknown index="15" dependencies=""/>'
    derivatives = '<Unknown index="4" dependencies="3"/><Unknown index="5" dependencies="2 3 6"/>'
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="plant" guid="{{plant2}}" numberOfEventIndicators="1">
<ModelExchange modelIdentifier="{identifier}" {flags}/>
<CoSimulation modelIdentifier="{identifier}" canHandleVariableCommunicationStepSize="true" canInterpolateInputs="true"
  maxOutputDerivativeOrder="1" {flags}/>
{_UNITS}
{_LOG}
<DefaultExperiment startTime="0" stopTime="2" stepSize="0.01"/>
<ModelVariables>
{variables}
</ModelVariables>
<ModelStructure><Outputs>{unknowns}</Outputs><Derivatives>{derivatives}</Derivatives>
<InitialUnknowns>{derivatives}{unknowns}</InitialUnknowns></ModelStructure>
</fmiModelDescription>
"""


def floats_only(version: str = "2.0") -> str:
    """Return the description of a plant that exchanges Float64 alone; u fits y and does not reach it at once."""
    if version == "3.0":
        text = description3().replace(
            'causality="input" start="true"', 'causality="local" initial="exact" start="true"'
        )
        text = text.replace('21" causality="output"', '21" causality="local"').replace('unit="N"', 'unit="m"')
        return re.sub(r'<(Output|InitialUnknown) valueReference="21"[^>]*/>', "", text)
    text = description2().replace('unit="N"', 'unit="m"').replace('dependencies="2 6"', 'dependencies="2"')
    text = re.sub('causality="(in|out)put" variability="discrete"', 'variability="discrete"', text)
    return text.replace('<Unknown index="15" dependencies=""/>', "")


def description3(*, once: bool = False, identifier: str = "plant") -> str:
    """Return the model description of the FMI 3.0 plant, with arrays."""
    flags = (
        _FLAGS.format(s="State", once=str(once).lower())
        + ' providesDirectionalDerivatives="true" providesAdjointDerivatives="true"'
    )
    two = '<Dimension start="2"/>'
    rows = [
        ("Float64", 0, "time", 'causality="independent" variability="continuous"', ""),
        ("Float64", 1, "x", 'initial="exact" start="1 0" unit="m"', two),
        ("Float64", 2, "v", 'initial="exact" start="0 0"', two + '<Alias name="velocity"/>'),
        ("Float64", 3, "der(x)", 'derivative="1"', two),
        ("Float64", 4, "der(v)", 'derivative="2"', two),
        ("Float64", 5, "u", 'causality="input" start="0 0" unit="N"', two),
        ("Float64", 6, "y", 'causality="output" unit="m"', two),
        ("Float64", 7, "stiffness", 'causality="parameter" variability="tunable" start="100"', ""),
        ("Float64", 8, "damping", 'causality="parameter" variability="fixed" start="0.5"', ""),
        ("Float64", 9, "gain", 'causality="parameter" variability="fixed" start="0"', ""),
        ("Float64", 10, "wall", 'causality="parameter" variability="fixed" start="1e9"', ""),
        ("Float64", 11, "tick", 'causality="parameter" variability="fixed" start="0"', ""),
        ("Float64", 12, "fault_time", 'causality="parameter" variability="fixed" start="0"', ""),
        ("Int32", 20, "fault", 'causality="parameter" variability="fixed" start="0"', ""),
        ("Int32", 21, "count", 'causality="output"', ""),
        ("Boolean", 30, "enabled", 'causality="input" start="true"', ""),
        ("String", 40, "label", 'causality="parameter" variability="fixed"', '<Start value="none"/>'),
        ("Float64", 50, "z", 'causality="local"', two),
        ("Float64", 13, "fault_above", 'causality="parameter" variability="fixed" start="0"', ""),
    ]
    variables = "\n".join(
        f'<{kind} name="{name}" valueReference="{r}" {how}>{inner}</{kind}>' for kind, r, name, how, inner in rows
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="plant" instantiationToken="{{plant3}}">
<ModelExchange modelIdentifier="{identifier}" {flags}/>
<CoSimulation modelIdentifier="{identifier}" canHandleVariableCommunicationStepSize="true"
  maxOutputDerivativeOrder="1" {flags}/>
{_UNITS}
{_LOG}
<DefaultExperiment startTime="0" stopTime="2" stepSize="0.01"/>
<ModelVariables>
{variables}
</ModelVariables>
<ModelStructure>
<Output valueReference="6" dependencies="1 5"/><Output valueReference="21" dependencies=""/>
<ContinuousStateDerivative valueReference="3" dependencies="2"/>
<ContinuousStateDerivative valueReference="4" dependencies="1 2 5"/>
<InitialUnknown valueReference="3"/><InitialUnknown valueReference="4"/><InitialUnknown valueReference="6"/>
<InitialUnknown valueReference="21"/>
<EventIndicator valueReference="50"/>
</ModelStructure>
</fmiModelDescription>
"""


@cache
def library(version: str, name: str = "plant") -> bytes:
    """Return a compiled library; skips the test without a C compiler."""
    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler")
    spec = find_spec("fmpy")
    assert spec is not None
    assert spec.origin is not None
    headers = Path(spec.origin).parent / "c-code"
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "plant.out"
        source = SOURCES / f"{name}{version[0]}.c"
        command = [*compiler.command, "-O1", "-fPIC", "-shared", "-w", f"-I{headers}", "-o", str(target), str(source)]
        subprocess.run([*command, "-lm"], check=True, capture_output=True, timeout=300)
        return target.read_bytes()


def make_fmu(
    file: Path,
    version: str = "2.0",
    *,
    once: bool = False,
    platform: str = "",
    description: str | bytes = "",
    library_bytes: bytes = b"",
) -> Path:
    """Write a plant FMU; platform: another folder than that of this machine."""
    if not description:
        description = (description2 if version == "2.0" else description3)(once=once)
    suffix = SUFFIXES[this_platform().partition("-")[2]]
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description)
        archive.writestr(f"binaries/{platform or folders(version)[0]}/plant{suffix}", library_bytes or library(version))
        archive.writestr("resources/note.txt", "a resource")
    return file
