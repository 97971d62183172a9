"""Virtual tests of lap plates with a known cause in the joint, seen by twelve sensors."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from pathlib import Path

import numpy as np
import ufl
from case_tables import write_frequencies, write_table
from mpi4py import MPI
from virtual_plates import LAYER, RHO, ZONES, E, G, noisy, noisy_shapes, plates

from fenics_joints.measurements import pair_modes
from fenics_joints.meshes import lap_plates
from fenics_joints.meshes.lap_plates import BOLTS
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Sensors, Structure, joint, part

#: Stiffness of the nominal joint per area, Pa/m, across it and along it.
K_N, K_T = 2e12, 6e11
COUNT, NOISE, SHAPE_NOISE = 7, 0.0005, 0.02
_X = (0.01, 0.08, 0.15, 0.17, 0.24, 0.31)

_TEST = """
[test]
frequencies = "frequencies.csv"
condition = "torque"
noise = "0.05 %"
shapes = "shapes.csv"
shape_noise = "2 %"

[test.sees]
points = {points}
direction = [0, 0, 1]

[diagnose]
n_modes = 20
samples = 8
joints = "given"
discrepancy = "1 %"
shape_discrepancy = "8 %"
max_effects = 1
patches = 0
"""


def virtual_lap(
    *, factor: Callable[[object], object] | None = None, shear: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, (1, m), and shapes, (n_s, m), with noise.

    Args:
        factor: True over nominal stiffness of the layer as a function of position, in UFL.
        shear: True over nominal shear modulus of the plates.
    """
    tagged = lap_plates(MPI.COMM_SELF, element_size=0.0134, n_thickness=2, layer=LAYER)
    nu = E / (2 * shear * G) - 1
    metal = part("plates", ("plate_1", "plate_2"), E=E, nu=nu, rho=RHO)
    sensors = _sensors(LAYER)

    def stiff(k):
        return k * LAYER if factor is None else lambda x, _: k * LAYER * factor(x)

    layer = joint("joint", ("joint_near", "joint_away"), E=stiff(K_N), G=stiff(K_T))
    modes = solve_modes(Structure(tagged, [metal, layer]), n_modes=20)
    pairing = pair_modes(modes, COUNT, sensors)
    rng = np.random.default_rng(3)
    hz = noisy(modes.frequencies_hz[None, pairing.index], NOISE, rng)
    return hz, noisy_shapes(pairing.shapes, SHAPE_NOISE, rng)


def loose(*bolts: int) -> Callable[[object], object]:
    """Stiffness factor of a joint with loose bolts, numbered from 1."""

    def factor(x):
        found = 1.0
        for i in bolts:
            own = _from(x, i)
            others = [ufl.lt(own, _from(x, j)) for j in range(1, len(BOLTS) + 1) if j != i]
            found = ufl.conditional(reduce(ufl.And, others), 1e10 / K_T, found)
        return found

    return factor


def beyond(radius: float, times: float) -> Callable[[object], object]:
    """Stiffness factor of a layer: ``times`` beyond a radius, m, about its bolts."""

    def factor(x):
        near = [ufl.lt(_from(x, i), radius**2) for i in range(1, len(BOLTS) + 1)]
        return ufl.conditional(reduce(ufl.Or, near), 1.0, times)

    return factor


def _from(x, bolt: int):
    """Square of the distance from a bolt, m2."""
    (a, b) = BOLTS[bolt - 1]
    return (x[0] - a) ** 2 + (x[1] - b) ** 2


def write_virtual_lap(folder: Path, hz: np.ndarray, shapes: np.ndarray, *lines: str) -> Path:
    """Put the nominal case, whose ``[diagnose]`` ends in some lines, and these data into a folder,
    and return it."""
    names = write_frequencies(folder, hz, "mode", "torque [N·m]", [24.0])
    write_table(folder / "shapes.csv", names, shapes)
    tolerance = 'tolerance = { E = "0.5 %", rho = "0.3 %", thickness = "0.2 %" }\n'
    text = plates(ZONES.replace("0.4 GPa", "0.3 GPa"), tolerance)
    text += _TEST.format(points=_sensors(0.5e-3).points.tolist()) + "\n".join([*lines, ""])
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return folder


def _sensors(layer: float) -> Sensors:
    points = [[x, y, 0.008 if x < 0.12 else 0.016 + layer] for y in (0.0, 0.08) for x in _X]
    return Sensors(np.array(points), [0.0, 0.0, 1.0])
