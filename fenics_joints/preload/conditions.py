"""Contact and Coulomb friction as equations between jumps and nodal forces, and their tangent.

At each pair, with opening g, slip s since the last step, normal force N (of the bodies on one
another, positive when they press) and tangential force q, all nodal:

    N - max(0, N - c g) = 0,        q - proj(q - c s, mu max(0, N - c g)) = 0

where proj shortens a vector to a length. These hold exactly when g >= 0, N >= 0, g N = 0, and
|q| <= mu N with slip against q only at the limit (Alart and Curnier, Comput. Methods Appl. Mech.
Eng. 92, 1991; Hueeber, Stadler and Wohlmuth, SIAM J. Sci. Comput. 30, 2008); c > 0 only scales. N
and q are what the elastic bodies need there: rows of K x - f. In the second equation c is a tenth:
a larger one throws pairs from slip one way to slip the other way, between which Newton can cycle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Names of states, in arrays of a status for each pair.
OPEN, SLIP, STICK = 0, 1, 2

#: Factor of c in the equation of friction. Measured: 0.01 to 0.1 takes the fewest iterations; the
#: solution does not depend on it.
_SHEAR = 0.1


@dataclass(frozen=True)
class ContactPairs:
    """The pairs that this rank owns, all contacts together.

    Attributes:
        numbers: Local numbers in x of opening and slips, (n, gdim).
        gap: Initial gap, m, (n,).
        friction: Coulomb's coefficient, (n,); infinity for no sliding.
        scale: Positive stiffness c, N/m, (n,), near that of the bodies at the pair.
        slip: Jump in the tangents at which the last step ended, m, (n, gdim - 1).
        penalty: Stiffness k A, N/m, (n,), of penalty contact with regularised Coulomb friction, an
            approximation, softer than steel: N = k A max(0, -g), q = -proj(k A s, mu N). None for
            exact contact.
    """

    numbers: np.ndarray
    gap: np.ndarray
    friction: np.ndarray
    scale: np.ndarray
    slip: np.ndarray
    penalty: np.ndarray | None = None

    @property
    def springs(self) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness, N/m, (n,), that scales openings, and that which scales slips."""
        if self.penalty is not None:
            return self.penalty, self.penalty
        return self.scale, _SHEAR * self.scale

    @property
    def share(self) -> float:
        """Share of the present forces in the trial forces: none where springs alone make them."""
        return 1.0 if self.penalty is None else 0.0

    def split(self, array: np.ndarray):
        """Normal part, (n,), and tangential part, (n, gdim - 1), of an array over x."""
        values = array[self.numbers]
        return values[:, 0], values[:, 1:]

    def trial(self, x: np.ndarray, r: np.ndarray):
        """Normal and tangential trial forces, N: N - c g, and q - c s."""
        (w, v), (N, q), (c, shear) = self.split(x), self.split(r), self.springs
        return (
            self.share * N - c * (w + self.gap),
            self.share * q - shear[:, None] * (v - self.slip),
        )

    def equations(self, x: np.ndarray, r: np.ndarray, closed=False, opened=False) -> np.ndarray:
        """The left-hand sides, (n, gdim), N.

        Args:
            x: Displacements and jumps.
            r: Rows of K x - f.
            closed: Whether all pairs count as closed, and stuck where there is friction: the start.
            opened: Pairs that count as open, as a mask, (n,).
        """
        normal, tangent = self.trial(x, r)
        normal[opened] = 0.0
        N, q = self.split(r)
        pressed = normal if closed else np.maximum(normal, 0.0)
        return np.column_stack([N - pressed, q - _shorten(tangent, self._limit(normal, closed))])

    def _limit(self, normal: np.ndarray, closed: bool = False) -> np.ndarray:
        if closed:
            return np.where(self.friction > 0, np.inf, 0.0)
        pressed = np.maximum(normal, 0.0)
        with np.errstate(invalid="ignore"):
            return np.where(pressed > 0, self.friction * pressed, 0.0)

    def tangent(self, x: np.ndarray, r: np.ndarray, slack=0.0, closed=False, opened=False):
        """Blocks A, B, each (n, gdim, gdim): the equations' derivative is A dr + B dx.

        Args:
            x: Displacements and jumps.
            r: Rows of K x - f.
            slack: Share of Coulomb's limit by which a pair may be above it and count as stuck.
            closed: See `equations`.
            opened: Likewise.
        """
        normal, tangent = self.trial(x, r)
        normal[opened] = 0.0
        n, gdim = self.numbers.shape
        slope = np.zeros((n, gdim, gdim))
        slope[:, 0, 0] = closed | (normal > 0)
        limit, size = self._limit(normal, closed), np.linalg.norm(tangent, axis=1)
        eye = np.eye(gdim - 1)
        stick = (size <= (1 + slack) * limit) & (limit > 0)
        slope[stick, 1:, 1:] = eye
        slip = ~stick & (limit > 0)
        unit = tangent[slip] / size[slip, None]
        ratio = (limit[slip] / size[slip])[:, None, None]
        slope[slip, 1:, 1:] = ratio * (eye - unit[:, :, None] * unit[:, None, :])
        slope[slip, 1:, 0] = self.friction[slip, None] * unit  # d limit = mu d normal
        c, shear = self.springs
        springs = np.column_stack([c, *[shear] * (gdim - 1)])
        return np.eye(gdim) - self.share * slope, slope * springs[:, None, :]

    def friction_slope(self, x: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Derivative of the equations by each pair's own friction coefficient, (n, gdim)."""
        normal, tangent = self.trial(x, r)
        limit, size = self._limit(normal), np.linalg.norm(tangent, axis=1)
        slip = (size > limit) & (limit > 0)
        slope = np.zeros(self.numbers.shape)
        slope[slip, 1:] = -normal[slip, None] * tangent[slip] / size[slip, None]
        return slope

    def status(self, x: np.ndarray, r: np.ndarray) -> np.ndarray:
        """OPEN, SLIP or STICK of each pair; without friction a closed pair slips."""
        normal, tangent = self.trial(x, r)
        limit = self._limit(normal)
        stick = (np.linalg.norm(tangent, axis=1) <= limit) & (limit > 0)
        return np.where(normal > 0, np.where(stick, STICK, SLIP), OPEN)

    def complementarity(self, x: np.ndarray, r: np.ndarray) -> np.ndarray:
        """|min(g c, N)| of each pair, N: zero in exact contact."""
        w, _ = self.split(x)
        N, _ = self.split(r)
        return np.abs(np.minimum(self.scale * (w + self.gap), N))


def _shorten(vectors: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Vectors, (n, k), shortened to a length of at most ``limit``, (n,)."""
    size = np.linalg.norm(vectors, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.where(size > limit, limit / np.where(size > 0, size, 1.0), 1.0)
    return vectors * factor[:, None]
