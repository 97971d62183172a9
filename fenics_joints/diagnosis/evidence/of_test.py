"""The evidence of a measured test."""

from __future__ import annotations

import numpy as np

from fenics_joints.diagnosis.effects.damping import has_ratios
from fenics_joints.diagnosis.evidence.evidence import SHAPE_ERROR, Evidence
from fenics_joints.diagnosis.evidence.scalars import Scalar
from fenics_joints.diagnosis.evidence.scales import BETWEEN, ERRORS
from fenics_joints.measurements.data import TestData

#: Standard deviation of ln f of a test that states neither noise nor resolution. [decision: chosen]
_UNSTATED = 1e-3
#: Distance between sensors, as a share of the largest, over which its error in a shape does.
#: [decision: chosen]
_REACH = 0.3
#: Scatter of ln damping that no model explains: a joint dissipates otherwise after each tightening.
#: [decision: chosen]
_DAMPING_SCATTER = 0.3


def evidence_of(
    data: TestData,
    discrepancy: float,
    shape_error: float = SHAPE_ERROR,
    scalars: tuple[Scalar, ...] = (),
    mesh_error: np.ndarray | None = None,
) -> Evidence:
    """A test as the inference sees it.

    Damping is used if it was measured at several levels, or if the test says how good it is.

    Args:
        data: The test.
        discrepancy: See `Evidence`.
        shape_error: Likewise.
        scalars: Likewise.
        mesh_error: Likewise.
    """
    log_f = np.log(data.frequencies_hz)
    kwargs = {"scalars": scalars, "mesh_error": mesh_error}
    kwargs["scales"] = ERRORS.expected(1 if data.shapes is None else 2)
    if data.by_level:
        kwargs["changing"] = 0.0
        if len(data) > 1:
            kwargs["scales"] = BETWEEN.expected(2 if has_ratios(data) else 1)
    if has_ratios(data):
        ratios = data.damping
        kwargs["log_damping"] = np.log(ratios, where=ratios > 0, out=np.full(ratios.shape, np.nan))
        kwargs["damping_sd"] = data.damping_sd
        kwargs["damping_scatter"] = 0.0 if data.by_level else _DAMPING_SCATTER
    if data.shapes is not None:
        kwargs |= {
            "shapes": _scaled(data.shapes),
            "shape_row": data.shape_row,
            "shape_sd": data.shape_noise,
            "shape_error": shape_error,
            "near": _near(data.sensors.points),
            "along": data.sensors.directions @ data.sensors.directions.T,
        }
    kwargs["known"] = data.known
    sd = data.log_sd()
    return Evidence(data.conditions, log_f, np.where(sd > 0, sd, _UNSTATED), discrepancy, **kwargs)


def _scaled(shapes: np.ndarray) -> np.ndarray:
    """Shapes of root mean square 1 over the sensors that measured them."""
    return shapes / np.sqrt(np.nanmean(shapes**2, axis=0))


def _near(points: np.ndarray) -> np.ndarray:
    """Correlation of a model's error between sensors, by their distance, (n_s, n_s)."""
    distance = np.linalg.norm(points[:, None] - points[None, :], axis=2)
    reach = _REACH * max(float(distance.max()), 1e-12)
    return np.exp(-0.5 * (distance / reach) ** 2)
