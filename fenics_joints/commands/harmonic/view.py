"""The view of harmonic responses: how the structure moves at its peaks, where its joints slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from matplotlib.colors import LinearSegmentedColormap
from scipy.spatial import cKDTree

from fenics_joints.commands.harmonic.model import SENSOR
from fenics_joints.commands.harmonic.result import HarmonicReport
from fenics_joints.formatting import quantity
from fenics_joints.harmonic import HarmonicResult, Loops
from fenics_joints.preload.bodies import body_numbers
from fenics_joints.report import geometry
from fenics_joints.report.mesh_pictures import diverging, mode_shape
from fenics_joints.report.surface import Surface, surface
from fenics_joints.report.view import Colours, SurfaceView, scene

#: Near white to dark red, ever darker: it reads in grey as well.
_RISING = LinearSegmentedColormap.from_list("rising", ["#f4f2ee", "#f6c79b", "#dd6b4a", "#7d1128"])

#: Points of a layer that a vertex has its colour from, and how far from a contact's points, as a
#: share of the structure, a vertex is still theirs.
_NEAREST, _AT = 4, 1e-4


@dataclass(frozen=True, repr=False)
class PeakShapes:
    """Motion of a structure at the peak of each level; on rank 0.

    Attributes:
        vertices: Corners of all cells, m, (n_cells, n_corners, 3).
        motions: How they move when the sensor is farthest out, by the first harmonic, m,
            (n_levels, n_cells, n_corners, 3).
        piece: Number of the connected piece of one body and region that each cell belongs to.
        layers: Pieces of each nonlinear layer, by its name.
    """

    vertices: np.ndarray
    motions: np.ndarray
    piece: np.ndarray
    layers: dict[str, np.ndarray]

    def __repr__(self) -> str:
        return f"PeakShapes({len(self.motions)} levels, {len(self.vertices)} cells)"


def peak_shapes(r: HarmonicReport) -> PeakShapes | None:
    """Shapes of the responses. Collective.

    Returns:
        The shapes on rank 0; None on the others, and of a model without its mesh (one that was
        kept beside its branches, or parts by matrices) or in the plane.
    """
    source = r.built.model.source
    if source is None or source.full.gdim < 3 or not source.full.is_meshed:
        return None
    structure, vectors = source.full, []
    for response in r.responses:
        vector = source.basis[0].duplicate()
        vector.set(0.0)
        for share, column in zip(_farthest(response), source.basis, strict=True):
            vector.axpy(float(share), column)
        vectors.append(vector)
    vertices, motions = structure.corner_motion(vectors)
    for vector in vectors:
        vector.destroy()
    bodies, _ = body_numbers(structure.V)
    own = structure.mesh.topology.index_map(structure.mesh.topology.dim).size_local
    body = structure.comm.gather(bodies[structure.V.dofmap.list[:own, 0]])
    number = structure.cell_regions()
    if number is None:
        return None
    label = np.concatenate(body) * (number.max() + 1) + number
    piece = geometry.pieces_of(geometry.vertex_ids(vertices), label)
    names = [found.name for found in structure.regions]
    layers = {
        name: np.unique(piece[number == names.index(name)])
        for name in r.case.joints
        if name in r.case.nonlinear
    }
    return PeakShapes(vertices, motions, piece, layers)


def _farthest(response: HarmonicResult) -> np.ndarray:
    """First harmonic at a peak at the instant when the sensor is farthest out, (n,)."""
    i = response.peak.index
    first = response.balance.fourier.cosine()
    cosine, sine = response.coefficients[i].T[first : first + 2]
    a, b = response.sensor_coefficients(SENSOR)[i, first : first + 2]
    size = np.hypot(a, b) or 1.0
    return (a * cosine + b * sine) / size


def response_view(
    r: HarmonicReport, shapes: PeakShapes, loops: dict[str, Loops]
) -> tuple[Markup, str]:
    """The view, and a picture of the highest level's peak for paper.

    Args:
        r: The report.
        shapes: Its shapes.
        loops: Strain and stress over a cycle at the highest level's peak, by joint.
    """
    x, highest = shapes.vertices, shapes.motions[-1]
    way = np.zeros(3)
    direction = r.case.harmonic.sensor.direction
    way[: len(direction)] = direction
    turn = geometry.upright(x)

    def looks(s: Surface) -> list[SurfaceView]:
        moved = [_moved(r, k, shapes.motions[k], s, way) for k in reversed(range(len(r.facts)))]
        return [*moved, *_slipped(r, shapes, s, loops)]

    level = geometry.stacked(x @ turn[2], shapes.piece)
    whole = surface(x, shapes.piece, level, [highest])
    top = quantity(r.facts[-1].level, r.level_unit)
    name = f"The structure at its peaks, and where its joints slip at {top}."
    words = f"The structure at the peak of {top}, {r.facts[-1].peak_hz:.3f} Hz."
    still = mode_shape(x, highest, way, "peak", words)
    return scene(whole, looks, name, turn=turn, apart=True), still


def _moved(
    r: HarmonicReport, k: int, motion: np.ndarray, s: Surface, way: np.ndarray
) -> SurfaceView:
    facts, at = r.facts[k], motion.reshape(-1, 3)[s.pick]
    most = float(np.linalg.norm(motion, axis=-1).max(initial=0.0))
    return SurfaceView(
        f"peak at {quantity(facts.level, r.level_unit)}, {facts.peak_hz:.3f} Hz",
        Colours(diverging, "one way", "the other", "motion along the sensor's direction"),
        motion=at,
        way=way,
        note=f"First harmonic when the sensor is farthest out, up to {quantity(most, 'm')}"
        f"{r.relative}, enlarged.",
    )


def _slipped(
    r: HarmonicReport, shapes: PeakShapes, s: Surface, loops: dict[str, Loops]
) -> list[SurfaceView]:
    """Slip and energy over all joints that have points, at the highest level's peak."""
    joints = [p for p in r.built.model.interfaces if p.points is not None]
    if not joints:
        return []
    layered = all(p.name in shapes.layers for p in joints)
    top = quantity(r.facts[-1].level, r.level_unit)
    asked = (
        ("shear strain" if layered else "slip", "" if layered else "m", "slip_amplitude"),
        ("energy per cycle", "J/m³" if layered else "J/m²", "dissipation"),
    )
    motion = shapes.motions[-1].reshape(-1, 3)[s.pick]
    found = []
    for words, unit, key in asked:
        at, most = np.full(len(s.points), np.nan), 0.0
        for p in joints:
            values = getattr(loops[p.name], key)
            _spread(at, values, p.points, s, shapes.layers.get(p.name))
            most = max(most, float(values.max(initial=0.0)))
        most = most or 1.0
        high = quantity(most, unit) if unit else f"{most:.3g}"
        label = f"{words} in the {'layers' if layered else 'contacts'}"
        half = "; half of peak to peak over a cycle" if key == "slip_amplitude" else ""
        found.append(
            SurfaceView(
                f"{words} at {top}",
                Colours(_RISING, "0", high, label, "elsewhere"),
                motion=motion,
                values=np.clip(at / most, 0.0, 1.0),
                shown=(0.0, most, unit),
                note=f"At the peak of {top}{half}.",
            )
        )
    return found


def _spread(
    at: np.ndarray, values: np.ndarray, points: np.ndarray, s: Surface, pieces: np.ndarray | None
) -> None:
    """Put a joint's values to the vertices that are its own: in a layer, or at a contact."""
    tree = cKDTree(points)
    if pieces is None:
        off, nearest = tree.query(s.points)
        own = np.flatnonzero(off <= _AT * np.ptp(s.points, axis=0).max())
        at[own] = values[nearest[own]]
        return
    own = np.flatnonzero(np.isin(s.group, pieces))
    k = min(_NEAREST, len(points))
    off, nearest = (a.reshape(len(own), k) for a in tree.query(s.points[own], k=k))
    share = 1 / np.maximum(off, 1e-12)
    at[own] = (share * values[nearest]).sum(axis=1) / share.sum(axis=1)
