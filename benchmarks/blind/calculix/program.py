"""CalculiX as a program: where it is, and modes by it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

#: What is said where it is not there.
MISSING = (
    "the second world needs CalculiX (`ccx`, Debian's calculix-ccx), which is not in PATH; in the "
    "private root of with-fenicsx, which hides the system's programs, run "
    "`bash benchmarks/blind/calculix/lend_ccx` once outside of it, or name the program in CCX"
)
LENT = Path(__file__).resolve().parents[1] / "cache" / "ccx" / "ccx"
_SECONDS = 600


class CalculixError(RuntimeError):
    """CalculiX is missing, or found no modes."""


def find_program() -> str:
    """The program: that in the environment's CCX, one in PATH, or the one that was lent.

    Raises:
        CalculixError: If there is none.
    """
    given = os.environ.get("CCX")
    found = shutil.which(given) if given else shutil.which("ccx") or shutil.which(str(LENT))
    if found is None:
        raise CalculixError(MISSING if given is None else f"CCX={given}: no such program")
    return found


def run_modes(deck: str, n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, (m,), and displacements of the printed nodes, (m, n_nodes, 3).

    Args:
        deck: The input, which prints one set of nodes in its frequency step.
        n_nodes: How many it has.

    Raises:
        CalculixError: If it fails.
    """
    program = find_program()
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "job.inp").write_text(deck, encoding="ascii")
        try:
            done = subprocess.run(
                [program, "job"],
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=_SECONDS,
                env=os.environ | {"OMP_NUM_THREADS": "1"},
            )
        except subprocess.TimeoutExpired as error:
            raise CalculixError(f"CalculiX took more than {_SECONDS} s") from error
        output = Path(folder) / "job.dat"
        if done.returncode or not output.exists():
            raise CalculixError(f"CalculiX ended with {done.returncode}: {done.stdout[-1500:]}")
        return _read(output.read_text(encoding="ascii"), n_nodes)


def _read(text: str, n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Of ``job.dat`` the table of eigenvalues, and the printed displacements of each mode."""
    blocks = re.split(r"displacements \(vx,vy,vz\) for set \S+ and time .*\n", text)
    table = blocks[0].split("E I G E N V A L U E   O U T P U T")[-1]
    table = table.split("P A R T I C I P A T I O N")[0]
    rows = [line.split() for line in table.splitlines()]
    # Number, eigenvalue, frequency in rad and cycles per time, imaginary part.
    hz = [float(row[3]) for row in rows if len(row) == 5 and row[0].isdigit()]
    shapes = []
    for block in blocks[1:]:
        lines = block.strip().splitlines()[:n_nodes]
        shapes.append([[float(v) for v in line.split()[1:4]] for line in lines])
    if not hz or len(hz) != len(shapes):
        raise CalculixError(f"CalculiX wrote {len(hz)} frequencies and {len(shapes)} shapes")
    return np.array(hz), np.array(shapes)
