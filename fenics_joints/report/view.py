"""Views in three dimensions, to turn and to move, in a page that needs nothing else.

What is to be seen goes into the page as numbers of 16 bit; ``templates/viewer.js`` draws them by
WebGL. A page without scripts, or on paper, has the picture that stands beside the view.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup
from matplotlib.colors import Colormap, to_hex

from fenics_joints.report.surface import Surface, coarsened

#: Most bytes of a view in a page, and most faces that it draws; chosen, for pages below 1.5 MB.
_BYTES, _FACES = 900_000, 60_000
#: Below any value: a vertex that has none.
_NONE = -32768


@dataclass(frozen=True)
class Colours:
    """Meaning of the colours of a view.

    Attributes:
        map: From low to high.
        low: Words or number at the low end.
        high: At the high end.
        label: Name of the coloured quantity.
        none: What the grey of a vertex without a value means; empty if there is none to speak of.
    """

    map: Colormap
    low: str
    high: str
    label: str
    none: str = ""

    def to_json(self) -> dict:
        """Colours as hexadecimal numbers, and the words."""
        stops = [to_hex(self.map(x)) for x in np.linspace(0, 1, 17)]
        words = {"low": self.low, "high": self.high, "label": self.label, "none": self.none}
        return {"stops": stops, **words}


@dataclass(frozen=True)
class Arrows:
    """Arrows at points, such as what a test measured.

    Attributes:
        name: Whose they are.
        colour: Of CSS.
        points: Where they start, m, (k, 3).
        vectors: As motions of the look that they belong to, (k, 3).
        ball: Whether they end in a ball instead of a tip.
    """

    name: str
    colour: str
    points: np.ndarray
    vectors: np.ndarray
    ball: bool = False


@dataclass(frozen=True)
class SurfaceView:
    """One view of a surface, to choose from the list.

    Attributes:
        name: In the list to choose from.
        colours: What its colours mean; None for none.
        motion: How the vertices move, any scale, (n, 3); None if they do not.
        way: Direction along which the motion is coloured, (3,); None where ``values`` are.
        values: From 0 to 1, (n,), nan for none.
        texts: Text at a vertex under the pointer, by the vertex's group.
        shown: What ``values`` are where they are shown, from low to high, with their unit.
        arrows: Arrows.
        note: A sentence below the view.
        scales: What each of the scene's tests is multiplied by here; empty without any.
        match: Which test it shows at first; None for none.
        mac: Modal assurance criterion with each of the tests.
    """

    name: str
    colours: Colours | None = None
    motion: np.ndarray | None = None
    way: np.ndarray | None = None
    values: np.ndarray | None = None
    texts: Sequence[str] = ()
    shown: tuple[float, float, str] | None = None
    arrows: Sequence[Arrows] = field(default_factory=tuple)
    note: str = ""
    scales: Sequence[float] = ()
    match: int | None = None
    mac: Sequence[float] = ()


def scene(
    surface: Surface,
    looks: Callable[[Surface], Sequence[SurfaceView]],
    name: str,
    *,
    turn: np.ndarray | None = None,
    apart: bool = False,
    parts: Sequence[str] = (),
    tests: Sequence[Arrows] = (),
) -> Markup:
    """A view as the JSON that the page's script draws.

    Args:
        surface: What is drawn, or a coarser one if the page would become too large.
        looks: Makes the looks of the surface that is drawn.
        name: What it shows, in words, for who does not see it.
        turn: Turns the model's axes into those of the view, x to the right, z up, (3, 3).
        apart: Whether the levels may be drawn apart.
        parts: Names of the levels, if its reader may hide them one by one.
        tests: Measured shapes; each look may show one of them.
    """
    drawn, shown = surface, looks(surface)
    most = _most(surface, shown)
    if len(surface.points) > most:
        drawn = coarsened(surface, most)
        shown = looks(drawn)
    low, high = drawn.points.min(axis=0), drawn.points.max(axis=0)
    middle, half = (low + high) / 2, float((high - low).max() / 2) or 1.0
    content = {
        "name": name,
        "unit_mm": 1e3 * half,
        "middle_mm": (1e3 * middle).tolist(),
        "corners": drawn.faces.shape[1],
        "n": len(drawn.points),
        "points": _shorts((drawn.points - middle) / half),
        "faces": _whole(drawn.faces, len(drawn.points)),
        "levels": _whole(drawn.level, 2) if drawn.level.any() else None,
        "groups": _whole(drawn.group, 2) if any(look.texts for look in shown) else None,
        "turn": (np.eye(3) if turn is None else turn).ravel().tolist(),
        "apart": apart and bool(drawn.level.any()),
        "parts": list(parts) if drawn.level.any() else [],
        "tests": [_arrows(a, middle, half, 1.0) for a in tests],
        "coarse": [] if drawn is surface else [len(drawn.faces), surface.whole],
        "looks": [_look(look, middle, half) for look in shown],
    }
    return json_markup(content)


def json_markup(content: Mapping[str, object]) -> Markup:
    """JSON to put into an element of a page, which nothing in its texts ends."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)


