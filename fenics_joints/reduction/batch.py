"""Smaller models for a few parameters: frozen, narrowed, and asked at many values together.

A reduced model serves all hypotheses and all priors, so that its basis is several times as large
as one of them needs, and most of its parameters stand still. `freeze` sums up once what those
make; `narrow` projects on the modes that the free ones can make in their ranges, and says how far
its frequencies are off. A sampler asks for the frequencies at ten thousands of parameter values: a
`LeanForward` has them for many values at a time, from a basis of twenty to forty vectors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import qmc

from fenics_joints.errors import (
    ConvergenceError,
    InputError,
    items,
    mapping,
    real,
    reals,
    wanted,
    whole,
)
from fenics_joints.measurements.gap import mac
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.adaptive import Points, improve
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.forward import Forward
from fenics_joints.structure.values import number

__all__ = [
    "LeanForward", "Narrow", "arrays_of", "frequency_error", "freeze", "lean_forward", "modes_at",
    "narrow", "pod",
]  # fmt: skip

#: Sampled points for the basis, and rounds of checks that may add to it.
_SAMPLES, _ROUNDS = 16, 4
#: Directions whose share of a mode is below this times the root of the tolerance are left out: the
#: error of a frequency is of the order of the square. Each further round takes a tenth of it.
_SHARE = 0.1
#: As in `fenics_joints.modal.modes`: the shift below zero, and what counts as rigid.
_SHIFT_SHARE, _RIGID_SHARE = 0.002, 0.01
#: Round-off of a rigid mode's eigenvalue is to be below its limit by this much, at the nominal
#: values: stiffnesses may grow from there.
_MARGIN = 1e3


def freeze(
    model: ArrayModel, free: Sequence[str], given: Mapping[str, float] | None = None
) -> ArrayModel:
    """The same model with fewer parameters.

    Args:
        model: A model of plain arrays.
        free: Names of the parameters that it keeps.
        given: Values of parameters that differ from their nominal value; they become the nominal
            values of those that it keeps.

    Raises:
        InputError: If a name is unknown, or no part, joint or support depends on ``free``.
    """
    if not isinstance(model, ArrayModel):
        raise wanted("model", model, "an ArrayModel")
    values, free = model.values(given), list(items("free", free, str, "names of parameters"))
    unknown = [name for name in free if name not in values]
    if unknown or not free or len(set(free)) < len(free):
        raise InputError(f"free = {free}: expected some of: {', '.join(values)}.")

    def put(item, keys):
        """A spring or mass with numbers in place of the frozen names."""
        named = {key: getattr(item, key) for key in keys}
        frozen = {k: number(v, values) for k, v in named.items() if v not in free}
        return replace(item, **frozen)

    pencil, regions, rest = model.pencil, [], []
    for region in model.regions:
        q = {k: v if v in free else number(v, values) for k, v in region.properties.items()}
        kept = any(isinstance(v, str) for v in q.values())
        (regions if kept else rest).append(replace(region, properties=q))
    if not regions:
        raise InputError(f"free = {free}: expected the parameter of a part, joint or support.")
    springs = [put(s, ("stiffness",)) for s in pencil.springs]
    masses = [put(m, ("mass", "travel")) for m in pencil.masses]
    moving = [m for m in masses if isinstance(m.mass, str) or isinstance(m.travel, str)]
    held = [m for m in masses if not any(m is other for other in moving)]
    zero = np.zeros((model.n_dofs, model.n_dofs))
    still = AffinePencil({}, rest, [s for s in springs if not isinstance(s.stiffness, str)], held,
                         pencil.fixed or (zero, zero), pencil.fixed_mass)  # fmt: skip
    parameters = {name: replace(model.parameters[name], value=values[name]) for name in free}
    return replace(
        model,
        pencil=AffinePencil(
            parameters, regions, [s for s in springs if isinstance(s.stiffness, str)], moving,
            still.matrices({}), float(still.total_mass({})),
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class Narrow:
    """A small model and how good it is.

    Attributes:
        model: The model; its parameters are the free ones.
        error: Largest relative error of a frequency at ``n_checked`` random points that the basis
            was not made from.
        n_checked: Number of those points.
    """

    model: ArrayModel
    error: float
    n_checked: int


def narrow(
    model: ArrayModel,
    ranges: Mapping[str, tuple[float, float]],
    n_modes: int,
    *,
    given: Mapping[str, float] | None = None,
    tolerance: float = 1e-5,
    n_check: int = 50,
    seed: int = 0,
) -> Narrow:
    """A model on the modes that parameters in their ranges can make.

    Args:
        model: A model of plain arrays.
        ranges: Least and largest value of each free parameter, positive; sampled evenly in the
            logarithm.
        n_modes: Modes that must be right, rigid-body modes included.
        given: Values of the other parameters that differ from their nominal value.
        tolerance: Largest accepted relative error of a frequency.
        n_check: Random points at which it is checked.
        seed: Of the random points.

    Raises:
        InputError: For a bad range or name.
        ConvergenceError: If the error stays above the tolerance.
    """
    whole("n_modes", n_modes)
    whole("n_check", n_check, most=10**6)
    whole("seed", seed, 0)
    real("tolerance", tolerance, above=0.0, most=0.1)
    if not ranges:
        raise wanted("ranges", ranges, "the range of a parameter at least")
    for name, pair in mapping("ranges", ranges, "ranges by name").items():
        low, high = reals(f"range of {name}", pair, (2,), above=0.0)
        if not low < high:
            raise InputError(f"range of {name} = {(low, high)}: expected 0 < low < high.")
    middle = {name: float(np.sqrt(low * high)) for name, (low, high) in ranges.items()}
    given = mapping("given", given, "values by the parameters' names")
    frozen = freeze(model, list(ranges), given | middle)
    low, high = np.log(list(ranges.values())).T

    def points(unit: np.ndarray) -> Points:
        at = np.exp(low + unit * (high - low))
        return [dict(zip(ranges, row.tolist(), strict=True)) for row in at]

    small = _Narrowing(frozen, n_modes, tolerance)
    small.extend([middle, *points(qmc.Sobol(len(ranges), seed=seed).random(_SAMPLES))])
    chance = np.random.default_rng(seed)
    errors = improve(
        small, lambda: points(chance.random((n_check, len(ranges)))), tolerance, _ROUNDS, least=1.0
    )
    error = float(errors.max())
    if error > tolerance:
        raise ConvergenceError(
            f"the frequencies of the small model are off by {error:.1e}, more than "
            f"{tolerance:.1e}, after {_ROUNDS} rounds: take narrower ranges, or a larger tolerance"
        )
    return Narrow(small.model, error, n_check)


class _Narrowing:
    """A model on the modes of another at some points; see `SmallModel`."""

    def __init__(self, full: ArrayModel, n_modes: int, tolerance: float):
        self.full, self.n_modes = full, n_modes
        self._share, self._snapshots = _SHARE * np.sqrt(tolerance), []

    def _modes(self, model: ArrayModel, values: Mapping[str, float]) -> Modes:
        return solve_modes(model, values, n_modes=min(self.n_modes, model.n_dofs))

    def errors(self, points: Points) -> np.ndarray:
        """Largest relative error of an elastic frequency at each point, (n,)."""
        found = []
        for values in points:
            exact, ours = (self._modes(model, values) for model in (self.full, self.model))
            ratio = ours.frequencies_hz[ours.n_rigid :] / exact.frequencies_hz[exact.n_rigid :]
            found.append(np.max(np.abs(ratio - 1)))
        return np.array(found)

    def extend(self, points: Points) -> None:
        """Take the modes at points into the basis, and a tenth of the share that is left out."""
        self._snapshots += [self._modes(self.full, values).shapes for values in points]
        vectors, sizes = pod(self.full, np.hstack(self._snapshots))
        self.model = self.full.on(vectors[:, sizes > self._share * sizes[0]])
        self._share /= 10


def pod(
    model: ArrayModel,
    snapshots: np.ndarray,
    weights: np.ndarray | None = None,
    given: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Vectors that hold most of the snapshots' energy, best first.

    Args:
        model: The model that the snapshots are of.
        snapshots: As columns, shape (n_dofs, n).
        weights: Of the snapshots, shape (n,); equal by default.
        given: Parameter values whose K + omega^2 M measures the energy; nominal by default.

    Returns:
        Vectors orthonormal in that energy, (n_dofs, k), and their singular values, (k,).
    """
    K, M = model.stiffness(given), model.mass(given)
    upper = np.linalg.cholesky(K + np.trace(K) / np.trace(M) * M).T
    energetic = upper @ snapshots
    energetic *= (1.0 if weights is None else weights) / np.linalg.norm(energetic, axis=0)
    left, sizes, _ = np.linalg.svd(energetic, full_matrices=False)
    return np.linalg.solve(upper, left), sizes


