"""Backbones of joints as objects, and the parallel sliders that stand for them (Iwan's model).

A concave backbone tau is that of sliders spread over their yield strain phi with the density
rho = -tau'' (Iwan, J. Appl. Mech. 33, 1966; Segalman, J. Appl. Mech. 72, 2005). Over a cycle of
amplitude a they dissipate D = 4 int_0^a phi (a - phi) rho dphi, which Masing's rule puts as
8 int_0^a tau - 4 a tau(a).

`iwan_sliders` cuts the strains into bins and puts the sliders of each where Gauss's rule has its
nodes for the density rho: two sliders have its first four moments. So stiffness at rest, ultimate
strength, stress, slope and dissipation are exact at every edge between bins; amplitudes between two
edges see steps, which fall with the square of the number of sliders and average to nearly nothing
over the points of an interface, whose amplitudes differ.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from fenics_joints.errors import InputError, real, reals, wanted, whole
from fenics_joints.forms.backbones import (
    bilinear,
    bilinear_slope,
    richard_abbott,
    richard_abbott_slope,
    segalman,
    segalman_limits,
    segalman_slope,
)
from fenics_joints.joint_laws.law import check_names

#: Most sliders. Chosen: each is a part of the law's state at every point of an interface.
MOST_SLIDERS = 1000
#: Multiple of the reference strain at which a backbone has become its asymptote. Chosen: powers of
#: strain have fallen to round-off there.
_FAR = 1e8
#: Gauss's rule for integrals over a bin. Chosen: exact to 1e-12 for the backbones here.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
#: The same from 0 to 1; the rule above is from -1 to 1.
_NODES, _WEIGHTS = 0.5 * (_NODES + 1), 0.5 * _WEIGHTS


class Backbone(ABC):
    """Stress of the first loading; a subclass gives `value`, `slope` and `reference`.

    It has to be odd, concave for positive strain, and straight in the end.
    """

    @abstractmethod
    def value(self, strain: ArrayLike) -> np.ndarray:
        """Stress, Pa, at a strain of any shape."""

    @abstractmethod
    def slope(self, strain: ArrayLike) -> np.ndarray:
        """Slope, Pa, at a strain >= 0 of any shape; where it jumps, that before the jump."""

    @property
    @abstractmethod
    def reference(self) -> float:
        """A strain at the knee of the curve, > 0."""

    @property
    def limit(self) -> float:
        """Strain beyond which the backbone is straight; infinite if only in the end."""
        return np.inf

    @property
    def final_slope(self) -> float:
        """Slope at infinity, Pa."""
        return float(self.slope(_FAR * self.reference))

    @property
    def strength(self) -> float:
        """Stress, Pa, at which the last straight line meets the axis."""
        far = _FAR * self.reference
        return float(self.value(far)) - far * self.final_slope

    def secant(self, amplitude: ArrayLike) -> np.ndarray:
        """Secant stiffness, Pa, of a cycle of some amplitude > 0, of any shape."""
        return self.value(amplitude) / np.asarray(amplitude, dtype=float)

    def dissipation(self, amplitude: ArrayLike) -> np.ndarray:
        """Energy per cycle, J/m3, of Masing's loop of some amplitude >= 0, of any shape.

        4 int_0^a (a - 2 phi) (tau'(phi) - tau'(a)) dphi, which is 8 int_0^a tau - 4 a tau(a) by
        parts, and does not cancel at small amplitudes.
        """
        a = np.asarray(amplitude, dtype=float)
        top = np.minimum(a, self.limit)[..., None]
        # phi = top t^4 takes away what a power of phi has at zero.
        phi, weights = top * _NODES**4, 4 * top * _NODES**3 * _WEIGHTS
        excess = self.slope(phi) - self.slope(top)
        return 4 * np.sum((top - 2 * phi) * excess * weights, axis=-1) + self._macroslip(a)

    def _macroslip(self, a: np.ndarray) -> np.ndarray:
        """What a cycle dissipates beyond the limit, all sliders sliding."""
        beyond = np.maximum(a - self.limit, 0.0) if np.isfinite(self.limit) else np.zeros_like(a)
        return 4 * self.strength * beyond

    def change(self, **values: float) -> Backbone:
        """The same backbone with other values of some parameters.

        Raises:
            InputError: For an unknown parameter, or a value out of range.
        """
        known = {f.name: getattr(self, f.name) for f in fields(self)}
        check_names(type(self).__name__, values, known)
        return type(self)(**{**known, **values})


def _check(backbone: object, expected: str, holds: Callable[[], bool]) -> None:
    for f in fields(backbone):
        real(f"{type(backbone).__name__}.{f.name}", getattr(backbone, f.name))
    if not holds():
        raise InputError(f"{backbone}: expected {expected}.")


@dataclass(frozen=True)
class RichardAbbott(Backbone):
    """Richard and Abbott's curve (Iranzad and Ahmadian 2012, eq. 4).

    Attributes:
        E_e: Slope at rest, Pa.
        E_p: Slope at large strain, Pa.
        S_y: Yield stress, Pa.
        n: Sharpness of the knee.
    """

    E_e: float
    E_p: float
    S_y: float
    n: float

    def __post_init__(self):
        _check(
            self,
            "0 <= E_p < E_e, S_y > 0 and n > 0",
            lambda: 0 <= self.E_p < self.E_e and self.S_y > 0 and self.n > 0,
        )

    def value(self, strain):
        strain = np.asarray(strain, dtype=float)
        return richard_abbott(strain, self.E_e, self.E_p, self.S_y, self.n)

    def slope(self, strain):
        strain = np.asarray(strain, dtype=float)
        return richard_abbott_slope(strain, self.E_e, self.E_p, self.S_y, self.n)

    @property
    def reference(self) -> float:
        return self.S_y / (self.E_e - self.E_p)

    @property
    def final_slope(self) -> float:
        return self.E_p

    @property
    def strength(self) -> float:
        return self.S_y


@dataclass(frozen=True)
class Segalman(Backbone):
    """Segalman's four-parameter Iwan joint; force, N, by slip, m, or stress by strain.

    Attributes:
        F_S: Force of macroslip, N.
        K_T: Stiffness at rest, N/m.
        chi: Exponent of the density, > -1; of metals' joints below 0.
        beta: Stiffness lost at macroslip over that lost before, >= 0.
    """

    F_S: float
    K_T: float
    chi: float
    beta: float

    def __post_init__(self):
        _check(
            self,
            "F_S > 0, K_T > 0, chi > -1 and beta >= 0",
            lambda: self.F_S > 0 and self.K_T > 0 and self.chi > -1 and self.beta >= 0,
        )

    @property
    def _values(self):
        return self.F_S, self.K_T, self.chi, self.beta

    def value(self, strain):
        return segalman(np.asarray(strain, dtype=float), *self._values)

    def slope(self, strain):
        return segalman_slope(np.asarray(strain, dtype=float), *self._values)

    @property
    def reference(self) -> float:
        return segalman_limits(*self._values)[0]

    @property
    def limit(self) -> float:
        return self.reference

    @property
    def final_slope(self) -> float:
        return 0.0

    @property
    def strength(self) -> float:
        return self.F_S

    def dissipation(self, amplitude):
        """Energy per cycle, 4 R a^(chi + 3) / ((chi + 2) (chi + 3)) up to macroslip.

        Beyond it, 4 F_S for every unit of amplitude more.
        """
        a = np.asarray(amplitude, dtype=float)
        phi_max, R = segalman_limits(*self._values)
        top = np.minimum(a, phi_max)
        power = 4 * R * top ** (self.chi + 3) / ((self.chi + 2) * (self.chi + 3))
        return power + self._macroslip(a)


@dataclass(frozen=True)
class Bilinear(Backbone):
    """One slider beside a spring.

    Attributes:
        E_e: Slope at rest, Pa.
        S_y: Stress, Pa, at the knee.
        E_p: Slope beyond, Pa.
    """

    E_e: float
    S_y: float
    E_p: float = 0.0

    def __post_init__(self):
        _check(
            self, "0 <= E_p < E_e and S_y > 0", lambda: 0 <= self.E_p < self.E_e and self.S_y > 0
        )

    def value(self, strain):
        return bilinear(np.asarray(strain, dtype=float), self.E_e, self.E_p, self.S_y)

    def slope(self, strain):
        return bilinear_slope(np.asarray(strain, dtype=float), self.E_e, self.E_p, self.S_y)

    @property
    def reference(self) -> float:
        return self.S_y / self.E_e

    @property
    def limit(self) -> float:
        return self.reference

    @property
    def final_slope(self) -> float:
        return self.E_p

    @property
    def strength(self) -> float:
        return self.S_y * (1 - self.E_p / self.E_e)


# -- sliders ---------------------------------------------------------------------------------------


def slider_edges(
    backbone: Backbone, n: int, amplitudes: tuple[float, float] | None = None
) -> np.ndarray:
    """Edges of the bins that ``n`` sliders fill, from zero to the largest amplitude.

    Two or three sliders (n odd or even) lie below the least amplitude, one beyond the largest, and
    two in each bin between, whose widths are such that the greatest relative error of dissipation,
    which is as sqrt(rho a / D) times the width, is equal in all of them.

    Args:
        backbone: The curve.
        n: Number of sliders.
        amplitudes: Least and largest strain of interest; 0.1 and 2 times the reference strain by
            default, or up to the limit.

    Raises:
        InputError: For no slider, or amplitudes that are not 0 < least < largest.
    """
    check_backbone(backbone)
    n = whole("n_sliders", n, most=MOST_SLIDERS)
    low, high = 0.1 * backbone.reference, 2 * backbone.reference
    if amplitudes is not None:
        low, high = reals("amplitudes", amplitudes, (2,), above=0).tolist()
    high = min(high, backbone.limit)
    if not 0 < low < high < np.inf:
        raise InputError(
            f"amplitudes = {amplitudes}: expected 0 < least < largest, the least below "
            f"{backbone.limit:g}, where the backbone becomes straight."
        )
    if n < 5:
        return np.array([0.0, high][: max(n, 1)])
    grid = np.geomspace(low, high, 400)
    slope, loops = backbone.slope(grid), backbone.dissipation(grid)
    density = np.maximum(-np.gradient(slope, np.log(grid)), 0.0)  # rho a
    need = np.sqrt(density * grid**2 / np.maximum(loops, np.finfo(float).tiny))
    need += 0.05 * max(need.max(), 1e-9)  # no bin without end
    total = np.cumsum(0.5 * (need[1:] + need[:-1]))
    total = np.concatenate([[0.0], total / total[-1]])
    inner = PchipInterpolator(total, np.log(grid))(np.linspace(0, 1, (n - 3) // 2 + 1))
    inner = np.exp(inner)
    inner[-1] = high  # exactly, where it is the limit
    return np.concatenate([[0.0], inner])


def check_backbone(backbone: object) -> None:
    """Refuse what is no `Backbone`.

    Raises:
        InputError: If it is none.
    """
    if not isinstance(backbone, Backbone):
        raise wanted("backbone", backbone, "a Backbone, such as RichardAbbott")


def iwan_sliders(
    backbone: Backbone,
    n: int = 24,
    amplitudes: tuple[float, float] | None = None,
    *,
    edges: ArrayLike | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Sliders in parallel whose backbone is the given one, less its final slope.

    Args:
        backbone: The curve.
        n: Number of sliders. Those that would carry nothing are left out: a bilinear curve has one.
        amplitudes: As in `slider_edges`.
        edges: Bins instead of those of `slider_edges`, from 0.

    Returns:
        (stiffness, Pa, (E,); strength, Pa, (E,)), by rising yield strain. The stiffnesses sum to
        slope(0) - final_slope, the strengths to ``backbone.strength``.

    Raises:
        InputError: If the curve is not concave, and as `slider_edges`.
    """
    check_backbone(backbone)
    n = whole("n_sliders", n, most=MOST_SLIDERS)
    if edges is None:
        edges = slider_edges(backbone, n, amplitudes)
    else:
        edges = reals("edges", edges, (None,), least=0)
        if not len(edges) or edges[0] != 0 or not np.all(np.diff(edges) > 0):
            raise wanted("edges", edges, "numbers that rise from 0")
    counts = [1] * max(len(edges) - 1, 0)
    if n >= 3 and counts:
        counts = [2 + (n % 2 == 0)] + [2] * (len(edges) - 2)
    parts = [_bin(backbone, a, b, k) for a, b, k in zip(edges[:-1], edges[1:], counts, strict=True)]
    stiffness = np.concatenate([k for k, _ in parts]) if parts else np.empty(0)
    strength = np.concatenate([k * phi for k, phi in parts]) if parts else np.empty(0)
    last = float(backbone.slope(edges[-1])) - backbone.final_slope
    rest = backbone.strength - strength.sum()
    all_of_it = float(backbone.slope(0.0)) - backbone.final_slope
    if last > 1e-12 * all_of_it:
        stiffness, strength = np.append(stiffness, last), np.append(strength, rest)
    if np.any(stiffness <= 0) or np.any(strength <= 0):
        raise InputError(f"{backbone} is not concave: expected a slope that falls with strain.")
    return stiffness, strength