def _most(surface: Surface, looks: Sequence[SurfaceView]) -> int:
    """Vertices that a view may have for its bytes and faces."""
    per_face = len(surface.faces) / max(len(surface.points), 1)
    of_faces = surface.faces.shape[1] * (2 if len(surface.points) < 65536 else 4) * per_face
    numbers = sum(3 * (a.motion is not None) + (a.values is not None) for a in looks)
    each = 4 / 3 * (6 + 2 + 2 + 2 * numbers + of_faces)
    return int(min(_BYTES / each, _FACES / max(per_face, 1e-9)))


def _look(look: SurfaceView, middle: np.ndarray, half: float) -> dict:
    size = 1.0
    found: dict[str, object] = {"name": look.name, "note": look.note, "texts": list(look.texts)}
    if look.colours is not None:
        found["colours"] = look.colours.to_json()
    if look.motion is not None:
        size = float(np.linalg.norm(look.motion, axis=1).max(initial=0.0)) or 1.0
        found["motion"] = _shorts(look.motion / size)
    if look.way is not None:
        way = np.asarray(look.way, dtype=float) / np.linalg.norm(look.way)
        most = float(np.abs(look.motion @ way).max(initial=0.0)) or 1.0
        found["way"] = (way * size / most).tolist()
    if look.values is not None:
        found["values"] = _shorts(look.values)
    if look.shown is not None:
        found["shown"] = list(look.shown)
    found["arrows"] = [_arrows(a, middle, half, size) for a in look.arrows]
    if look.scales:
        found["scales"] = [float(f"{scale / size:.5g}") for scale in look.scales]
        found["mac"] = [round(float(value), 3) for value in look.mac]
        found["match"] = look.match
    return found


def _arrows(arrows: Arrows, middle: np.ndarray, half: float, size: float) -> dict:
    vectors = arrows.vectors / size
    return {
        "name": arrows.name,
        "colour": arrows.colour,
        "ball": arrows.ball,
        "points": np.round((arrows.points - middle) / half, 4).ravel().tolist(),
        "vectors": [float(f"{v:.4g}") for v in vectors.ravel().tolist()],
    }


def _shorts(values: np.ndarray) -> str:
    """Numbers from -1 to 1 as 16 bit, nan as none."""
    values = np.asarray(values, dtype=float)
    whole = np.where(np.isnan(values), _NONE, np.round(32767 * np.clip(values, -1, 1)))
    return _base64(whole.astype("<i2"))


def _whole(values: np.ndarray, most: int) -> str:
    """Indices as 16 bit, or as 32 where there are so many vertices."""
    return _base64(np.asarray(values).astype("<u2" if most < 65536 else "<u4"))


def _base64(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
