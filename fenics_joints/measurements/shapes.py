"""Mode shapes and their scale from residues at responses and references."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fenics_joints.errors import InputError
from fenics_joints.measurements.frfs import MeasuredFRFs

#: Share of a shape's square below which a sensor stands still in a mode and links no sets.
_STILL = 1e-6
#: Most names in a message.
_NAMED = 6


class Links:
    """Links that put all sensors of a test on one scale.

    Functions that share a sensor or a force, directly or by others, are one set, in which residues
    A_ij = a_i b_j say all ratios. By reciprocity a_i of one set and b_j of another (or the same, at
    a driving point) are of one degree of freedom, which says the product of both sets' scales.
    Ratios of scales follow over an even number of such products, a scale itself over an odd one.

    Attributes:
        rows: Set of each response, shape (n_responses,).
        columns: Set of each reference, shape (n_references,).
    """

    def __init__(self, data: MeasuredFRFs):
        self.there = data.measured
        n, k = self.there.shape
        i, j = np.nonzero(self.there)
        graph = coo_array((np.ones(len(i)), (i, n + j)), shape=(n + k, n + k))
        sets = connected_components(graph, directed=False)[1]
        self.measured = self.there.any(axis=1)
        self.rows, self.columns = sets[:n], sets[n:]
        self.pairs: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
        for i, j, sign in data.same_dofs():
            a, b = int(self.rows[i]), int(self.columns[j])
            if self.measured[i] and self.there[:, j].any():
                self.pairs.setdefault((a, b), []).append((i, j, sign))
        own = [a for a, b in self.pairs if a == b]
        self.root = own[0] if own else int(self.columns[0])
        #: (set, sign), the pair of sets that leads to it, and from where.
        self.chain = [((self.root, 1), None, None)]
        for at, _, _ in self.chain:
            reached = {one for one, _, _ in self.chain}
            for a, b in self.pairs:
                for here, there in ((a, b), (b, a)):
                    to = (there, -at[1])
                    if here == at[0] and to not in reached:
                        reached.add(to)
                        self.chain.append((to, (a, b), at))
        self._check(data)

    def _check(self, data: MeasuredFRFs) -> None:
        reached = {one for (one, sign), _, _ in self.chain if sign > 0}
        lost = [one for one in np.unique(self.columns) if one not in reached]
        if lost:
            texts = [
                f"responses {_listed(data.response_names, self.rows == one)} by references "
                f"{_listed(data.reference_names, self.columns == one)}"
                for one in (self.root, *lost)
            ]
            raise InputError(
                f"the functions form sets without a common sensor or force: {'; '.join(texts)}; "
                "the scale and sign between their shapes are unknown. Expected a sensor, or a "
                "place of the force, that is in both sets, or functions of one set only"
            )

    @property
    def scaled(self) -> bool:
        """Whether driving points give the modal mass."""
        return (self.root, -1) in {one for one, _, _ in self.chain}

    def shapes(
        self, a: np.ndarray, b: np.ndarray, poles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Shapes of unit length, as real as they can be turned, and factors to unit modal mass.

        A residue is A_ij = phi_i phi_j / (2 i w_d) of a mass-normalised real mode (Ewins, Modal
        Testing, 2nd ed., 2.5).

        Args:
            a: At responses, shape (..., n_responses, m).
            b: At references, shape (..., n_references, m).
            poles: rad/s, shape (m,).

        Returns:
            The shapes, (..., n_responses, m), nan where nothing was measured or the mode stands
            still at every link; and the factors, (..., m), nan where they are unknown.
        """
        values = {(self.root, 1): np.ones(a.shape[:-2] + a.shape[-1:], dtype=complex)}
        for to, pair, start in self.chain[1:]:
            values[to] = self._product(a, b, poles, pair) / values[start]
        shape = np.full(a.shape, np.nan, dtype=complex)
        for one in np.unique(self.columns):
            at = (self.rows == one) & self.measured
            shape[..., at, :] = values[one, 1][..., None, :] * a[..., at, :]
        square = np.nansum(shape**2, axis=-2)
        # Turning a shape by an angle turns its sum of squares by twice the angle.
        turn = np.exp(0.5j * np.angle(square))
        turn = turn * np.sqrt(np.nansum(np.abs(shape) ** 2, axis=-2))
        mass = values.get((self.root, -1), np.full(turn.shape, np.nan)) * turn**2
        with np.errstate(invalid="ignore"):
            factor = np.sqrt(np.where(mass.real > 0, mass.real, np.nan))
        return shape / turn[..., None, :], factor

    def _product(self, a, b, poles, pair) -> np.ndarray:
        """Product of the scales of two sets, from all places that link them."""
        above, below = 0.0, 0.0
        for i, j, sign in self.pairs[pair]:
            above = above + sign * b[..., j, :] * a[..., i, :].conj()
            below = below + np.abs(a[..., i, :]) ** 2
        own = (np.abs(a[..., self.rows == pair[0], :]) ** 2).sum(axis=-2)
        found = 2j * poles.imag * above / np.where(below > 0, below, 1.0)
        return np.where(below > _STILL * own, found, np.nan)


def _listed(names, chosen: np.ndarray) -> str:
    found = [name for name, here in zip(names, chosen, strict=True) if here]
    more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    return ", ".join(found[:_NAMED]) + more
