"""The test as the inference sees it: one vector of data, and how well a model should meet it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fenics_joints.diagnosis.effects.damping import has_ratios
from fenics_joints.diagnosis.evidence.covariance import (
    DAMPING,
    FREQUENCY,
    MASS,
    SHAPE,
    Covariance,
    Entries,
    Neighbours,
)
from fenics_joints.diagnosis.evidence.observations import Observation
from fenics_joints.diagnosis.evidence.scales import BETWEEN, ERRORS, Scales
from fenics_joints.diagnosis.evidence.signatures import Signatures
from fenics_joints.measurements.data import TestData

#: Of a mesh's error as one degree more finds it: what is left beyond that degree, expected, and its
#: standard deviations, common to all modes and of each one's own. At an edge with the exponent
#: lambda the error in energy falls with the degree p as p^(-4 lambda) (Babuska and Suri, SIAM J.
#: Numer. Anal. 24, 1987): from degree 2 to 3, a share of 0.25 of what was found is left for
#: lambda = 1, 0.8 for 1/2, and next to nothing without edges. And where joints give way there is
#: between 0.4 and 1.1 times the error of the nominal model (docs/diagnosis.md). [decision: Babuska
#: and Suri 1987; three structures, docs/diagnosis.md]
BEYOND, _COMMON, _OWN = 0.3, 0.3, 0.2
#: The share that stays uncertain in all.
UNSURE = float(np.hypot(_COMMON, _OWN))
#: Change of a shape by the mesh, relative to it, up to which it is taken off: beyond, modes turn.
#: [decision: chosen]
_LITTLE = 0.3

#: Share of the variance of a model's error that changes with the condition. [decision: chosen]
_CHANGING = 0.5
#: Error of any model in a shape, and noise of a measured one, where a case states none.
#: [decision: defaults of `diagnose.shape_discrepancy` and `test.shape_noise`]
SHAPE_ERROR = 0.05
#: Relative standard deviation of a damping ratio in a usual test. [decision: chosen]
DAMPING_NOISE = 0.1


@dataclass(frozen=True, repr=False)
class Evidence:
    """The test as the inference sees it.

    The data stand in one vector: ln of the frequencies, (n, m) row by row; behind it ln of the
    damping ratios likewise, if used; behind it the shapes, (n_s, m) row by row, if measured;
    behind these ln of single numbers, as masses that were weighed.

    Attributes:
        conditions: Torque or level of each row, shape (n,).
        log_f: ln of the measured frequencies, shape (n, m), raised by ``mesh_shift``; nan where
            missing.
        log_sd: Their standard deviations from noise and resolution, shape (n, m).
        discrepancy: Standard deviation, of ln f, of the error that every model of this structure
            has. Part of its variance is the same at all conditions and part changes slowly with
            the condition, so that more of them do not average it out.
        used: Which entries are fitted, shape (n, m); the others are held out.
        changing: The share of the discrepancy's variance that changes with the condition: half for
            torques, nothing for levels, which drift.
        scales: Standard deviations that the data infer (`fenics_joints.diagnosis.evidence.scales`):
            of a test by level those of what changes between levels and no law explains; of others
            how much of the stated `discrepancy` and `shape_error` there is. Those expected, unless
            `at` put in others; None takes what is stated.
        log_damping: ln of the measured damping ratios, shape (n, m), nan where missing; None if
            they are not used.
        damping_sd: Their standard deviation from noise.
        damping_scatter: That of what no model explains.
        shapes: Measured shapes, shape (n_s, m), each of root mean square 1 over the sensors that
            measured it, less what `on_mesh` takes off; nan where not measured; None if there are
            none.
        shape_row: The condition that they were measured at.
        shape_sd: Standard deviation of their components from noise.
        shape_error: That of any model's shapes: half its variance local, as at a joint that bends
            otherwise than its layer does, half correlated between near sensors. Close modes turn
            into one another besides, by what the frequencies' error turns them.
        near: That correlation, shape (n_s, n_s).
        along: Cosines between the sensors' directions, shape (n_s, n_s): errors across each other
            are unrelated; None if all measure the same way.
        scalars: Single numbers that were measured besides, as masses from a scale.
        mesh_error: Standard deviation of ln f, (m,), of what is left of the error of the model's
            mesh, which is taken for the discrepancy where it is larger; None where it was not
            measured.
        mesh_common: What is common to all modes of it, at one standard deviation, (m,); None
            likewise.
        mesh_shift: How much higher, in ln f, the mesh makes each mode, (m,); None likewise.
        mesh_shape: What the mesh does to each shape, (m,), which is taken for the `shape_error`
            where it is larger; None likewise.
        neighbours: The nominal model's modes, those that the test lacks among them; None where they
            are not known.
        known: See `TestData`: rows after a known change, the last ones.
        signatures: What a change in each patch of the structure would do; None where an unknown
            cause has no place.
        joint_f: What a model errs by having joints bonded, k changes of ln f at one standard
            deviation each, (m, k), the same at all conditions; None for no such error.
        joint_shapes: Likewise of shapes, (n_s, m, k); None without.
    """

    conditions: np.ndarray
    log_f: np.ndarray
    log_sd: np.ndarray
    discrepancy: float
    used: np.ndarray = field(default=None)
    changing: float = _CHANGING
    scales: Scales | None = None
    log_damping: np.ndarray | None = None
    damping_sd: float = DAMPING_NOISE
    damping_scatter: float = 0.0
    shapes: np.ndarray | None = None
    shape_row: int = 0
    shape_sd: float = SHAPE_ERROR
    shape_error: float = SHAPE_ERROR
    near: np.ndarray | None = None
    along: np.ndarray | None = None
    scalars: tuple[Observation, ...] = ()
    mesh_error: np.ndarray | None = None
    mesh_common: np.ndarray | None = None
    mesh_shift: np.ndarray | None = None
    mesh_shape: np.ndarray | None = None
    neighbours: Neighbours | None = None
    known: tuple[Mapping[str, float], ...] = ()
    signatures: Signatures | None = None
    joint_f: np.ndarray | None = None
    joint_shapes: np.ndarray | None = None

    def __repr__(self) -> str:
        return f"Evidence({self.fitted.sum()} data at {len(self.conditions)} conditions)"

    def __post_init__(self):
        if self.used is None:
            object.__setattr__(self, "used", np.isfinite(self.log_f))

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of conditions and modes, (n, m)."""
        return self.log_f.shape

    @cached_property
    def as_row(self) -> tuple[int, ...]:
        """For each row the row whose tightening it shares, (n,): its own, or after a known change
        that of the nearest condition without one."""
        own = [i for i in range(len(self.conditions)) if not (self.known and self.known[i])]
        near = [int(np.argmin(np.abs(self.conditions[own] - c))) for c in self.conditions]
        return tuple(i if i in own else own[near[i]] for i in range(len(self.conditions)))

    @cached_property
    def tracking(self) -> tuple[tuple[int, int | None], ...]:
        """Order in which the rows' modes are identified, each with the row from which they are
        tracked: None for the first row, and for all rows if each is identified independently."""
        n, first, own = len(self.conditions), self._first, self._ascending
        if first is None:
            return tuple((row, None) for row in range(n))
        at = own.index(first)
        pairs: list[tuple[int, int | None]] = [(first, None)]
        pairs += [(own[i], own[i + 1]) for i in range(at - 1, -1, -1)]
        pairs += [(own[i], own[i - 1]) for i in range(at + 1, len(own))]
        pairs += [(i, self.as_row[i]) for i in range(n) if i not in own]
        return tuple(pairs)

    @property
    def _first(self) -> int | None:
        """The row at which tracking starts: that of the measured shapes. Without shapes, the last
        row whose frequencies ascend, if those of other rows do not: whoever made the table has
        tracked the modes too."""
        if self.shapes is not None:
            return self.shape_row
        f = [row[np.isfinite(row)] for row in self.log_f]
        sorted_ = [i for i in self._ascending if np.all(np.diff(f[i]) > 0)]
        return sorted_[-1] if 0 < len(sorted_) < len(self._ascending) else None

    @cached_property
    def _ascending(self) -> list[int]:
        """Rows without a known change, by their condition."""
        rows = np.argsort(self.conditions, kind="stable").tolist()
        return [i for i in rows if not (self.known and self.known[i])]

    @cached_property
    def as_it_is(self) -> Evidence:
        """The test without the rows after a known change."""
        if not any(self.known):
            return self
        own = np.array([not known for known in self.known])
        cut = {"conditions": self.conditions[own], "known": ()}
        for key in ("log_f", "log_sd", "used", "log_damping"):
            value = getattr(self, key)
            cut[key] = None if value is None else value[own]
        return replace(self, **cut)

    @cached_property
    def driven(self) -> tuple[int, ...] | None:
        """The modes that were measured at several conditions; None if all or none were."""
        there = np.sum(np.isfinite(self.log_f), axis=0)
        if self.log_damping is not None:
            there = np.maximum(there, np.sum(np.isfinite(self.log_damping), axis=0))
        several = np.flatnonzero(there > 1)
        return tuple(several.tolist()) if 0 < len(several) < len(there) else None

    @cached_property
    def entries(self) -> Entries:
        """What each entry of `data` is."""
        n, m = self.shape
        row, mode = np.indices((n, m)).reshape(2, -1)
        blocks = [(FREQUENCY, row, mode, -1)]
        if self.log_damping is not None:
            blocks.append((DAMPING, row, mode, -1))
        if self.shapes is not None:
            sensor, mode = np.indices(self.shapes.shape).reshape(2, -1)
            blocks.append((SHAPE, self.shape_row, mode, sensor))
        # Each a (1, k) block: an empty one has no place in what is stacked.
        flat = [np.array(np.broadcast_arrays(*block)).reshape(4, -1) for block in blocks]
        single = [(scalar.kind, scalar.row or 0, 0, -1) for scalar in self.scalars]
        flat.append(np.array(single, dtype=int).reshape(-1, 4).T)
        return Entries(*np.hstack(flat).astype(int))

    @cached_property
    def data(self) -> np.ndarray:
        """Everything measured, shape (N,); nan where missing."""
        parts = [self.log_f, self.log_damping, self.shapes]
        single = np.log([scalar.measured for scalar in self.scalars])
        return np.concatenate([*(part.ravel() for part in parts if part is not None), single])

    @cached_property
    def fitted(self) -> np.ndarray:
        """Which of `data` are fitted; what is held out is so with its damping and its shape."""
        e = self.entries
        return (self.used[e.row, e.mode] | e.of_scalars) & np.isfinite(self.data)

    def without(self, held_out: np.ndarray) -> Evidence:
        """The same test with some entries held out, mask of shape (n, m)."""
        return replace(self, used=self.used & ~held_out)

    def on_mesh(
        self, error: np.ndarray, shape: np.ndarray | None = None, change: np.ndarray | None = None
    ) -> Evidence:
        """The same test as a model whose mesh makes frequencies too high should give it.

        The error of a mesh hardly depends on the parameters: of three bolted structures it stayed
        between 0.4 and 1.1 times that of the nominal model while joints went to 1e-5 of their
        stiffness (docs/diagnosis.md). So it is taken off, with what is expected to be left beyond
        one degree more; what is not known of that is mostly common to the modes.

        Args:
            error: Relative error of each mode's frequency at the nominal model against the same
                mesh one degree higher, (m,); nan where it is not known, which leaves the largest of
                the others as uncertain.
            shape: What the mesh does to each shape, relative to it, (m,); of it all stays as
                uncertain, since a shape that turns goes on turning with finer meshes.
            change: What the measured shapes have of it, (n_s, m), which is taken off of those that
                the mesh changes little.
        """
        known = np.isfinite(error)
        error = np.where(known, error, 0.0)
        found, most = np.log1p(error), float(np.abs(error).max(initial=0.0))
        shift, shapes = (1 + BEYOND) * found, self.shapes
        if shapes is not None and change is not None:
            shapes = shapes - np.where(known & (shape < _LITTLE), change, 0.0)
        return replace(
            self,
            log_f=self.log_f + shift,
            shapes=shapes,
            mesh_shift=shift,
            mesh_common=_COMMON * found,
            mesh_error=np.where(known, _OWN * np.abs(error), most),
            mesh_shape=None if shape is None else np.where(known, shape, 1.0),
        )

    def off_mesh(self, log_f: np.ndarray) -> np.ndarray:
        """ln f of the model, (..., m), without the error of its mesh."""
        return log_f if self.mesh_shift is None else log_f - self.mesh_shift

    @property
    def drifts(self) -> bool:
        """Whether what changes between levels is inferred."""
        return self.scales is not None and self.scales.kind == BETWEEN

    def at(self, scales: Scales | None) -> Evidence:
        """The same test with these standard deviations; as it is for None."""
        if scales in (None, self.scales):
            return self
        found = replace(self, scales=scales)
        same = self.scales is not None and scales.kind == self.scales.kind
        for name in ("entries", "data", "fitted", *(["_errors"] if same else [])):
            found.__dict__[name] = getattr(self, name)
        return found

    @cached_property
    def _errors(self) -> Covariance:
        return Covariance(self)

    def lower(self, unknown: bool = False) -> np.ndarray:
        """Cholesky factor of `covariance`, (k, k), remembered."""
        return self._errors.lower(self.scales, unknown)

    def covariance(self, unknown: bool = False) -> np.ndarray:
        """Covariance of the fitted entries, shape (k, k)."""
        used = self.fitted
        return self.full_covariance(unknown)[np.ix_(used, used)]

    def full_covariance(self, unknown: bool = False) -> np.ndarray:
        """Covariance of all entries, measured or not, held out or not, shape (N, N)."""
        return self._errors.full(self.scales, unknown)

    def noise_sd(self) -> np.ndarray:
        """Standard deviation of each entry from the instrument alone, (N,)."""
        e = self.entries
        sd = self.log_sd[e.row, e.mode]
        sd = np.choose(np.minimum(e.kind, MASS), [sd, self.damping_sd, self.shape_sd, 0.0])
        sd[e.of_scalars] = [scalar.sd for scalar in self.scalars]
        return sd


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
    scalars: tuple[Observation, ...] = (),
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
