"""Antiresonances of a case's test, and a reduced model that predicts them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import linear_sum_assignment

from fenics_joints.beams.structure import BeamStructure
from fenics_joints.case import Case
from fenics_joints.case.test import AntiresonanceTest
from fenics_joints.diagnosis.evidence.antiresonance import Antiresonance
from fenics_joints.diagnosis.evidence.evidence import BEYOND, UNSURE, Evidence
from fenics_joints.diagnosis.model.static import row_of
from fenics_joints.errors import InputError
from fenics_joints.measurements.data import TestData
from fenics_joints.reduction.adaptive import Points
from fenics_joints.reduction.grounded import Antiresonances, PointBasis
from fenics_joints.structure import Sensors, Structure

#: How far an antiresonance may be, in ln f, from the model's after what the test's frequencies say
#: of all modes thereabouts; beyond, it is another's. [decision: chosen]
_NEAR = 0.15


def antiresonances(
    case: Case,
    full: Structure | BeamStructure,
    data: TestData,
    evidence: Evidence,
    baseline: Mapping[str, float],
    given: Mapping[str, AntiresonanceTest],
    *,
    nominal_log_f: np.ndarray,
    everywhere: Sensors,
    samples: Points,
    travel: Mapping | None,
) -> tuple[Antiresonance, ...]:
    """What ``[test.antiresonances]`` says. Collective.

    Args:
        case: The case.
        full: Its nominal model.
        data: The test.
        evidence: The same, with the mesh's errors.
        baseline: The nominal model's parameter values.
        given: What was measured, by name; one at least.
        nominal_log_f: ln of the test's modes of the nominal model, (m,).
        everywhere: Places by whose motion modes are told.
        samples: Parameter values at which the reduced model is made, the baseline first.
        travel: See `fenics_joints.reduction.reduced.ReducedStructure`.

    Raises:
        InputError: If a point is beside the structure, a condition none of the test's, or a
            frequency near none of the model's.
    """
    sections, n_modes = list(given.values()), case.diagnose.n_modes
    names = tuple(f"test.antiresonances.{name}" for name in given)
    rows = [row_of(case, name, s.at, data) for name, s in zip(names, sections, strict=True)]
    at = Sensors([s.point for s in sections], [s.direction for s in sections], names)
    if full.is_meshed:
        full.rows(at.points, "antiresonance", names)  # whether they are on the mesh
    basis = PointBasis(full, at, everywhere, samples, n_modes, travel)
    found = []
    for i, (name, s) in enumerate(zip(names, sections, strict=True)):
        zeros, log_f = Antiresonances(basis, i, baseline, n_modes), np.log(sorted(s.frequencies))
        which = paired_zeros(
            log_f, zeros.log_f, np.log(data.frequencies_hz[rows[i]]), nominal_log_f
        )
        if which is None:
            there = ", ".join(f"{hz:.4g}" for hz in np.exp(zeros.log_f))
            raise InputError(
                f"{case.path}: {name}.frequencies: expected such as the model has at this point, "
                f"{there} Hz, each at most {_NEAR:.0%} off once all frequencies are moved as the "
                "test's are"
            )
        zeros.follow(which)
        mesh = _of_mesh(zeros.log_f[which], evidence, nominal_log_f)
        sd = np.sqrt(s.noise**2 + evidence.discrepancy**2 + (UNSURE * mesh / (1 + BEYOND)) ** 2)
        found += [
            Antiresonance(
                name=name,
                measured=float(np.exp(f)),
                sd=float(sd[k]),
                row=rows[i],
                zeros=zeros,
                index=k,
                mesh=float(mesh[k]),
            )
            for k, f in enumerate(log_f)
        ]
    return tuple(found)


def paired_zeros(
    measured: np.ndarray, zeros: np.ndarray, tested: np.ndarray, nominal: np.ndarray
) -> np.ndarray | None:
    """Which of a model's antiresonances the measured ones are, (k,); None where one is near none.

    A model that is stiffer as a whole has all of them higher, and its resonances too: so they are
    compared after those have been moved onto each other.

    Args:
        measured: ln f of the measured, ascending, (k,).
        zeros: ln f of the model's, ascending.
        tested: ln f of the test's resonances, (m,); nan where missing.
        nominal: ln f of these in the model, (m,).
    """
    there = np.flatnonzero(np.isfinite(tested))
    order = there[np.argsort(tested[there])]
    shift = np.interp(measured, tested[order], (nominal - tested)[order]) if len(order) else 0.0
    away = np.abs((measured + shift)[:, None] - zeros)
    if len(measured) > len(zeros):
        return None
    _, which = linear_sum_assignment(away)
    return which if np.all(away[range(len(measured)), which] <= _NEAR) else None


def _of_mesh(log_f: np.ndarray, evidence: Evidence, nominal: np.ndarray) -> np.ndarray:
    """How much too high the mesh makes antiresonances, as it does the test's modes thereabouts."""
    if evidence.mesh_shift is None:
        return np.zeros(len(log_f))
    order = np.argsort(nominal)
    return np.interp(log_f, nominal[order], evidence.mesh_shift[order])
