"""Virtual tests of lap plates on given layers, read all over: what the library should name."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from pathlib import Path

import numpy as np
import ufl
from mpi4py import MPI

from fenics_joints.measurements import pair_modes
from fenics_joints.meshes import lap_plates
from fenics_joints.meshes.lap_plates import BOLTS
from fenics_joints.modal import solve_modes
from fenics_joints.structure import PointMass, Sensors, Structure, joint, part

E, G, RHO = 69e9, 26.9e9, 2750.0
#: Stiffness of the nominal joint per area, Pa/m, across it and along it.
K_N, K_T = 2e12, 6e11
TORQUES = np.array([24.0])
COUNT, NOISE, SHAPE_NOISE = 7, 0.0005, 0.02
_LAYER = 0.3e-3
_X = (0.01, 0.08, 0.15, 0.17, 0.24, 0.31)

_CASE = """
title = "Virtual lap"

[mesh]
builder = "lap_plates"
element_size = "20 mm"
n_thickness = 1

[parts.plates]
cells = ["plate_1", "plate_2"]
E = "69 GPa"
G = "26.9 GPa"
rho = "2750 kg/m3"
tolerance = {{ E = "0.5 %", rho = "0.3 %", thickness = "0.2 %" }}

[joints.near]
cells = "joint_near"
bolted = true
E = "1 GPa"
G = "0.3 GPa"

[joints.away]
cells = "joint_away"
E = "1 GPa"
G = "0.3 GPa"

[test]
frequencies = "frequencies.csv"
condition = "torque"
noise = "0.05 %"
shapes = "shapes.csv"
shape_noise = "2 %"
{test}

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
nested = 0
patches = 0
{diagnose}
"""


def virtual_lap(
    *,
    factor: Callable[[object], object] | None = None,
    shear: float = 1.0,
    modulus: float = 1.0,
    density: float = 1.0,
    mass: tuple[float, tuple[float, float, float]] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, (1, m), and shapes, (n_s, m), with noise.

    Args:
        factor: What the layer's stiffness is of the nominal one, by place, in UFL.
        shear: True over nominal shear modulus of the plates.
        modulus: True over nominal Young's modulus; the shear modulus goes with it.
        density: True over nominal density.
        mass: A mass, kg, and where it is, m.
    """
    tagged = lap_plates(MPI.COMM_SELF, element_size=0.0134, n_thickness=2, layer=_LAYER)
    nu = E / (2 * shear * G) - 1
    plates = part("plates", ("plate_1", "plate_2"), E=modulus * E, nu=nu, rho=density * RHO)
    masses = [] if mass is None else [PointMass("more", *mass)]
    sensors = _sensors(_LAYER)

    def stiff(k):
        return k * _LAYER if factor is None else lambda x, _: k * _LAYER * factor(x)

    layer = joint("joint", ("joint_near", "joint_away"), E=stiff(K_N), G=stiff(K_T))
    modes = solve_modes(Structure(tagged, [plates, layer], masses=masses), n_modes=20)
    pairing = pair_modes(modes, COUNT, sensors)
    rows = [modes.frequencies_hz[pairing.index]] * len(TORQUES)
    rng, shapes = np.random.default_rng(3), pairing.shapes
    hz = np.array(rows) * np.exp(NOISE * rng.standard_normal((len(rows), COUNT)))
    size = np.sqrt(np.mean(shapes**2, axis=0))
    return hz, shapes + SHAPE_NOISE * size * rng.standard_normal(shapes.shape)


def loose(*bolts: int) -> Callable[[object], object]:
    """Bolts, numbered from 1, around which the faces only rest on each other."""

    def factor(x):
        found = 1.0
        for i in bolts:
            own = _from(x, i)
            others = [ufl.lt(own, _from(x, j)) for j in range(1, len(BOLTS) + 1) if j != i]
            found = ufl.conditional(reduce(ufl.And, others), 1e10 / K_T, found)
        return found

    return factor


def beyond(radius: float, times: float) -> Callable[[object], object]:
    """A layer so many times as stiff further than a radius, m, from its bolts."""

    def factor(x):
        near = [ufl.lt(_from(x, i), radius**2) for i in range(1, len(BOLTS) + 1)]
        return ufl.conditional(reduce(ufl.Or, near), 1.0, times)

    return factor


def _from(x, bolt: int):
    """Square of the distance from a bolt, m2."""
    (a, b) = BOLTS[bolt - 1]
    return (x[0] - a) ** 2 + (x[1] - b) ** 2


def write_virtual_lap(
    folder: Path, hz: np.ndarray, shapes: np.ndarray, diagnose: str = "", test: str = ""
) -> Path:
    """Put the nominal case and these data into a folder, and return it.

    Args:
        folder: Where to.
        hz: Frequencies.
        shapes: Shapes.
        diagnose: What else ``[diagnose]`` says.
        test: What else ``[test]`` says.
    """
    names = [f"mode {i + 1}" for i in range(COUNT)]
    _table(
        folder / "frequencies.csv",
        ["torque [N·m]", *(f"{n} [Hz]" for n in names)],
        np.column_stack([TORQUES, hz]),
    )
    _table(folder / "shapes.csv", names, shapes)
    points = _sensors(0.5e-3).points.tolist()
    text = _CASE.format(points=points, diagnose=diagnose, test=test)
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return folder


def _sensors(layer: float) -> Sensors:
    points = [[x, y, 0.008 if x < 0.12 else 0.016 + layer] for y in (0.0, 0.08) for x in _X]
    return Sensors(np.array(points), [0.0, 0.0, 1.0])


def _table(path: Path, head: list[str], rows: np.ndarray) -> None:
    lines = [",".join(head), *(",".join(f"{x:.10g}" for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
