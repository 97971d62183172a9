"""Small models in as few terms as their free parameters allow.

K(p) and M(p) are sums of matrices times scalars (`fenics_joints.reduction.affine`), as many as all
laws of all parts and joints ask for. While most parameters stand still, most of these scalars do
too, and others are in proportion, as the moduli of one layer: their matrices are summed up once.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fenics_joints.errors import InputError, items, wanted
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.terms import MassTerm, RegionTerm
from fenics_joints.structure.changes import CHANGES
from fenics_joints.structure.laws import Law
from fenics_joints.structure.values import number

#: Values at which scalars are compared: what is in proportion at all of them, to round-off, is so
#: everywhere, for they are rational functions and the values are any. How far they are apart.
_SAMPLES, _ROUND_OFF, _APART = 6, 1e-11, 0.15


def freeze(
    model: ArrayModel, free: Sequence[str], given: Mapping[str, float] | None = None
) -> ArrayModel:
    """The same model with fewer parameters, in fewer terms.

    Args:
        model: A model of plain arrays.
        free: Names of the parameters that it keeps, one at least.
        given: Values of parameters that differ from their nominal value; those that stand still
            have them, and they are the nominal ones of the others.

    Raises:
        InputError: If a name is unknown.
    """
    if not isinstance(model, ArrayModel):
        raise wanted("model", model, "an ArrayModel")
    values, free = model.values(given), list(items("free", free, str, "names of parameters"))
    if not free or len(set(free)) < len(free) or not set(free) <= set(values):
        raise InputError(f"free = {free}: expected some of: {', '.join(values)}.")
    pencil, n = model.pencil, model.n_dofs
    K, M = (np.array(A) for A in pencil.fixed or (np.zeros((n, n)), np.zeros((n, n))))
    mass, regions = pencil.fixed_mass, []
    for region in pencil.regions:
        kept, stiff, heavy, weight = _split(region, free, values)
        K, M, mass = K + stiff, M + heavy, mass + weight
        regions += [] if kept is None else [kept]
    springs = [s for s in pencil.springs if s.stiffness in free]
    for spring in pencil.springs:
        if spring.stiffness not in free:
            k = number(spring.stiffness, values) * spring.share
            K += k * np.outer(spring.row, spring.row)
    moving = [
        replace(m, mass=m.mass if m.mass in free else number(m.mass, values))
        for m in pencil.masses
        if m.travel in free
    ]
    still = [m for m in pencil.masses if m.travel not in free]
    for point in (m for m in still if m.mass not in free):
        at = point(number(point.travel, values))[0]
        share = number(point.mass, values) * point.share
        M, mass = M + share * at.T @ at, mass + share
    names = dict.fromkeys(m.mass for m in still if m.mass in free)
    together = [_together([m for m in still if m.mass == name], values) for name in names]
    parameters = {name: replace(model.parameters[name], value=values[name]) for name in free}
    return replace(
        model, pencil=AffinePencil(parameters, regions, springs, [*together, *moving], (K, M), mass)
    )


def trimmed(model: ArrayModel, still: Collection[str], given: Mapping[str, float]) -> ArrayModel:
    """The same model, with the same parameters, in which some stand still: what of a part or joint
    they alone set apart is one term.

    Args:
        model: A model of plain arrays.
        still: Names of the parameters that keep their values.
        given: These values, and any of the others.
    """
    values, pencil = model.values(given), model.pencil
    free, changes = frozenset(pencil.parameters) - set(still), {law.name for law in CHANGES}
    n = model.n_dofs
    K, M = (np.array(A) for A in pencil.fixed or (np.zeros((n, n)), np.zeros((n, n))))
    mass, regions = pencil.fixed_mass, []
    for region in pencil.regions:
        if region.law.name in changes or not set(region.properties.values()) & set(still):
            regions.append(region)
            continue
        kept, stiff, heavy, weight = _split(region, free, values)
        K, M, mass = K + stiff, M + heavy, mass + weight
        regions += [] if kept is None else [kept]
    return replace(model, pencil=replace(pencil, regions=regions, fixed=(K, M), fixed_mass=mass))


def _split(region: RegionTerm, free, values):
    """What is left of a part or joint, or None; and its stiffness, inertia and mass, kg, that stand
    still."""
    law, q = region.law, region.values(values)
    named = {key: name for key, name in region.properties.items() if name in free}
    properties = {k: v if v in free else q.get(k, v) for k, v in region.properties.items()}
    if named and law in CHANGES:  # nought at most values of a place, and not at all
        return replace(region, properties=properties), 0.0, 0.0, 0.0
    chance = np.random.default_rng(1)
    factors = {name: 1 + _APART * chance.random(_SAMPLES) for name in dict.fromkeys(named.values())}
    # Of what is nought all multiples are: it is compared at others.
    many = {k: np.full(_SAMPLES, v) for k, v in q.items()}
    many |= {k: (q[k] or 1.0) * factors[name] for k, name in named.items()}
    theta = np.reshape(law.stiffness_terms(many), (-1, _SAMPLES)).astype(float)
    rho = np.broadcast_to(law.inertia_term(many), _SAMPLES)
    stands = np.all(np.abs(np.diff(theta)) <= _ROUND_OFF * np.abs(theta[:, 1:]), axis=1)
    now = np.asarray(law.stiffness_terms(q), dtype=float)
    stiff = np.tensordot(np.where(stands, now, 0.0), region.stiffness, axes=1)
    heavy, weight, volume, inertia = 0.0, 0.0, region.volume, region.inertia
    if np.ptp(rho) <= _ROUND_OFF * np.max(np.abs(rho)):
        here = float(law.inertia_term(q))
        heavy, weight = here * inertia, here * volume
        volume, inertia = 0.0, np.zeros_like(inertia)
    groups = _groups(theta, np.flatnonzero(~stands))
    if not groups and not volume and not np.any(inertia):
        return None, stiff, heavy, weight
    sums = [np.tensordot(shares, region.stiffness[rows], axes=1) for rows, shares in groups]
    own = replace(
        region,
        law=of_few(law, [rows[0] for rows, _ in groups]),
        inertia=inertia,
        volume=volume,
        stiffness=np.reshape(sums, (len(sums), *inertia.shape)),
        properties=properties,
    )
    return own, stiff, heavy, weight


def _groups(theta: np.ndarray, rows: Sequence[int]) -> list[tuple[list[int], list[float]]]:
    """Rows in proportion, and each one's multiple of the first."""
    found: list[tuple[list[int], list[float]]] = []
    for i in rows:
        for members, shares in found:
            first = theta[members[0]]
            share = (theta[i] @ first) / (first @ first)
            if np.all(np.abs(theta[i] - share * first) <= _ROUND_OFF * np.abs(theta[i])):
                members.append(int(i))
                shares.append(float(share))
                break
        else:
            found.append(([int(i)], [1.0]))
    return found


def of_few(law: Law, rows: Sequence[int]) -> Law:
    """The law with some of its scalars, by index."""
    name = f"{law.name} {list(rows)}"  # by which a pencil remembers them
    return replace(law, name=name, stiffness_terms=partial(_some, law, list(rows)))


def _some(law: Law, rows: list[int], q) -> np.ndarray:
    return np.asarray(law.stiffness_terms(q))[rows]


def _together(masses: Sequence[MassTerm], values) -> MassTerm:
    """Masses that stay and are one parameter's, as one: their displacements below each other."""
    share = sum(m.share for m in masses)
    rows = [np.sqrt(m.share / share) * m(number(m.travel, values))[0] for m in masses]
    return MassTerm(masses[0].name, masses[0].mass, 0.0, share, np.zeros(1), np.vstack(rows)[None])
