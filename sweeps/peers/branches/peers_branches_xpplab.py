"""XPPAUT's AUTO by xpplab on a case of `sweeps.peers.branches.peers_branches`, in an interpreter of its own: what it
finds, as JSON.

    PYTHON -P peers_branches_xpplab.py CASE

As its documentation goes: equilibria, then the cycles from their Hopf point; it does not go over onto other branches.
Tolerances are 1e-7 and 1e-6 where XPPAUT has 1e-4. Nothing of jaxnh is imported.
"""
# pyright: reportMissingImports=false

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

BEGAN = time.perf_counter()

import xpplab  # noqa: E402

KINDS = {
    "LP": "fold", "PD": "period_doubling", "TR": "neimark_sacker", "BP": "branch_point", "HB": "hopf"
}  # fmt: skip

CIRCUIT = """\
par nu=-0.9
x'=(-(0.5+nu)*x+0.5*y-0.32858*x^3+0.93358*(y-x)^3)/0.6
y'=0.5*x+0.1*y-z-0.93358*(y-x)^3
z'=y+0.001
init x=0.00125,y=-0.001,z=0.000525
done
"""

PEROXIDASE = """\
par k8=0.9
a'=-0.1631021*a*b*x-0.046875*a*b*y+1.5-0.1175*a
b'=-0.1631021*a*b*x-0.046875*a*b*y+k8
x'=0.1631021*a*b*x-2500*x^2+2*0.046875*a*b*y-20*x+0.001
y'=-0.046875*a*b*y+2500*x^2-1.104*y
init a=5,b=7.5,x=0.02,y=0.4
done
"""

CASES = {
    "circuit": (CIRCUIT, "nu", (-1.0, -0.4), 0.01, (-0.65, -0.58), -0.005, 50),
    "peroxidase": (PEROXIDASE, "k8", (0.3, 1.2), -0.01, (0.79, 0.86), 0.005, 100),
}
"""The model, its parameter, the range of equilibria and the first step, the same of cycles, intervals."""


def main() -> None:
    text, name, wide, first, (low, high), step, intervals = CASES[sys.argv[1]]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "case.ode")
        path.write_text(text)
        model = xpplab.load(str(path))
        fine = {"epsl": 1e-7, "epsu": 1e-7, "epss": 1e-6, "ntst": intervals, "dsmax": 0.02, "nmax": 300}
        still = model.auto.equilibria(name, ds=first, parmin=wide[0], parmax=wide[1], **fine)
        found = [("hopf", point.value) for point in still.special("HB")]
        diagram = model.auto.continue_from(still.first("HB"), "periodic", ds=step, parmin=low, parmax=high, **fine)
        points = len(diagram)
        found += [(KINDS[point.type], point.value) for point in diagram.special() if point.type in KINDS]
    inside = [(kind, value) for kind, value in found if low <= value <= high]
    print(json.dumps({"found": inside, "points": points, "seconds": time.perf_counter() - BEGAN}))


if __name__ == "__main__":
    main()