def _bin(backbone: Backbone, a: float, b: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss's rule for the density in a bin: stiffness and yield strain of ``count`` sliders."""
    # From zero, a power of the strain may lead the density: t^4 smooths it.
    power = 4 if a == 0 else 1
    phi = a + (b - a) * _NODES**power
    weights = (b - a) * power * _NODES ** (power - 1) * _WEIGHTS
    excess = backbone.slope(phi) - float(backbone.slope(b))
    first = float(backbone.slope(a)) - float(backbone.slope(b))
    scale = float(backbone.slope(0.0)) - backbone.final_slope
    if first <= 1e-12 * scale:
        if first < -1e-9 * scale:
            raise InputError(f"{backbone} is not concave: its slope rises from {a:g} to {b:g}.")
        return np.empty(0), np.empty(0)
    # Moments of x = (phi - middle) / half by parts, from the slope alone: -d(slope) = rho dphi.
    middle, half = 0.5 * (a + b), 0.5 * (b - a)
    x = (phi - middle) / half
    moments = [1.0] + [
        (-1.0) ** j + j * np.sum(x ** (j - 1) * excess * weights) / (half * first)
        for j in range(1, 2 * count)
    ]
    nodes, shares = _gauss(np.array(moments), count)
    return first * shares, middle + half * nodes


def _gauss(moments: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of Gauss's rule of a density with given moments; fewer where it is thin."""
    while count > 1:
        hankel = np.array([[moments[i + j] for j in range(count)] for i in range(count)])
        # A density at fewer points than that has no such rule.
        if np.linalg.eigvalsh(hankel)[0] > 1e-9:
            lower = np.linalg.solve(hankel, -moments[count : 2 * count])
            nodes = np.sort(np.roots([1.0, *lower[::-1]]).real)
            powers = np.vander(nodes, count, increasing=True).T
            return nodes, np.linalg.solve(powers, moments[:count])
        count -= 1
    return np.array([moments[1]]), np.array([1.0])
