"""Where on a structure something attached would explain a test best.

All over the structure, and then ever nearer about the best places, a mass, a spring and a mass on a
spring are put on: a small eigenproblem each in the modes of the nominal model, linear in the
nuisances. Effects are then solved for near these places alone.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from fenics_joints.diagnosis.evidence.localised_unknown import PointScan
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.diagnosis.zones.sites import COUNT, Sites, about_point
from fenics_joints.errors import InputError
from fenics_joints.modal.modes import solve_modes
from fenics_joints.reduction.matched import places_all_over

#: Places that are looked at, and the nominal model's modes in which. [numerical: time]
_PLACES, _MODES = 240, 30
#: Which of the next places is beside one, not through a plate's thickness. [numerical: chosen]
_NEXT = 4
#: Masses over the structure's, and springs over what bears all of it at the test's lowest mode;
#: frequencies of masses on springs, over the middle of the test's modes. [numerical: chosen]
_SHARES, _OWN = np.geomspace(2e-3, 0.2, 5), (0.7, 1.0, 1.4)
#: About a site: vertices that are looked at, and factors on the best of these. [numerical: chosen]
_VERTICES, _FACTORS = 150, np.geomspace(1 / 3, 3, 9)
#: Steps from there. [numerical: definition]
_STEPS = np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
#: The least step and the distance of two sites, over that of places; and the gain, in nats, that
#: is worth a step. [numerical: chosen]
_FINEST, _APART, _GAIN = 0.05, 2.0, 0.5


def found_sites(model) -> Sites:
    """The sites of a prepared model where the test speaks for something attached. Collective.

    Args:
        model: A `Prepared`, reduced.
    """
    full, test, forward = model.full, model.evidence, model.forward
    h = model.hypothesis(())
    z = np.zeros(len(h.priors))
    try:
        predicted, slopes = ManyPredictions(h, forward, test, model.baseline).at(z)
    except InputError:
        return model.sites  # it lacks a mode that the test has
    modes = solve_modes(forward.model, model.baseline, n_modes=min(_MODES, forward.model.n_dofs))
    seen = None if test.shapes is None else forward.model.sensor_rows @ modes.shapes
    plain = SimpleNamespace(hypothesis=h, predicted=predicted, jacobian=slopes, z=z)
    scan = PointScan(plain, test, modes.eigenvalues, forward.paired(modes), seen)
    total, log_f = full.total_mass(model.baseline), np.ma.masked_invalid(test.log_f)
    bears = total * (2 * np.pi * np.exp(log_f.min())) ** 2
    kinds = [lambda phi, s: scan.attached(phi, s * total)]
    kinds += [
        lambda phi, s, way=way: scan.attached(phi, 0.0, bears * np.outer(s, way))
        for way in np.eye(full.gdim)
    ]
    kinds += [
        lambda phi, s, f=f: scan.attached(phi, s * total, hz=f * np.exp(log_f.mean())) for f in _OWN
    ]

    def moves(points: np.ndarray) -> np.ndarray:
        return model.surrogate.moves(points) @ modes.shapes

    points = np.unique(places_all_over(full, _PLACES).points, axis=0)
    away = np.linalg.norm(points[:, None] - points, axis=2)
    apart = float(np.median(np.sort(away, axis=1)[:, _NEXT]))
    scores = np.array([[kind(phi, _SHARES) for kind in kinds] for phi in moves(points)])
    chosen: list[int] = []
    for i in np.argsort(-scores.max(axis=(1, 2)), kind="stable"):
        if len(chosen) < COUNT and all(away[i, j] > _APART * apart for j in chosen):
            chosen.append(int(i))
    middles = []
    for i in chosen:
        kind, share = np.unravel_index(np.argmax(scores[i]), scores[i].shape)
        sizes, at, step, best = _SHARES[share] * _FACTORS, points[i], 0.5 * apart, -np.inf
        away = np.linalg.norm(model.sites.vertices - at, axis=1)
        near = model.sites.vertices[np.argsort(away, kind="stable")[:_VERTICES]]
        motion = moves(near)
        while step > _FINEST * apart:
            tried, found = (at + step * _STEPS).clip(near.min(axis=0), near.max(axis=0)), []
            for x in tried:
                which, weights = about_point(near, x)
                phi = np.tensordot(weights[0], motion[which], 1)
                found.append(float(kinds[kind](phi, sizes).max()))
            if max(found) > best + _GAIN:
                at, best = tried[int(np.argmax(found))], max(found)
            else:
                step *= 0.5
        middles.append(at)
    share = len(middles) / len(points)
    return replace(model.sites, points=np.array(middles), reach=apart, share=share)
