"""A chain of three masses whose frequency response is known in closed form, and files of it."""

from __future__ import annotations

import numpy as np
import scipy.linalg

#: Masses, kg, and stiffness, N/m, of a chain between two walls; damping ratios of its modes.
M = np.diag([1.0, 1.3, 0.8])
K = 1e6 * np.array([[2.5, -1.0, 0.0], [-1.0, 2.2, -1.2], [0.0, -1.2, 2.0]])
ZETA = np.array([0.008, 0.012, 0.005])
#: Where the masses are, mm; mass 2 moves along y, the others along z.
NODES = {1: (0.0, 10.0, 5.0), 2: (250.0, 10.0, 5.0), 7: (500.0, -20.0, 5.0)}
AXES = {1: 3, 2: 2, 7: 3}
FREQUENCIES = 60.0 + 0.5 * np.arange(600)


def modes() -> tuple[np.ndarray, np.ndarray]:
    """Undamped frequencies, Hz, and mass-normalised shapes."""
    squares, phi = scipy.linalg.eigh(K, M)
    return np.sqrt(squares) / (2 * np.pi), phi


def accelerance(f: np.ndarray = FREQUENCIES) -> np.ndarray:
    """H_ij(f), m/s2/N, shape (n, 3, 3), by inversion of the dynamic stiffness at each line."""
    f_modes, phi = modes()
    C = M @ phi @ np.diag(2 * ZETA * 2 * np.pi * f_modes) @ phi.T @ M
    w = 2 * np.pi * f[:, None, None]
    return -(w**2) * np.linalg.inv(K + 1j * w * C - w**2 * M)


def function(i: int, j: int, **changes) -> dict:
    """Dataset 58 of response i by force j (from 0), in g/N; the first response is along -z."""
    nodes = list(NODES)
    sign = -1 if i == 0 else 1
    data = dict(
        type=58,
        binary=0,
        func_type=4,
        rsp_node=nodes[i],
        rsp_dir=sign * AXES[nodes[i]],
        ref_node=nodes[j],
        ref_dir=AXES[nodes[j]],
        abscissa_spacing=1,
        abscissa_spec_data_type=18,
        ordinate_spec_data_type=12,
        orddenom_spec_data_type=13,
        x=FREQUENCIES,
        data=sign * accelerance()[:, i, j] / 9.80665,
        ordinate_axis_units_lab="g",
        orddenom_axis_units_lab="N",
    )
    return data | changes


def coherence(i: int, j: int, **changes) -> dict:
    """Dataset 58 of its coherence: 0.95, and 0.5 at the first quarter of the lines."""
    gamma = np.where(np.arange(len(FREQUENCIES)) < len(FREQUENCIES) // 4, 0.5, 0.95)
    data = function(i, j, func_type=6, data=gamma) | {
        "ordinate_axis_units_lab": "NONE",
        "orddenom_axis_units_lab": "NONE",
    }
    return data | changes


def geometry(kind: int = 2411, **changes) -> list[dict]:
    """Datasets of nodes, in mm, and of units."""
    xyz = np.array(list(NODES.values()))
    n = len(xyz)
    nodes = dict(
        type=kind,
        node_nums=list(NODES),
        def_cs=[0] * n,
        disp_cs=[0] * n,
        color=[1] * n,
        x=xyz[:, 0],
        y=xyz[:, 1],
        z=xyz[:, 2],
    )
    return [units(), nodes | changes]


def units(length: float = 1000.0) -> dict:
    """Dataset 164: mm and mN by default, by which g/N of the labels are not meant."""
    return dict(
        type=164,
        units_code=9,
        units_description="said here",
        temp_mode=1,
        length=length,
        force=1.0,
        temp=1.0,
        temp_offset=0.0,
    )


def system(label: int, axes, kind: int = 0) -> dict:
    """Dataset 2420: a coordinate system, rows of its matrix the axes and the origin."""
    one = dict(CS_sys_labels=[label], CS_types=[kind], CS_colors=[8], CS_names=[f"CS{label}"])
    return dict(type=2420, Part_UID=1, Part_Name="p", CS_matrices=[np.array(axes, float)]) | one


def write_uff(path, *sets: dict):
    """Write datasets to a universal file, by pyuff."""
    import pyuff

    # By adding: pyuff's mode "overwrite" loses the head of a first dataset that is binary.
    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets([dict(s) for s in sets], mode="add")
    return path
