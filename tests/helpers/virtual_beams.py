"""Cases of two overlapping steel beams with a generic joint (Jalali et al. 2019)."""

from __future__ import annotations

from pathlib import Path

DEMO = Path(__file__).resolve().parents[2] / "demos" / "bolted_beams"


def written(folder: Path, changes: dict[str, str], more: str = "") -> Path:
    """The demo's case with changes, in a folder of its own."""
    text = (DEMO / "case.toml").read_text(encoding="utf-8")
    for old, new in changes.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    for name in ("frequencies.csv", "specimens_simulated.csv"):
        text = text.replace(f'"{name}"', f"'{DEMO / name}'")
    path = folder / "case.toml"
    path.write_text(text + more, encoding="utf-8")
    return path


def beams(
    *,
    lengths: tuple[float, float] = (0.36, 0.26),
    lap: float = 0.05,
    section: tuple[float, float] = (0.021, 0.0106),
    elements: tuple[int, int] = (12, 9),
    lap_elements: int = 5,
    k1: float = 1763.2,
    k2: float = 37402.0,
    more: str = "",
) -> str:
    """The case as far as its joint, to which further lines may be added.

    Args:
        lengths: Of the beams, m.
        lap: Of the overlap, m.
        section: Width and height, m.
        elements: Of the beams beside the lap.
        lap_elements: Of the lap.
        k1: Slap stiffness of an element of the joint, N m.
        k2: Slip stiffness, N m.
        more: A line on the beams.
    """
    return f"""
title = "Virtual beams"
[mesh]
builder = "offset_beams"
lengths = {list(lengths)}
laps = {lap}
width = {section[0]}
thickness = {section[1]}
elements = {list(elements)}
lap_elements = {lap_elements}
[parts.beams]
cells = ["beam_1", "beam_2"]
E = "208 GPa"
nu = 0.3
rho = 7860.0
{more}[joints.lap]
cells = "lap"
law = "generic"
k1 = {k1}
k2 = {k2}
"""
