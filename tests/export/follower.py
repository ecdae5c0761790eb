"""The plant of follower.h as an FMU of either version, with both interfaces: somebody else's, for masters."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

from hydrotwin.export.archive import write_archive
from hydrotwin.export.build import FMI3_FOLDERS, compile_for, native_platform

HERE, GUID = Path(__file__).parent, "{follower}"
HEADERS = {
    2: ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    3: ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
ABLE = 'canHandleVariableCommunicationStepSize="true"'

VARIABLES2 = """
    <ScalarVariable name="u" valueReference="0" causality="input"><Real unit="N" start="0"/></ScalarVariable>
    <ScalarVariable name="state" valueReference="2" causality="{output}" initial="calculated">
      <Real unit="N"/></ScalarVariable>
    <ScalarVariable name="force" valueReference="3" causality="{output}" initial="calculated">
      <Real unit="N"/></ScalarVariable>
    <ScalarVariable name="start" valueReference="4" causality="parameter" variability="fixed">
      <Real unit="N" start="0"/></ScalarVariable>
    <ScalarVariable name="der(state)" valueReference="5"><Real unit="N/s" derivative="2"/></ScalarVariable>
    <ScalarVariable name="gain" valueReference="10" causality="input" variability="discrete">
      <Integer start="1"/></ScalarVariable>
    <ScalarVariable name="gain_seen" valueReference="11" causality="{output}" variability="discrete"
      initial="calculated"><Integer/></ScalarVariable>
    <ScalarVariable name="on" valueReference="20" causality="input" variability="discrete">
      <Boolean start="true"/></ScalarVariable>
    <ScalarVariable name="on_seen" valueReference="21" causality="{output}" variability="discrete" initial="calculated">
      <Boolean/></ScalarVariable>"""
STRUCTURE2 = """<Outputs>
      <Unknown index="2" dependencies="2"/><Unknown index="3" dependencies="1 2"/>
      <Unknown index="7" dependencies="6"/><Unknown index="9" dependencies="8"/>
    </Outputs>
    <Derivatives><Unknown index="5" dependencies="1 2 6 8"/></Derivatives>
    <InitialUnknowns>
      <Unknown index="2" dependencies="4"/><Unknown index="3" dependencies="1 4"/>
      <Unknown index="5" dependencies="1 4 6 8"/>
      <Unknown index="7" dependencies="6"/><Unknown index="9" dependencies="8"/>
    </InitialUnknowns>"""
VARIABLES3 = """
    <Float64 name="time" valueReference="99" causality="independent" variability="continuous"/>
    <Float64 name="u" valueReference="0" causality="input" start="0" unit="N"/>
    <Float64 name="state" valueReference="2" causality="{output}" initial="calculated" unit="N"/>
    <Float64 name="force" valueReference="3" causality="{output}" initial="calculated" unit="N"/>
    <Float64 name="start" valueReference="4" causality="parameter" variability="fixed" start="0" unit="N"/>
    <Float64 name="der(state)" valueReference="5" causality="local" derivative="2" unit="N/s"/>
    <Int32 name="gain" valueReference="10" causality="input" variability="discrete" start="1"/>
    <Int32 name="gain_seen" valueReference="11" causality="{output}" variability="discrete" initial="calculated"/>
    <Boolean name="on" valueReference="20" causality="input" variability="discrete" start="true"/>
    <Boolean name="on_seen" valueReference="21" causality="{output}" variability="discrete" initial="calculated"/>"""
STRUCTURE3 = """
    <Output valueReference="2" dependencies="2"/><Output valueReference="3" dependencies="0 2"/>
    <Output valueReference="11" dependencies="10"/><Output valueReference="21" dependencies="20"/>
    <ContinuousStateDerivative valueReference="5" dependencies="0 2 10 20"/>
    <InitialUnknown valueReference="2" dependencies="4"/><InitialUnknown valueReference="3" dependencies="0 4"/>
    <InitialUnknown valueReference="5" dependencies="0 4 10 20"/>
    <InitialUnknown valueReference="11" dependencies="10"/><InitialUnknown valueReference="21" dependencies="20"/>"""
UNITS = """<UnitDefinitions>
    <Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit><Unit name="N/s"><BaseUnit kg="1" m="1" s="-3"/></Unit>
  </UnitDefinitions>"""


def follower(path: Path, fmi: int, *, fault: str = "NO_FAULT", outputs: bool = True, one_size: bool = False) -> Path:
    """Write the FMU.

    fault : of Model Exchange, see follower.h. outputs : whether there are any. one_size : it takes one step size only.
    """
    step = 'canHandleVariableCommunicationStepSize="false"' if one_size else ABLE
    xml = _description2(step, outputs) if fmi == 2 else _description3(step, outputs)
    headers = Path(importlib.util.find_spec("fmpy").submodule_search_locations[0]) / "c-code"
    sources = {name: (headers / name).read_text(encoding="utf-8") for name in HEADERS[fmi]}
    for name in ("follower.h", f"follower{fmi}.c"):
        sources[name] = (HERE / name).read_text(encoding="utf-8")
    sources["others.c"] = _others(sources, fmi)
    sources["follower.h"] = f"#define FAULT {fault}\n" + sources["follower.h"]
    platform = native_platform()
    library, content = compile_for(platform, "follower", sources)
    folder = platform if fmi == 2 else FMI3_FOLDERS[platform]
    return write_archive(path, {"modelDescription.xml": xml, f"binaries/{folder}/{library}": content})


def _others(sources: dict[str, str], fmi: int) -> str:
    """The functions of the standard that the face does not have: importers want to find them all."""
    [types] = [text for name, text in sources.items() if name.endswith("FunctionTypes.h")]
    declared = re.findall(rf"typedef fmi{fmi}(Status|Instance)\s+(fmi{fmi}\w+)TYPE\s*\((.*?)\);", types, re.DOTALL)
    missing = [row for row in declared if f" {row[1]}(" not in sources[f"follower{fmi}.c"]]
    answer = {"Status": f"fmi{fmi}Error", "Instance": "0"}
    bodies = "\n".join(
        f"fmi{fmi}{kind} {name}({given.replace('Byte[]', 'Byte bytes[]')}) {{ return {answer[kind]}; }}"
        for kind, name, given in missing
    )
    quiet = '#ifdef __clang__\n#pragma clang diagnostic ignored "-Wstrict-prototypes"\n#endif\n'
    return f'{quiet}#include "fmi{fmi}Functions.h"\n{bodies}\n'


def _description2(step: str, outputs: bool) -> str:
    structure = STRUCTURE2 if outputs else STRUCTURE2[STRUCTURE2.index("<Derivatives>") :]
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="follower" guid="{GUID}" numberOfEventIndicators="0">
  <ModelExchange modelIdentifier="follower"/>
  <CoSimulation modelIdentifier="follower" canInterpolateInputs="true" {step}/>
  {UNITS}
  <DefaultExperiment stepSize="0.01"/>
  <ModelVariables>{VARIABLES2.format(output="output" if outputs else "local")}
  </ModelVariables>
  <ModelStructure>{structure}</ModelStructure>
</fmiModelDescription>
"""


def _description3(step: str, outputs: bool) -> str:
    lines = STRUCTURE3.split("\n")
    structure = "\n".join(line for line in lines if outputs or "<Output" not in line)
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="follower" instantiationToken="{GUID}">
  <ModelExchange modelIdentifier="follower"/>
  <CoSimulation modelIdentifier="follower" {step}/>
  {UNITS}
  <DefaultExperiment stepSize="0.01"/>
  <ModelVariables>{VARIABLES3.format(output="output" if outputs else "local")}
  </ModelVariables>
  <ModelStructure>{structure}
  </ModelStructure>
</fmiModelDescription>
"""
