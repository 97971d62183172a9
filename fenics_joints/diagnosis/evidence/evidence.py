"""The test for the inference: one vector of data, and the covariance of its errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fenics_joints.diagnosis.effects.damping import has_ratios
from fenics_joints.diagnosis.effects.joint import EXPONENT
from fenics_joints.diagnosis.evidence.entries import (
    DAMPING,
    FREQUENCY,
    MASS,
    SHAPE,
    UNKNOWN,
    Entries,
    Neighbours,
    mode_mixing,
)
from fenics_joints.diagnosis.evidence.observations import Observation
from fenics_joints.diagnosis.evidence.scales import (
    BETWEEN,
    ERRORS,
    MEMORY,
    WITH_FUNCTIONS,
    Scales,
    correlation,
)
from fenics_joints.diagnosis.evidence.signatures import Signatures
from fenics_joints.measurements.data import TestData

#: Error of a mesh that remains beyond one degree more, relative to what that degree finds: expected
#: value, and standard deviations common to all modes and of each mode. At an edge with the exponent
#: lambda the error in energy falls with the degree p as p^(-4 lambda) (Babuska and Suri, SIAM J.
#: Numer. Anal. 24, 1987): from degree 2 to 3, a share of 0.25 of what was found is left for
#: lambda = 1, 0.8 for 1/2, and next to nothing without edges. And where joints give way there is
#: between 0.4 and 1.1 times the error of the nominal model. [decision: Babuska and Suri 1987;
#: three structures, docs/diagnosis-method.md]
BEYOND, _COMMON, _OWN = 0.3, 0.3, 0.2
#: The share that stays uncertain in all.
UNSURE = float(np.hypot(_COMMON, _OWN))
#: Change of a shape by the mesh, relative to it, up to which shapes are corrected for it: beyond,
#: modes mix. [decision: chosen]
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
    """The test for the inference.

    The data stand in one vector: ln of the frequencies, (n, m) row by row; then ln of the damping
    ratios likewise, if used; then the shapes, (n_s, m) row by row, if measured; then ln of single
    numbers, such as masses that were weighed.

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
        """For each row the row whose tightening it shares, (n,): itself, or after a known change
        the row of the nearest condition without one."""
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
        row whose frequencies ascend, if those of other rows do not: whoever made such a table has
        tracked the modes as well."""
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
        """The same test with the error of the model's mesh, by which its frequencies are too high,
        added to the data.

        The error of a mesh hardly depends on the parameters: of three bolted structures it stayed
        between 0.4 and 1.1 times that of the nominal model while joints went to 1e-5 of their
        stiffness (docs/diagnosis-method.md). So data are corrected for it and for the part that is
        expected beyond one degree more, whose uncertainty is mostly common to the modes.

        Args:
            error: Relative error of each mode's frequency at the nominal model against the same
                mesh one degree higher, (m,); nan where it is not known, which leaves the largest of
                the others as uncertain.
            shape: Change of each shape by the mesh, relative to it, (m,); all of it stays as
                uncertainty, since a shape that turns goes on turning with finer meshes.
            change: The same change at the sensors, (n_s, m), by which shapes are corrected that the
                mesh changes little.
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

    def patch_columns(self) -> list[np.ndarray]:
        """Change of all entries by the stiffness of each patch, by its mass, and, where there are
        several torques, by a stiffness of joints that grows with them, each (N, P)."""
        e, signs, shapes = self.entries, self.signatures, self.signatures.shapes
        stiff, mass = (
            e.filled(signs.log_f[..., key], None if shapes is None else shapes[..., key])
            for key in (0, 1)
        )
        for i, scalar in zip(np.flatnonzero(e.of_scalars), self.scalars, strict=True):
            stiff[i], mass[i] = scalar.by_patch(signs)
        if not signs.of_joint.any() or len(self.conditions) < 2 or self.drifts:
            return [stiff, mass]
        if min(self.conditions) <= 0:
            return [stiff, mass]
        x = np.log(self.conditions)
        tightened = EXPONENT[0] * (x - x.mean())[e.row, None] * stiff * signs.of_joint
        return [stiff, mass, tightened]

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
#: Correlation length of a model's error in a shape, over the largest distance between sensors.
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


