"""Virtual tests of lap plates whose cause is known, from a mesh unlike the diagnosed model's."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from case_tables import write_frequencies, write_table
from mpi4py import MPI

from fenics_joints.forms import lame_parameters
from fenics_joints.measurements import pair_modes
from fenics_joints.meshes import lap_plates
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Parameter, PointMass, Sensors, Structure, joint, part

TORQUES = np.array([4.0, 24.0])
NOISE, SHAPE_NOISE = 0.003, 0.02
E, G, RHO = 69e9, 26.9e9, 2750.0
NU = E / (2 * G) - 1
#: Thinner than the case's 0.5 mm: stiffness per area is what the two have in common.
LAYER = 0.3e-3
_ALONG = (0.01, 0.06, 0.11, 0.16, 0.21, 0.26, 0.31)

_PLATES = """
title = "Virtual lap plates"

[mesh]
builder = "lap_plates"
element_size = "{size} mm"
n_thickness = 1

[parts.plates]
cells = ["plate_1", "plate_2"]
E = "{E} Pa"
G = "{G} Pa"
rho = "{rho} kg/m3"
"""
#: The joint in two zones, and in one.
ZONES = """
[joints.near]
cells = "joint_near"
bolted = true
E = "1 GPa"
G = "0.4 GPa"

[joints.away]
cells = "joint_away"
E = "1 GPa"
G = "0.4 GPa"
"""
LAP = """
[joints.lap]
cells = ["joint_near", "joint_away"]
E = "1 GPa"
G = "0.4 GPa"
"""
#: What `along` sees, as the nominal model has it.
SEES = """
[test.sees]
along = "x"
positions = ["10 mm", "60 mm", "110 mm", "160 mm", "210 mm", "260 mm", "310 mm"]
at = { y = "40 mm", z = ["8 mm", "8 mm", "8 mm", "16.5 mm", "16.5 mm", "16.5 mm", "16.5 mm"] }
direction = [0, 0, 1]
"""
_ATTACHED = """
[attached.accelerometer]
kind = "mass"
points = [["10 mm", "40 mm", "0 mm"]]
mass = "20 g"
tolerance = "10 %"
travel = ["5 mm", "195 mm"]

[attached.suspension]
kind = "spring"
points = [["20 mm", "0 mm", "4 mm"], ["300 mm", "0 mm", "12.5 mm"]]
direction = [0, 1, 0]
stiffness = "1 kN/m"
"""
_TEST = """
[test]
frequencies = "frequencies.csv"
condition = "torque"
noise = "0.3 %"
"""


def plates(joints: str, tolerance: str = "", *, size=20, E: float = E, G: float = G) -> str:
    """The case of the nominal plates with these joints; elements of ``size`` mm."""
    return _PLATES.format(size=size, E=E, G=G, rho=RHO) + tolerance + joints


def along(layer: float) -> Sensors:
    """Sensors on the middle line of plates with a layer of this thickness, m."""
    points = [[x, 0.04, 0.008 if x < 0.12 else 0.016 + layer] for x in _ALONG]
    return Sensors(np.array(points), [0.0, 0.0, 1.0])


def noisy(clean: np.ndarray, sd: float, rng: np.random.Generator) -> np.ndarray:
    """Numbers with a relative noise."""
    return clean * np.exp(sd * rng.standard_normal(clean.shape))


def noisy_shapes(clean: np.ndarray, sd: float, rng: np.random.Generator) -> np.ndarray:
    """Shapes with a noise relative to their root mean squares."""
    size = np.sqrt(np.mean(clean**2, axis=0))
    return clean + sd * size * rng.standard_normal(clean.shape)


@dataclass(frozen=True)
class Measured:
    """Measured data.

    Attributes:
        frequencies_hz: Frequencies, Hz, of the bending modes at all torques, (n, m).
        shapes: Their shapes at the sensors at the highest torque, (n_s, m).
    """

    frequencies_hz: np.ndarray
    shapes: np.ndarray

    def noisy(self, seed: int = 3) -> Measured:
        """The data with the noise that the case states."""
        rng = np.random.default_rng(seed)
        hz = noisy(self.frequencies_hz, NOISE, rng)
        return Measured(hz, noisy_shapes(self.shapes, SHAPE_NOISE, rng))


@functools.cache
def virtual_test(
    *, k_t: float = np.inf, modulus: float = 1.0, thickness: float = 1.0, mass: float = 0.0
) -> Measured:
    """Four bending modes at all torques, without noise.

    Args:
        k_t: Tangential stiffness of the joint per area at the highest torque, Pa/m; it grows with
            the root of the torque, and is the same everywhere.
        modulus: True over nominal modulus of the plates.
        thickness: True over nominal thickness of the plates.
        mass: Mass, kg, on the end of plate 1.
    """
    tagged = lap_plates(MPI.COMM_SELF, element_size=0.0134, n_thickness=2, layer=LAYER)
    lmbda, mu = (modulus * c for c in lame_parameters(E, NU))
    cells = ("plate_1", "plate_2")
    plates = part("plates", cells, E=modulus * E, nu=NU, rho=RHO, stretch=thickness)
    layer = joint("joint", ("joint_near", "joint_away"), E=lmbda + 2 * mu, G="G")
    end = PointMass("accelerometer", mass, (0.02, 0.04, 0.0))
    model = Structure(tagged, [plates, layer], [Parameter("G", mu)], masses=[end])
    sensors = along(LAYER)
    torques = TORQUES if np.isfinite(k_t) else TORQUES[-1:]
    rows = []
    for torque in torques:
        stiffness = k_t * np.sqrt(torque / TORQUES[-1])
        modes = solve_modes(model, {"G": 1 / (1 / mu + 1 / (stiffness * LAYER))}, n_modes=18)
        pairing = pair_modes(modes, 4, sensors)
        rows.append(modes.frequencies_hz[pairing.index])
    return Measured(np.broadcast_to(rows, (len(TORQUES), 4)).copy(), pairing.shapes)


def write_virtual_case(folder: Path, measured: Measured, *lines: str, shapes: bool = False) -> Path:
    """Put the nominal model's case and these data into a folder, and return it.

    Args:
        folder: Where to.
        measured: The data.
        lines: What else ``[diagnose]`` says.
        shapes: Whether the test has measured shapes.
    """
    names = write_frequencies(folder, measured.frequencies_hz, "bending", "torque [N·m]", TORQUES)
    test = _TEST
    if shapes:
        write_table(folder / "shapes.csv", names, measured.shapes)
        test += f'shapes = "shapes.csv"\nshape_noise = "{100 * SHAPE_NOISE:g} %"\n'
    diagnose = ("", "[diagnose]", "n_modes = 18", "samples = 8", *lines, "")
    text = plates(ZONES) + _ATTACHED + test + SEES + "\n".join(diagnose)
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return folder


def assert_same_evidence(found, expected):
    """Compare ln Z to the accuracy of the reduced model, which is lower for unlikely hypotheses:
    their fits are far from its samples."""
    logs, others = ({h.label: h.log_evidence for h in d.hypotheses} for d in (found, expected))
    assert logs.keys() == others.keys()
    best = max(others.values())
    for label, value in others.items():
        assert abs(logs[label] - value) < 0.02 + 0.03 * (best - value), label