def arrays_of(forward: Forward) -> ArrayModel | None:
    """The model behind a forward; None if it is not one of plain arrays."""
    return forward.model if type(forward.model) is ArrayModel else None


class LeanForward(Forward):
    """A forward of a lean model that solves for many parameter values at a time.

    Args:
        forward: The one whose modes it follows.
        model: Its model on fewer vectors.
    """

    def __init__(self, forward: Forward, model: ArrayModel):
        n_modes = min(forward.n_modes, model.n_dofs)
        unit = _of_unit_mass(model)
        model = model if unit is None else unit
        self._unit = unit is not None
        super().__init__(
            model, forward.sensors, forward.n_test, n_modes, forward.reference, forward.threshold
        )
        if forward.further is not None:
            self.further = LeanForward(forward.further, model)
        self._ready: dict[tuple, tuple] = {}
        self._ready_shapes: dict[tuple, np.ndarray] = {}
        names = list(model.parameters)
        self._pick = itemgetter(*names) if len(names) > 1 else lambda v: (v[names[0]],)

    def __call__(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """See `Forward`; from `prepare` where that knows the values."""
        ready = self._ready.get(self._key(values))
        return super().__call__(self._own(values)) if ready is None else ready

    def seen_shapes(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """See `Forward`; from `prepare` where that knows the values."""
        x = self._ready_shapes.get(self._key(values))
        if x is None:
            return super().seen_shapes(self._own(values))
        return self.model.sensor_rows @ x, self.model.shift_rows @ x

    def _own(self, values) -> dict[str, float]:
        """Without parameters that the model does not have, which a solution would refuse."""
        return {name: values[name] for name in self.model.parameters}

    def _key(self, values) -> tuple:
        return self._pick(values)

    def prepare(self, wanted: Sequence[Mapping[str, float]], slopes: bool) -> np.ndarray:
        """See `Forward`; solved together."""
        try:
            return self._together(wanted, slopes)
        except (InputError, np.linalg.LinAlgError):
            self.release()  # one of them is beyond a law's limit, such as a specimen's: one by one
            return super().prepare(wanted, slopes)

    def _together(self, wanted, slopes: bool) -> np.ndarray:
        keys = [self._key(values) for values in wanted]
        unique = dict(zip(keys, wanted, strict=True))
        self.release()
        self._shapes.clear()
        table = np.array(list(unique))
        values = dict(zip(self.model.parameters, table.T, strict=True))
        eigenvalues, vectors = self._modes(values)
        index, good = self._paired(values, eigenvalues, vectors)
        lam = np.where(good[:, None], np.take_along_axis(eigenvalues, index, axis=1), np.nan)
        with np.errstate(invalid="ignore"):
            log_f = 0.5 * np.log(lam) - np.log(2 * np.pi)
        blank = np.full((index.shape[1], table.shape[1]), np.nan)
        for i, key in enumerate(unique):
            by_values = blank
            if not good[i]:
                self._ready[key] = self._searched(unique[key], (log_f[i], blank))
                continue
            x = self._ready_shapes[key] = vectors[i][:, index[i]]
            if slopes:
                gradients = self.model.pencil_gradients(x, lam[i], unique[key])
                by_values = gradients / (2 * lam[i][:, None])
            self._ready[key] = log_f[i], by_values
        return np.array([self._ready[key][0] for key in keys])

    def release(self) -> None:
        """See `Forward`."""
        self._ready, self._ready_shapes = {}, {}

    def _searched(self, values, nothing) -> tuple[np.ndarray, np.ndarray]:
        """One by one, among more modes; ``nothing`` if the test's are not there either."""
        try:
            return super().__call__(self._own(values))
        except InputError:
            return nothing

    def _modes(self, values) -> tuple[np.ndarray, np.ndarray]:
        """Lowest eigenvalues, (b, n_modes), and M-normalised vectors, (b, n_dofs, n_modes)."""
        K, M = self.model.pencil.matrices(values)
        if self._unit:
            eigenvalues, vectors = np.linalg.eigh(K)
            return eigenvalues[:, : self.n_modes], vectors[:, :, : self.n_modes]
        shift = (2 * np.pi * _SHIFT_SHARE * self.model.scale_hz) ** 2
        inverse_root = np.linalg.inv(np.linalg.cholesky(K + shift * M))
        root_t = np.swapaxes(inverse_root, 1, 2)
        inverse, vectors = np.linalg.eigh(inverse_root @ M @ root_t)
        inverse = inverse[:, : -self.n_modes - 1 : -1]
        vectors = vectors[:, :, : -self.n_modes - 1 : -1]
        return 1 / inverse - shift, root_t @ (vectors / np.sqrt(inverse)[:, None, :])

    def _paired(self, values, eigenvalues, vectors) -> tuple[np.ndarray, np.ndarray]:
        """Index of the model's mode of each of the test's, (b, m), and whether there are enough.

        As `measurements.gap.pair_modes`. If each test mode is most like another model mode, these
        are the assignment; only the rest needs an assignment problem.
        """
        b, m = len(eigenvalues), self.n_test
        rigid = (2 * np.pi * _RIGID_SHARE * _SHIFT_SHARE * self.model.scale_hz) ** 2
        n_rigid = np.sum(np.abs(eigenvalues) < rigid, axis=1)
        seen = np.arange(self.n_modes)[None, :] >= n_rigid[:, None]
        if self.sensors is not None:
            shapes = self.model.sensor_rows @ vectors
            mass = self.model.pencil.total_mass(values)
            seen &= np.sqrt(np.mean(shapes**2, axis=1) * mass[:, None]) > self.threshold
        good = np.sum(seen, axis=1) >= m
        index = np.zeros((b, m), dtype=int)
        if self.sensors is None or self.reference is None:
            for i in np.flatnonzero(good):
                index[i] = np.flatnonzero(seen[i])[:m]
            return index, good
        flat = mac(self.reference, np.concatenate(shapes, axis=1))
        match = np.where(seen[:, None, :], flat.reshape(m, b, -1).transpose(1, 0, 2), -1.0)
        index = np.argmax(match, axis=2)
        ordered = np.sort(index, axis=1)
        for i in np.flatnonzero(good & np.any(ordered[:, 1:] == ordered[:, :-1], axis=1)):
            index[i] = linear_sum_assignment(-match[i])[1]
        return index, good


def _of_unit_mass(model: ArrayModel) -> ArrayModel | None:
    """The model on a basis in which its mass is the identity, a third cheaper to solve.

    None where the mass varies, or where round-off of the stiffest vectors would reach rigid modes.
    """
    pencil, values = model.pencil, model.values()
    travels = any(isinstance(m.travel, str) for m in pencil.masses)
    if travels or pencil.scalar_slopes(values)[1].any():
        return None
    inverse_root = np.linalg.inv(np.linalg.cholesky(model.mass()))
    highest = np.linalg.eigvalsh(inverse_root @ model.stiffness() @ inverse_root.T)[-1]
    rigid = (2 * np.pi * _RIGID_SHARE * _SHIFT_SHARE * model.scale_hz) ** 2
    if _MARGIN * np.finfo(float).eps * highest > rigid:
        return None
    return model.on(inverse_root.T)


def lean_forward(
    forward: Forward,
    model: ArrayModel,
    given: Mapping[str, float],
    snapshots: np.ndarray,
    weights: np.ndarray,
    checks: Sequence[Mapping[str, float]],
    limit: float,
    sizes: Sequence[int] = (16, 20, 24, 28, 32, 36, 40, 50, 60),
    beyond: bool = False,
) -> tuple[LeanForward, float]:
    """The leanest forward whose frequencies are good enough.

    Args:
        forward: The reduced model's.
        model: That model.
        given: The most probable parameter values.
        snapshots: Modes of the reduced model, (n_dofs, n).
        weights: Of the snapshots, (n,).
        checks: Parameter values at which frequencies are compared.
        limit: Error of ln f that is good enough.
        sizes: Sizes of the basis to try.
        beyond: Whether the mode after the test's has to be good enough too (`Forward.further`).

    Returns:
        The forward, and its largest error of ln f at the checks: above ``limit`` if even the
        largest basis is not good enough.
    """
    vectors, energies = pod(model, snapshots, weights, given)
    most = int(np.sum(energies > 1e-7 * energies[0]))
    watched = forward.further if beyond else forward
    exact = np.array([watched(values)[0] for values in checks])
    tried = [s for s in sizes if max(6 + forward.n_test, forward.n_modes) <= s < most] + [most]
    for size in tried:
        lean = LeanForward(forward, model.on(vectors[:, :size]))
        error = frequency_error(lean.further if beyond else lean, checks, exact)
        if error <= limit:
            break
    return lean, error


def frequency_error(lean: LeanForward, checks, exact: np.ndarray) -> float:
    """Largest error of ln f at parameter values; infinite if the lean model lacks a mode."""
    try:
        found = np.array([lean(values)[0] for values in checks])
    except InputError:
        return np.inf
    return float(np.max(np.abs(found - exact)))


def modes_at(forward: Forward, values: Mapping[str, float]) -> np.ndarray:
    """Modes of the reduced model, as many as the test's ask for, shape (n_dofs, n_modes)."""
    try:
        return forward.solve(values)[0].shapes
    except InputError:
        return solve_modes(forward.model, values, n_modes=forward.n_modes).shapes