#: Standard deviations of the trend of ln f of each mode with the logarithm of the condition by an
#: unknown cause (5 % per factor e), and of the bend of that trend (2 %). [decision: chosen]
_TREND, _BEND = 0.05, 0.02
#: Factor by which an unknown cause may change ln damping more than ln f. [decision: chosen]
_UNKNOWN_DAMPING = 10.0
#: Change of a shape by an unknown cause, relative to its root mean square. [decision: chosen]
_UNKNOWN_SHAPE = 0.2
#: Share of the variance of a model's error that is independent in a row after a known change: the
#: rest is the same before and after, and cancels in the shift. [decision: chosen]
_OF_CHANGE = 0.0025
#: Share of the variance of a model's error in a shape that is independent at each sensor.
#: [decision: chosen]
_LOCAL = 0.5
#: Power of the correlation between sensors that makes that share almost independent: it reaches a
#: tenth as far, so that sensors at one place share it. [decision: chosen]
_NARROW = 100


class Covariance:
    """The covariance of a test's entries, and its factors, with any scales.

    Args:
        test: The test; which kind of scales it has counts, and not their values.
    """

    def __init__(self, test: Evidence):
        self.test = test
        self._steady: dict[bool, np.ndarray] = {}
        self._lowers: dict[tuple[Scales | None, bool], np.ndarray] = {}

    def full(self, scales: Scales | None, unknown: bool = False) -> np.ndarray:
        """Covariance of all entries, measured or not, held out or not, (N, N).

        Args:
            scales: Of the test's kind; None takes what is stated.
            unknown: Whether an unknown cause may be at work.
        """
        if unknown not in self._steady:
            self._steady[unknown] = self._stated(unknown)
        total = self._steady[unknown].copy()
        values = () if scales is None else scales.values
        for scale, part in zip(values, self._parts, strict=False):
            total += scale**2 * part
        return total

    def lower(self, scales: Scales | None, unknown: bool = False) -> np.ndarray:
        """Cholesky factor of that of the fitted entries, (k, k), remembered; see `full`."""
        key = scales, unknown
        if key not in self._lowers:
            used = self.test.fitted
            self._lowers[key] = np.linalg.cholesky(self.full(scales, unknown)[np.ix_(used, used)])
        return self._lowers[key]

    @cached_property
    def _same_mode(self) -> np.ndarray:
        mode = self.test.entries.mode
        return mode[:, None] == mode[None, :]

    @cached_property
    def _parts(self) -> tuple[np.ndarray, ...]:
        """The covariances that `scales` multiply: of ln f and ln damping between levels, or of the
        stated errors of ln f, of functions and of shapes."""
        if self._with_functions:
            return self._of_frequencies, self._of_scalars, self._of_shapes
        if not self.test.drifts:
            return self._of_frequencies, self._of_shapes
        e = self.test.entries
        drift = correlation(self.test.conditions)[np.ix_(e.row, e.row)] * self._same_mode
        return tuple(drift * _blocks(e.kind, *scales) for scales in ((1.0, 0.0), (0.0, 1.0)))

    @property
    def _with_functions(self) -> bool:
        return self.test.scales is not None and self.test.scales.kind == WITH_FUNCTIONS

    @cached_property
    def _of_scalars(self) -> np.ndarray:
        """Covariance of the common errors of single numbers."""
        scalars, own = self.test.scalars, self.test.entries.of_scalars
        names = dict.fromkeys(name for scalar in scalars for name in scalar.common)
        common = np.zeros((len(own), len(names)))
        for i, scalar in zip(np.flatnonzero(own), scalars, strict=True):
            common[i] = [scalar.common.get(name, 0.0) for name in names]
        return common @ common.T

    @cached_property
    def _by_mode(self) -> np.ndarray:
        """Standard deviation of the model's error in ln f, as it is stated or found, (m,)."""
        by_mode = np.broadcast_to(self.test.discrepancy, self.test.shape[1])
        if self.test.mesh_error is None:
            return by_mode
        return np.maximum(by_mode, self._of_all_modes(self.test.mesh_error))

    @cached_property
    def _slowly(self) -> np.ndarray:
        """Correlation of a model's error between entries of one mode."""
        row = self.test.entries.row
        slow = _slow(self.test.conditions, self.test.changing)[np.ix_(row, row)] * self._same_mode
        if any(self.test.known):
            changed = np.array([bool(known) for known in self.test.known])[row]
            slow = slow + np.diag(np.where(changed, _OF_CHANGE, 0.0))
        return slow

    @cached_property
    def _of_frequencies(self) -> np.ndarray:
        e = self.test.entries
        return self._slowly * _blocks(e.kind, self._by_mode[e.mode])

    @cached_property
    def _locally(self) -> np.ndarray:
        """Correlation of a model's error between components of one shape."""
        e = self.test.entries
        near = self.test.near if self.test.near is not None else np.eye(len(self.test.shapes))
        local = _LOCAL * near**_NARROW + (1 - _LOCAL) * near
        if self.test.along is not None:
            local = local * self.test.along
        is_shape = e.kind == SHAPE
        pairs = local[np.ix_(e.sensor, e.sensor)] * self._same_mode
        return pairs * np.outer(is_shape, is_shape)

    @cached_property
    def _of_shapes(self) -> np.ndarray:
        if self.test.shapes is None:
            return np.zeros(2 * (len(self.test.entries.kind),))
        least = np.broadcast_to(self.test.shape_error, self.test.shape[1])
        if self.test.mesh_shape is not None:
            least = np.maximum(least, self._of_all_modes(self.test.mesh_shape))
        return self._locally * least[self.test.entries.mode] ** 2

    def _stated(self, unknown: bool) -> np.ndarray:
        """All that `scales` do not multiply."""
        e = self.test.entries
        total = self._slowly * _blocks(e.kind, 0.0, self.test.damping_scatter)
        if self.test.scales is None or self.test.drifts:
            total = total + self._of_frequencies + self._of_shapes
        if self.test.mesh_common is not None:
            common = self.test.mesh_common
            common = np.pad(common, (0, self.test.shape[1] - len(common)))
            of_mesh = np.where(e.kind == FREQUENCY, common[e.mode], 0.0)
            total = total + np.outer(of_mesh, of_mesh)
        if self.test.joint_f is not None:
            of_joints = e.filled(self.test.joint_f, self.test.joint_shapes)
            total = total + of_joints @ of_joints.T
        if unknown:
            wide = _wide(self.test.conditions)[np.ix_(e.row, e.row)] * self._same_mode
            total = total + wide * _blocks(e.kind, 1.0, _UNKNOWN_DAMPING)
        if self.test.shapes is not None:
            # By the stated error, whatever the scales: errors of shapes of close modes say little
            # of the errors of frequencies.
            turns = self._mode_mixing(self._by_mode)
            total = total + turns @ turns.T
            if unknown:
                total = total + self._locally * _UNKNOWN_SHAPE**2
        if not self._with_functions:
            total = total + self._of_scalars
        if unknown and self.test.scalars:
            wide = np.zeros(len(e.kind))
            wide[e.of_scalars] = [scalar.unknown for scalar in self.test.scalars]
            total = total + np.diag(wide**2)
        return total + np.diag(self.test.noise_sd() ** 2)

    def _of_all_modes(self, error: np.ndarray) -> np.ndarray:
        """Errors by mesh, and the largest of modes that were added since, (m,)."""
        return np.pad(error, (0, self.test.shape[1] - len(error)), mode="maximum")

    def _mode_mixing(self, by_mode: np.ndarray) -> np.ndarray:
        """Errors of shapes by modes nearby, (N, k), see `mode_mixing`."""
        test, columns = self.test, []
        e = test.entries
        found = mode_mixing(
            test.log_f[test.shape_row], test.shapes, by_mode, test.shape_error, test.neighbours
        )
        for parts in found:
            column = np.zeros(len(e.kind))
            for mode, shape in parts:
                own = (e.kind == SHAPE) & (e.mode == mode)
                column[own] = shape[e.sensor[own]]
            columns.append(column)
        return np.array(columns).reshape(-1, len(e.kind)).T


def _blocks(
    kind: np.ndarray, of_frequency: float | np.ndarray, of_damping: float = 0.0
) -> np.ndarray:
    """Products of the scales of frequencies and damping, zero between different kinds."""
    scale = np.where(kind == FREQUENCY, of_frequency, np.where(kind == DAMPING, of_damping, 0.0))
    return np.outer(scale, scale) * (kind[:, None] == kind[None, :])


def _log(conditions: np.ndarray) -> np.ndarray:
    """Centred logarithm of the conditions; zero when they are not all positive."""
    if len(conditions) < 2 or np.any(conditions <= 0):
        return np.zeros(len(conditions))
    return np.log(conditions) - np.mean(np.log(conditions))


def _slow(conditions: np.ndarray, changing: float) -> np.ndarray:
    """Correlation of a model's error between conditions, (n, n)."""
    x = _log(conditions)
    return (1 - changing) + changing * np.exp(-0.5 * ((x[:, None] - x[None, :]) / MEMORY) ** 2)


def _wide(conditions: np.ndarray) -> np.ndarray:
    x = _log(conditions)
    return UNKNOWN**2 + _TREND**2 * np.outer(x, x) + _BEND**2 * np.outer(x**2, x**2)
