"""Simulate the test of the sandwich layer: frequencies and response functions with noise, as files.

The layer has the paper's "material parameters 1" (Table 6) and is meshed in its true thickness. The
functions are direct solutions of the full model. The update shares nothing with this model: its
layer is meshed thicker and mapped to the thickness h, and it runs on a reduced model. Run it with

    ./with-fenicsx python3 demos/dumbbell/sandwich/make_test.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pyuff
from mpi4py import MPI

from fenics_joints.meshes import dumbbell
from fenics_joints.modal import solve_modes
from fenics_joints.response import solve_frf
from fenics_joints.structure import Damping, Sensors, Structure, part, transition

H, E, NU = 10e-3, 10e9, 0.24  # Table 6, material parameters 1
LOSS, STRUCTURAL = 0.02, 0.002
FREQUENCY_NOISE, FUNCTION_NOISE = 1e-3, 0.02  # relative standard deviations
LINES = np.arange(400.0, 3001.0, 10.0)
MESHED = 20e-3  # thickness of the layer in the case's mesh, to which the coordinates of NODES refer
#: Nodes at corners of the heads, m, in the case's mesh. The hammer strikes at node 57.
NODES = {57: (0.12, 0.09, -0.13), 12: (-0.12, 0.09, 0.13 + MESHED)}
BODIES = ("head_1", "neck_1", "neck_2", "head_2")


def structure(element_size: float) -> Structure:
    """The dumbbells with the true layer, meshed in its thickness."""
    tagged = dumbbell(MPI.COMM_WORLD, layer=H, element_size=element_size)
    bodies = part("bodies", BODIES, E=130e9, nu=0.27, rho=7850.0)
    layer = transition("sandwich", "joint", E=E, nu=NU, h=H, meshed=H, rho=7850.0)
    return Structure(tagged, [bodies, layer])


def places(axes: str, nodes) -> tuple[Sensors, list[tuple[int, int]]]:
    """Sensors at nodes along axes; (node, direction) of each, as universal files number them."""
    there = [(node, axis) for node in nodes for axis in axes]
    points = np.array([NODES[node] for node, _ in there])
    # Body 2 sits lower on the thinner layer.
    points[points[:, 2] > 0, 2] -= MESHED - H
    directions = [np.eye(3)["xyz".index(axis)] for _, axis in there]
    return Sensors(points, directions), [(node, "xyz".index(axis) + 1) for node, axis in there]


def main(folder: Path, element_size: float = 0.045, lines: np.ndarray = LINES) -> None:
    """Write ``frequencies.csv`` and ``frfs.uff``."""
    model, rng = structure(element_size), np.random.default_rng(42)
    modes = solve_modes(model, n_modes=12)
    f = modes.frequencies_hz[6:12] * np.exp(FREQUENCY_NOISE * rng.standard_normal(6))
    sensors, responses = places("xyz", (57, 12))
    excitation, references = places("xz", (57,))
    frf = solve_frf(
        model,
        frequencies_hz=lines,
        excitation=excitation,
        sensors=sensors,
        kind="accelerance",
        damping=Damping(structural=STRUCTURAL, hysteretic={"sandwich": LOSS}),
    )
    noise = rng.standard_normal((2, *frf.values.shape))
    values = frf.values * (1 + FUNCTION_NOISE * (noise[0] + 1j * noise[1]))
    if MPI.COMM_WORLD.rank:
        return
    heads = ",".join(f"mode {i + 1} [Hz]" for i in range(6))
    row = ",".join(f"{value:.3f}" for value in f)
    (folder / "frequencies.csv").write_text(f"{heads}\n{row}\n", encoding="utf-8")
    write_uff(folder / "frfs.uff", lines, values, responses, references)


def write_uff(path: Path, lines, values: np.ndarray, responses, references) -> None:
    """Write units, nodes and one dataset 58 for each function."""
    xyz, n = np.array(list(NODES.values())), len(NODES)
    sets = [
        dict(
            type=164,
            units_code=1,
            units_description="SI",
            temp_mode=1,
            length=1.0,
            force=1.0,
            temp=1.0,
            temp_offset=273.15,
        ),
        dict(
            type=2411,
            node_nums=list(NODES),
            def_cs=[0] * n,
            disp_cs=[0] * n,
            color=[1] * n,
            x=xyz[:, 0],
            y=xyz[:, 1],
            z=xyz[:, 2],
        ),
    ]
    for i, (node, direction) in enumerate(responses):
        for j, (at, along) in enumerate(references):
            sets.append(
                dict(
                    type=58,
                    binary=0,
                    func_type=4,
                    rsp_node=node,
                    rsp_dir=direction,
                    ref_node=at,
                    ref_dir=along,
                    abscissa_spacing=1,
                    abscissa_spec_data_type=18,
                    ordinate_spec_data_type=12,
                    orddenom_spec_data_type=13,
                    x=lines,
                    data=values[:, i, j].astype(np.complex64),
                    ord_data_type=5,
                    ordinate_axis_units_lab="m/s2",
                    orddenom_axis_units_lab="N",
                )
            )
    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(sets, mode="add")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
