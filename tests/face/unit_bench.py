"""A bench with a parameter, an input, a state and an output of each kind of unit, and its FMU of another maker."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

from hydrotwin.models.language.units import convert, convert_difference, si_unit
from tests.export.foreign import rewritten

TURN = 6.283185307179586
KINDS = {  # the unit it is declared in, its value there, and another value in several spellings
    "share": ("%", 20, ["40 %", "400 ‰", "4e5 ppm", "0.4 1"]),
    "temperature": ("degC", 20, ["30 degC", "303.15 K", "86 degF", "30°C"]),
    "rise": ("K", 20, ["30 K", "30000 mK", "30", "3e1 K"]),
    "pressure": ("bar", 20, ["30 bar", "3 MPa", "435.1132131 psi", "3e6Pa"]),
    "speed": ("rpm", 20, ["30 rpm", "30 1/min", f"{0.5 * TURN} rad/s", "180 deg/s"]),
    "rate": ("1/s", 20, ["30 1/s", "1800 1/min", "30 Hz", "30"]),
    "frequency": ("Hz", 20, ["30 Hz", "1800 1/min", "0.03 kHz", "30"]),
    "angle": ("deg", 20, ["30 deg", "30 °", f"{TURN / 12} rad", "0.0833333333333 rev"]),
    "flow": ("L/min", 20, ["30 L/min", "30 l/min", "500 cm3/s", "0.0005 m3/s"]),
    "size": ("cm3/rev", 20, ["30 cm3/rev", f"{30e-6 / TURN} m3/rad", "30 ccm/U", "0.03 L/rev"]),
    "length": ("mm", 20, ["254 mm", "10 in", "25.4 cm", "0.254 m"]),
    "force": ("kN", 20, ["30 kN", "30000 N", "0.03 MN", "3e4 N"]),
    "torque": ("N.m", 20, ["30 N.m", "30Nm", "0.03 kN.m", "30"]),
    "lateness": ("ms", 20, ["30 ms", "0.03 s", "0.0005 min", "30000 us"]),
    "mass": ("t", 20, ["30 t", "30000 kg", "3e4 kg", "3e7 g"]),
    "voltage": ("V", 20, ["30 V", "30000 mV", "0.03 kV", "30"]),
    "ratio": ("1", 20, ["30 1", "3000 %", "30", "3e1"]),
}
EXPECTED = {k: convert(30.0 if k not in ("share", "length") else {"share": 40.0, "length": 254.0}[k], u, si_unit(u))
            for k, (u, _, _) in KINDS.items()}  # fmt: skip
START = {k: convert(float(start), unit, si_unit(unit)) for k, (unit, start, _) in KINDS.items()}
ALONE = [
    k for k, (unit, _, _) in KINDS.items() if convert_difference(1.0, unit, si_unit(unit)) != 1 or k == "temperature"
]


def bench() -> str:
    """The bench as a file: every state settles between its parameter and its input."""
    lines = ["from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der", ""]
    lines += ["class Bench(Component):", "    lag = Parameter(0.05, 's', 'lag', source='test')"]
    for k, (unit, start, _) in KINDS.items():
        lines += [
            f"    level_{k} = Parameter({start}.0, '{unit}', 'level', free=True, source='test')",
            f"    drive_{k} = Input('{unit}', 'drive', interpolation='hold')",
            f"    state_{k} = State({start}.0, '{unit}', 'state')",
            f"    seen_{k} = Output('{unit}', 'seen')",
        ]
    lines += ["    def equations(self):"]
    for k in KINDS:
        lines += [f"        yield der(self.state_{k}) == (0.5*(self.level_{k}+self.drive_{k})-self.state_{k})/self.lag"]
        lines += [f"        yield self.seen_{k} == self.state_{k}"]
    return "\n".join([*lines, "def bench():", "    return Model(Bench(), 'bench', step=0.01)", ""])


def recording(off: float = 0.0) -> str:
    """Everything at its start in the units of the declarations; what is seen is ``off`` of them."""
    head = [f"{what}_{k} [{unit}]" for k, (unit, _, _) in KINDS.items() for what in ("drive", "seen")]
    row = [str(start + of) for _, start, _ in KINDS.values() for of in (0.0, off)]
    first = [str(start) for _, start, _ in KINDS.values() for _ in range(2)]
    rows = [[f"{0.01 * k:.2f}", *(row if k else first)] for k in range(121)]
    return "\n".join(",".join(r) for r in (["time [s]", *head], *rows)) + "\n"


VENDOR = {  # how an FMU declares a parameter, the number in it, and what a person may write for that
    "pressure": ('unit="bar"', 'kg="1" m="-1" s="-2" factor="1e5" offset="101325"', 2.0, ["2 bar", "301325 Pa"]),
    "temperature": ('unit="C"', 'K="1" offset="273.15"', 30.0, ["30 C", "303.15 K", "86 degF", "30 degC"]),
    "torque": ('unit="tick"', 'kg="1" m="2" s="-2" factor="2"', 3.0, ["3 tick", "6 N.m", "6000 N.mm"]),
    "rise": ('unit="degC" relativeQuantity="true"', 'K="1" offset="273.15"', 5.0, ["5 degC", "5 K", "9 degF", "5"]),
    "length": ('unit="m" displayUnit="zoll"', "", 0.254, ["10 zoll", "0.254 m", "10 in"]),
    "share": ('unit="%"', "", 40.0, ["40 %", "0.4 1", "400 ‰"]),
    "speed": (
        'unit="rpm"',
        's="-1" factor="0.016666666666666666"',
        30.0,
        ["30 rpm", f"{0.5 * TURN} rad/s", "180 deg/s"],
    ),
}


def vendors(own: Path, path: Path) -> None:
    """The FMU of the bench as another maker would have it, who defines units himself."""
    with zipfile.ZipFile(own) as archive:
        xml = archive.read("modelDescription.xml").decode()
    bases = {re.search('unit="(.*?)"', said)[1]: base for said, base, *_ in VENDOR.values() if base}
    units = "".join(f'<Unit name="{unit}"><BaseUnit {base}/></Unit>' for unit, base in bases.items())
    changes = {"<UnitDefinitions>": f"<UnitDefinitions>{units}"}
    metre = re.search(r'<Unit name="m">.*?</Unit>', xml, re.S)[0]
    changes[metre] = metre.replace("</Unit>", '<DisplayUnit name="zoll" factor="39.37007874015748"/></Unit>')
    for k, (said, *_) in VENDOR.items():
        element = re.search(rf'<ScalarVariable name="level_{k}".*?</ScalarVariable>', xml, re.S)[0]
        changes[element] = re.sub(r"<Real [^>]*/>", f'<Real {said} start="1"/>', element)
    rewritten(own, path, xml=changes)
