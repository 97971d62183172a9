"""Two overlapping rods with four bolts: matrices by hand, and virtual tests of them."""

from __future__ import annotations

import numpy as np

from fenics_joints.measurements import TestData
from fenics_joints.reduction import ArrayModel, ModalPrediction
from fenics_joints.reduction.affine import AffinePencil, RegionTerm, mass_term
from fenics_joints.structure import Parameter, Sensors
from fenics_joints.structure.laws import LAYER_LAWS

TORQUES = np.array([5.0, 10.0, 20.0])
MODES = tuple("abcde")
NOISE, SHAPE_NOISE, DISCREPANCY = 1e-3, 0.02, 2e-3
E, RHO, AREA, G, WIDTH, LAYER = 2e11, 7800.0, 1e-4, 8e10, 0.02, 5e-4
LAP, LENGTH = (0.4, 0.6), 1.0
BOLTS = ("b1", "b2", "b3", "b4")
BASELINE = {"bar.E": E, "bar.rho": RHO, "tip.mass": 0.0} | {
    f"{bolt}.{key}": value for bolt in BOLTS for key, value in (("E", E), ("G", G))
}
#: Place and rod (0, 1) of each sensor, as the case has them.
PLACES = ((0.0, 0), (0.15, 0), (0.3, 0), (0.55, 1), (0.7, 1), (0.85, 1), (1.0, 1))


class Rods:
    """Matrices of linear elements of size h; rod 0 from 0 to 0.6 m, rod 1 from 0.4 to 1 m."""

    def __init__(self, h: float):
        self.h, self.count = h, round(LAP[1] / h) + 1
        self.n = 2 * self.count

    def row(self, x: float, rod: int) -> np.ndarray:
        """Displacement at a place of a rod."""
        at = np.clip((x - rod * LAP[0]) / self.h, 0, self.count - 1)
        i = min(int(at), self.count - 2)
        row = np.zeros(self.n)
        row[rod * self.count + i : rod * self.count + i + 2] = 1 - (at - i), at - i
        return row

    def slope(self, x: float, rod: int) -> np.ndarray:
        low, high = np.clip([x - self.h / 2, x + self.h / 2], rod * LAP[0], LAP[1] + rod * LAP[0])
        return (self.row(high, rod) - self.row(low, rod)) / (high - low)

    def bars(self) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness at E = 1 and mass at rho = 1, midway between lumped and consistent."""
        K, M = np.zeros((self.n, self.n)), np.zeros((self.n, self.n))
        for rod in (0, 1):
            for i in range(rod * self.count, (rod + 1) * self.count - 1):
                two = np.ix_([i, i + 1], [i, i + 1])
                K[two] += AREA / self.h * np.array([[1, -1], [-1, 1]])
                M[two] += AREA * self.h / 12 * np.array([[5, 1], [1, 5]])
        return K, M

    def zone(self, k: int) -> np.ndarray:
        """Stiffness of a bolt's zone at G = 1: shear of the layer by what the rods move apart."""
        K, ends = np.zeros((self.n, self.n)), LAP[0] + 0.05 * np.array([k, k + 1])
        for x in np.arange(ends[0], ends[1] - 1e-9, self.h):
            apart = [self.row(at, 0) - self.row(at, 1) for at in (x, x + self.h)]
            for a, b, share in ((0, 0, 2), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
                K += WIDTH / LAYER * self.h / 6 * share * np.outer(apart[a], apart[b])
        return K

    def model(self, places=PLACES) -> ArrayModel:
        law, zero = LAYER_LAWS["uncoupled"], np.zeros((self.n, self.n))

        def region(name, K, M, properties, volume):
            terms = np.array([zero, K, zero, zero])
            return RegionTerm(name, law, {"stretch": 1.0, **properties}, terms, M, volume)

        K, M = self.bars()
        regions = [
            region("bar", K, M, {"E": 1.0, "G": "bar.E", "rho": "bar.rho"}, 1.2 * AREA * LENGTH)
        ]
        for k, bolt in enumerate(BOLTS):
            moduli = {"E": f"{bolt}.E", "G": f"{bolt}.G", "rho": 0.0}
            regions.append(region(bolt, self.zone(k), zero, moduli, 0.0))
        tip = self.row(0.0, 0)[None, None]
        parameters = {name: Parameter(name, value, log=False) for name, value in BASELINE.items()}
        pencil = AffinePencil(
            parameters, regions, [mass_term("tip", "tip.mass", 0.0, 1.0, np.zeros(1), tip)]
        )
        return ArrayModel(
            pencil,
            2500.0,
            np.array([self.row(*p) for p in places]),
            np.array([[self.slope(*p) for p in places]]),
        )


def sensors(places=PLACES) -> Sensors:
    return Sensors(np.array([[x, 0.0, 0.0] for x, _ in places]), [1.0, 0.0, 0.0])


def forward_of(model, reference=None) -> ModalPrediction:
    return ModalPrediction(model, sensors(), len(MODES), len(MODES) + 2, reference)


def measured(*, places=PLACES, gains=(), seed=1, **truth) -> TestData:
    """A virtual test.

    Args:
        places: Where the sensors are in truth.
        gains: (sensor, gain) of those that read wrongly.
        seed: Of the noise.
        truth: ``k`` and ``loose``, stiffness per area of the joint (at 20 N m, growing with the
            root of the torque) and of bolt 1, Pa/m; ``E``, a factor; ``mass``, kg.
    """
    forward = forward_of(Rods(0.025).model(places))
    rows = []
    for torque in TORQUES:
        values = dict(BASELINE)
        values["bar.E"] *= truth.get("E", 1.0)
        values["tip.mass"] = truth.get("mass", 0.0)
        for bolt in BOLTS:
            soft = LAYER / (truth["k"] * LAYER**2 * np.sqrt(torque / 20)) if "k" in truth else 0.0
            if bolt == "b1" and "loose" in truth:
                soft += 1 / (truth["loose"] * LAYER)
            values[f"{bolt}.G"] = 1 / (1 / G + soft)
        rows.append(forward(values)[0])
    shapes = forward.pairing(values).shapes
    for i, gain in gains:
        shapes[i] *= gain
    rng = np.random.default_rng(seed)
    log_f = np.array(rows) + NOISE * rng.standard_normal((len(TORQUES), len(MODES)))
    size = np.sqrt(np.mean(shapes**2, axis=0))
    shapes = shapes + SHAPE_NOISE * size * rng.standard_normal(shapes.shape)
    return TestData(
        TORQUES,
        np.exp(log_f),
        MODES,
        "torque",
        "N·m",
        noise=NOISE,
        sensors=sensors(),
        shapes=shapes,
        shape_noise=SHAPE_NOISE,
    )
