"""A small lap beam with a nonlinear joint, or with contact, as a case for ``harmonic``."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

#: The case of the notebook, which a script runs; with measured curves.
_NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "notebooks" / "harmonic.py"
LAYER = _NOTEBOOK.read_text(encoding="utf-8").split('"""')[1] + 'measured = "frf.csv"\n'
CURVES = "level [N],frequency [Hz],amplitude [m/s2]\n10,27,40\n10,27.8,90\n10,29,50\n"

CONTACT = (
    LAYER.replace('layer = "0.06 mm"\n', "").split("[joints.lap]")[0]
    + """
[contacts.lap]
lower = "interface_lower"
upper = "interface_upper"
friction = 0.3
[bolts.bolt]
kind = "washers"
lower = "washer_lower"
upper = "washer_upper"
force = "120 N"
[supports.clamp]
facets = "clamp"
[nonlinear.lap]
law = "coulomb"
normal_stiffness = "100 GPa/m"
tangential_stiffness = "30 GPa/m"
friction = 0.02
[harmonic]
"""
    + LAYER.split("[harmonic]\n")[1]
    + "interface_modes = 30\n"
)


def write(folder: Path, text: str = LAYER, *edits: tuple[str, str]) -> Path:
    """Put a case there, on rank 0 alone."""
    if MPI.COMM_WORLD.rank == 0:
        for old, new in edits:
            assert text.count(old) == 1, f"{old!r} is {text.count(old)} times in the case"
            text = text.replace(old, new)
        (folder / "case.toml").write_text(text, encoding="utf-8")
        (folder / "frf.csv").write_text(CURVES, encoding="utf-8")
    MPI.COMM_WORLD.barrier()
    return folder
