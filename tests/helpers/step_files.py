"""STEP files for tests, drawn with gmsh, in millimetres."""

from __future__ import annotations

from collections.abc import Iterable

FLANGE_BOLTS = [(45, 15), (45, 45), (85, 15), (85, 45)]


def bores(occ, centres: Iterable[tuple[float, float]], low: float, high: float, radius: float):
    """Cylinders along z."""
    return [(3, occ.addCylinder(x, y, low, 0, 0, high - low, radius)) for x, y in centres]


def flanges(gap=0.0, upper_radius=6.0, shift=0.0, upper=(20, 0, 80, 60), bolts=FLANGE_BOLTS):
    """A bed of 100 x 60 x 20 mm and a column's foot of 80 x 60 x 15 mm on it, with bolt holes."""

    def draw(occ):
        x, y, dx, dy = upper
        bed, foot = occ.addBox(0, 0, 0, 100, 60, 20), occ.addBox(x, y, 20 + gap, dx, dy, 15)
        occ.cut([(3, bed)], bores(occ, bolts, -1, 21, 6))
        if upper_radius:
            moved = [(x + shift, y) for x, y in bolts]
            occ.cut([(3, foot)], bores(occ, moved, 19, 40, upper_radius))

    return draw


def bracket(occ):
    """An L-shaped bracket on a plate with two bolts, one hole wider, all turned in space."""
    plate = occ.addBox(0, 0, 0, 120, 80, 12)
    sides = occ.addBox(30, 10, 12, 60, 60, 10), occ.addBox(30, 10, 22, 60, 10, 50)
    angle, _ = occ.fuse([(3, sides[0])], [(3, sides[1])])
    bolts = [(45, 45), (75, 50)]
    occ.cut([(3, plate)], bores(occ, bolts, -1, 13, 4.5))
    occ.cut(angle, bores(occ, bolts, 11, 23, 5.5))
    occ.rotate(occ.getEntities(3), 0, 0, 0, 1, 2, -0.5, 0.7)


def spigot(occ):
    """A round flange with a collar that centres another, three bolts around it."""
    lower, collar = occ.addCylinder(0, 0, 0, 0, 0, 20, 50), occ.addCylinder(0, 0, 20, 0, 0, 5, 20)
    lower, _ = occ.fuse([(3, lower)], [(3, collar)])
    upper, hollow = occ.addCylinder(0, 0, 20, 0, 0, 15, 50), occ.addCylinder(0, 0, 20, 0, 0, 15, 20)
    upper, _ = occ.cut([(3, upper)], [(3, hollow)])
    bolts = [(36, 0), (-18, 31), (-18, -31)]
    occ.cut(lower, bores(occ, bolts, -1, 21, 5))
    occ.cut(upper, bores(occ, bolts, 19, 36, 5))


def dumbbell_halves(occ):
    """Heads of 160 x 120 x 30 mm on necks of 120 x 63 x 20, neck on neck at z = 0, two holes."""
    for sign in (-1, 1):
        z = (-20, -50) if sign < 0 else (0, 20)
        neck = occ.addBox(-60, -31.5, z[0], 120, 63, 20)
        head = occ.addBox(-80, -60, z[1], 160, 120, 30)
        half, _ = occ.fuse([(3, neck)], [(3, head)])
        low, high = (-51, 1) if sign < 0 else (-1, 51)
        occ.cut(half, bores(occ, [(-35, 0), (35, 0)], low, high, 8.75))


def joined(occ, at, gap=0.0, radii=(4.5, 4.5)):
    """Two plates of 100 x 40 x 10 mm, one upon the other, with holes of two radii."""
    for z, radius in zip((0, 10 + gap), radii, strict=True):
        plate = occ.addBox(0, 0, z, 100, 40, 10)
        occ.cut([(3, plate)], bores(occ, at, z - 1, z + 11, radius))


def screws(occ, at, low, high, nut=False):
    """M8 with a round head of 13 x 8 mm below a face; with a nut, 6.5 mm, above another."""
    for x, y in at:
        head = occ.addCylinder(x, y, low - 8, 0, 0, 8, 6.5)
        shank = occ.addCylinder(x, y, low, 0, 0, high - low + 8 * nut, 4)
        occ.fuse([(3, head)], [(3, shank)])
        if nut:
            ring = occ.addCylinder(x, y, high, 0, 0, 6.5, 6.5)
            occ.cut([(3, ring)], bores(occ, [(x, y)], high - 1, high + 8, 4))
