"""Harmonic balance of a structure with nonlinear interfaces: residual and exact Jacobian.

Periodic motion makes of M x'' + C x' + K x + sum w B^T sigma(B x) = f(t) one equation per degree of
freedom and harmonic (Krack & Gross, Harmonic Balance for Nonlinear Vibration Problems, 2019). The
stress is computed over the cycle (alternating frequency-time, Cameron & Griffin 1989), from one
instant at which a law changes its branch to the next; laws with memory run through the cycle until
their loop is closed. A load is a sum of harmonics at several places.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from mpi4py import MPI

from fenics_joints.errors import InputError, capable, real, reals, text, whole
from fenics_joints.harmonic.fourier import Fourier
from fenics_joints.interfaces import InterfaceModel, InterfacePoints, static_state
from fenics_joints.interfaces.model import check_interfaces
from fenics_joints.joint_laws.kernel import HarmonicStress, LawKernel

#: Samples of a period that integrate smooth hysteresis to some 1e-4 (measured).
_SAMPLES_WITH_MEMORY = 128
#: Most numbers of one product in the Jacobian's assembly; chosen for memory.
_BLOCK = 4_000_000


def default_samples(model: InterfaceModel, harmonics: int) -> int:
    """Samples of a period: a power of two, at least 4 (2H + 1), and 128 if a law has memory.

    Raises:
        InputError: If this is no model, or no number of harmonics.
    """
    capable("model", model, ("interfaces",), "an InterfaceModel")
    whole("harmonics", harmonics)
    least = 4 * (2 * harmonics + 1)
    if any(points.kernel.m for points in model.interfaces):
        least = max(least, _SAMPLES_WITH_MEMORY)
    return 1 << (least - 1).bit_length()


@dataclass(frozen=True)
class _Share:
    """The points of one interface that this rank runs."""

    kernel: object
    rows: np.ndarray  # (P, d, n)
    weighted: np.ndarray  # (P d, n)
    values: np.ndarray
    state: np.ndarray | None


class BalanceOptions(TypedDict, total=False):
    """Options of `Balance` that every solver takes and hands on."""

    harmonics: int
    samples: int | None
    static: np.ndarray | None
    cycles: int
    comm: MPI.Comm | None


class Balance:
    """Harmonic balance of an `InterfaceModel`.

    Unknowns are the coefficients X of shape (n, K), or flat in that order. Of a free structure the
    mean of its rigid motion, which nothing determines, is none.

    Args:
        model: The model.
        harmonics: H, highest harmonic.
        samples: Samples of a period, T; `default_samples` by default.
        static: Static load, N, (n,), in the mean's equations, which laws with memory bear before
            the first cycle (`static_state`); None for none.
        cycles: How often laws with memory run through the cycle.
        periods: Of the force, that one of the response takes: 2 after a period doubling.
        comm: The interfaces' points are split over its ranks; every rank must hold the same model
            and make the same calls. None for this rank alone.

    Raises:
        InputError: For a load or samples that do not fit, or a static load that would push a free
            structure away.
        ConvergenceError: If there is no equilibrium under the static load.

    Attributes:
        rest: Coefficients under the static load alone, m, (n, K).
        kinked: Whether laws without memory change branches, and the Jacobian jumps where a stop is
            met.
    """

    def __init__(
        self,
        model: InterfaceModel,
        harmonics: int = 5,
        samples: int | None = None,
        *,
        static: np.ndarray | None = None,
        cycles: int = 2,
        periods: int = 1,
        comm: MPI.Comm | None = None,
    ):
        check_interfaces(model)
        harmonics, cycles = whole("harmonics", harmonics), whole("cycles", cycles)
        if samples is None:
            samples = default_samples(model, harmonics * whole("periods", periods))
        self.model, self.cycles = model, cycles
        self.fourier = Fourier(harmonics, samples, periods)
        self.comm = MPI.COMM_SELF if comm is None else comm
        self.static = np.zeros(model.n_dofs) if static is None else reals("static", static)
        if self.static.shape != (model.n_dofs,):
            raise InputError(
                f"static has shape {self.static.shape}: expected ({model.n_dofs},), one load per "
                "degree of freedom."
            )
        self.rest, self._states = np.zeros(self.shape), {}
        if np.any(self.static):
            self.rest[:, 0], self._states = static_state(model, self.static)
        self._held = _held(model)
        self._shares = [_share(p, self._states.get(p.name), self.comm) for p in model.interfaces]
        self._whole = self._shares if self.comm.size == 1 else None
        self._rated = any(points.kernel.rated for points in model.interfaces)
        kernels = [points.kernel for points in model.interfaces]
        self.kinked = any(kernel.n_switches and not kernel.m for kernel in kernels)
        G = self.fourier.derivative
        self._G, self._G2 = G, G @ G
        self._krons = None

    @property
    def shape(self) -> tuple[int, int]:
        """(n, K)."""
        return self.model.n_dofs, self.fourier.size

    @property
    def size(self) -> int:
        """Number of unknowns, n K."""
        return self.model.n_dofs * self.fourier.size

    def changed(self, model: InterfaceModel | None = None, **options) -> Balance:
        """The same balance with another model of the same size, or with other options."""
        f = self.fourier
        kept = {"harmonics": f.harmonics, "samples": f.samples, "periods": f.periods}
        kept |= {"static": self.static, "cycles": self.cycles, "comm": self.comm}
        return Balance(self.model if model is None else model, **kept | options)

    def load(self, force: np.ndarray) -> np.ndarray:
        """Coefficients (n, K) of a load ``force`` (n,) times cos(w t)."""
        load = np.zeros(self.shape)
        load[:, self.fourier.cosine()] = force
        return load

    def linear(self, X: np.ndarray, omega: float) -> np.ndarray:
        """Inertia, damping and linear stiffness, N, (n, K)."""
        m = self.model
        F = m.K @ X + omega * (m.C @ X @ self._G.T) + omega**2 * (m.M @ X @ self._G2.T)
        if self._held is not None:
            F[:, 0] += self._held @ X[:, 0]
        return F

    def by_omega(self, X: np.ndarray, omega: float) -> np.ndarray:
        """Derivative of the residual by omega, (n, K)."""
        m = self.model
        found = m.C @ X @ self._G.T + 2 * omega * (m.M @ X @ self._G2.T)
        return found + self.rates_by_omega(X, omega) if self._rated else found

    def rates_by_omega(self, X: np.ndarray, omega: float) -> np.ndarray:
        """What the frequency does to the rates that laws ask for, (n, K)."""
        found = np.zeros(self.shape)
        for share in self._shares:
            if share.kernel.rated and len(share.rows):
                made = self._harmonic(share, X, omega, True).by_omega
                found += share.weighted.T @ made.reshape(-1, self.shape[1])
        return self._sum(found)

    def dynamic_stiffness(self, omega: float) -> np.ndarray:
        """Derivative of `linear` by X, (n K, n K)."""
        if self._krons is None:
            m, one = self.model, np.eye(self.fourier.size)
            self._krons = np.kron(m.K, one), np.kron(m.C, self._G), np.kron(m.M, self._G2)
            if self._held is not None:
                mean = np.zeros_like(one)
                mean[0, 0] = 1.0
                self._krons[0][:] += np.kron(self._held, mean)
        K, C, M = self._krons
        return K + omega * C + omega**2 * M

    def evaluate(
        self, X: np.ndarray, omega: float, load: np.ndarray | None = None, *, jacobian=True
    ):
        """Residual, N, (n, K), and its derivative by X, (n K, n K), or None.

        Args:
            X: Coefficients, m, (n, K).
            omega: Angular frequency, rad/s.
            load: Coefficients of the load beside the static one, (n, K).
            jacobian: Whether the derivative is wanted.
        """
        F, J = self.interface_force(X, omega, jacobian=jacobian)
        R = self.linear(X, omega) + F
        R[:, 0] -= self.static
        if load is not None:
            R -= load
        return R, (J + self.dynamic_stiffness(omega) if jacobian else None)

    def interface_force(self, X: np.ndarray, omega: float = 0.0, *, jacobian=True):
        """Generalised force of the interfaces, (n, K), and its derivative (n K, n K), or None.

        Args:
            X: Coefficients, m, (n, K).
            omega: Angular frequency, rad/s, for laws with the rate of strain.
            jacobian: Whether the derivative is wanted.
        """
        n, K = self.shape
        F, J = np.zeros((n, K)), np.zeros((n, K, K, n)) if jacobian else None
        for share in self._shares:
            if not len(share.rows):
                continue
            made = self._harmonic(share, X, omega, jacobian)
            F += share.weighted.T @ made.coefficients.reshape(-1, K)
            if jacobian:
                _add_jacobian(J, share, made.jacobian)
        F = self._sum(F)
        return F, self._sum(J).transpose(0, 1, 3, 2).reshape(n * K, n * K) if jacobian else None

    def stresses(self, X: np.ndarray, omega: float = 0.0) -> dict[str, HarmonicStress]:
        """Strain and stress of all points over the cycle, by interface; any rank alone may ask.

        Arguments as `interface_force`.
        """
        if self._whole is None:
            self._whole = [
                _share(p, self._states.get(p.name), MPI.COMM_SELF) for p in self.model.interfaces
            ]
        shares = zip(self.model.interfaces, self._whole, strict=True)
        return {
            points.name: self._harmonic(share, X, omega, False, sampled=True)
            for points, share in shares
        }

    def _harmonic(
        self, share: _Share, X: np.ndarray, omega: float, jacobian: bool, sampled: bool = False
    ) -> HarmonicStress:
        f, kernel, strain = self.fourier, share.kernel, share.rows @ X
        if not kernel.m:
            return memoryless_stress(kernel, strain, omega, f, share.values, jacobian=jacobian)
        return kernel.harmonic(
            strain,
            f.periods * strain @ f.derivative.T,
            f.synthesis,
            share.values,
            share.state,
            cycles=self.cycles,
            jacobian=jacobian,
            sampled=sampled,
        )

    def _sum(self, part: np.ndarray) -> np.ndarray:
        if self.comm.size == 1:
            return part
        # Not Allreduce: every rank must go on with the same bits, or their branches part.
        total = np.empty_like(part) if self.comm.rank == 0 else part
        self.comm.Reduce(part, total if self.comm.rank == 0 else None, root=0)
        self.comm.Bcast(total, root=0)
        return total


def _held(model: InterfaceModel) -> np.ndarray | None:
    """Stiffness, N/m, (n, n), that holds the mean place and turn of a free model; None for others.

    They are open otherwise. Held at none they bear nothing, as the loads of a periodic motion, and
    a static one that has an equilibrium, do no work on them in the mean.
    """
    free = model.free_motions()
    if not len(free):
        return None
    scale = np.trace(model.stiffness_at_rest()) / np.trace(model.M)
    return scale * free.inertia @ free.inertia.T


def _share(points: InterfacePoints, state: np.ndarray | None, comm: MPI.Comm) -> _Share:
    P, n = len(points), points.rows.shape[2]
    bounds = [P * r // comm.size for r in range(comm.size + 1)]
    mine = slice(bounds[comm.rank], bounds[comm.rank + 1])
    values = points.law.values(P)
    state = None if state is None else state[mine]
    rows = np.ascontiguousarray(points.rows[mine], dtype=float)
    weighted = (np.asarray(points.weights)[mine, None, None] * rows).reshape(-1, n)
    return _Share(points.kernel, rows, weighted, values[mine], state)


def _add_jacobian(J: np.ndarray, share: _Share, by_strain: np.ndarray) -> None:
    """J (n, K, K, n) += weighted rows^T . by_strain (P, d, K, d, K) . rows, in blocks of points."""
    P, d, K, _, _ = by_strain.shape
    n = share.rows.shape[2]
    block = max(1, _BLOCK // (d * K * K * n))
    flat = J.reshape(n, K * K * n)
    for first in range(0, P, block):
        part = slice(first, first + block)
        rows = share.rows[part]
        left = by_strain[part].transpose(0, 1, 2, 4, 3).reshape(len(rows), d * K * K, d)
        right = (left @ rows).reshape(len(rows) * d, K * K * n)
        flat += share.weighted[first * d : (first + len(rows)) * d].T @ right


def memoryless_stress(
    kernel: LawKernel,
    X: np.ndarray,
    omega: float,
    fourier: Fourier,
    values: np.ndarray,
    *,
    jacobian: bool = True,
) -> HarmonicStress:
    """Harmonics of stress by those of strain, of a law without memory.

    Args:
        kernel: The law.
        X: Harmonics of strain, (P, d, K).
        omega: Angular frequency, rad/s.
        fourier: Harmonics and samples.
        values: Parameters, (P, E, n_parameters).
        jacobian: Whether the derivatives are wanted.
    """
    d, G = X.shape[1], fourier.derivative
    Z = np.concatenate([X, omega * (X @ G.T)], axis=1) if kernel.rated else X
    inputs = Z @ fourier.synthesis.T
    stress = kernel.history(inputs.transpose(0, 2, 1), None, values)[0]
    changes = fourier.periods * Z @ G.T
    F, J = kernel.memoryless(Z, changes, fourier.synthesis, values, jacobian=jacobian)
    by_omega = None
    if kernel.rated and jacobian:
        by_rate = J[..., d:, :]
        by_omega = np.einsum("pakbl,pbl->pak", by_rate, X @ G.T)
        J = np.ascontiguousarray(J[..., :d, :] + omega * by_rate @ G)
    state = np.zeros((*values.shape[:2], 0))
    strain = np.ascontiguousarray(inputs[:, :d].transpose(0, 2, 1))
    return HarmonicStress(F, J, strain, stress, state, 0.0, by_omega)


@dataclass(frozen=True)
class Load:
    """A load amplitude * (harmonic * w)^power * cos(harmonic * w t + phase) at a place.

    Attributes:
        force: Name of the place.
        amplitude: N, with a power N s^power.
        harmonic: Of the frequency.
        phase: rad; a load with a positive one comes earlier.
        power: Of the frequency, rad/s: 2 for an unbalance, kg m, or a base that moves by m.
    """

    force: str
    amplitude: float
    harmonic: int = 1
    phase: float = 0.0
    power: int = 0

    def __post_init__(self):
        text("load.force", self.force)
        real("load.amplitude", self.amplitude, "N")
        real("load.phase", self.phase, "rad")
        whole("load.harmonic", self.harmonic)
        whole("load.power", self.power, -4, most=4)


class Loading:
    """Coefficients (n, K) of loads together, by the frequency.

    Args:
        parts: Coefficients by the power of the frequency that they are multiplied by.
    """

    def __init__(self, parts: dict[int, np.ndarray]):
        self._parts = parts

    @classmethod
    def of(cls, balance: Balance, loads: Iterable[Load]) -> Loading:
        """That of some loads on a model.

        Raises:
            InputError: For an unknown place, or a harmonic that the balance does not have.
        """
        parts = {0: np.zeros(balance.shape)}
        for load in loads:
            h = load.harmonic
            if h > balance.fourier.harmonics:
                raise InputError(
                    f"load.harmonic = {h}: expected at most {balance.fourier.harmonics}, the "
                    "highest of the balance."
                )
            part = parts.setdefault(load.power, np.zeros(balance.shape))
            row = load.amplitude * float(h) ** load.power * balance.model.row("forces", load.force)
            cosine = balance.fourier.cosine(h)
            part[:, cosine] += np.cos(load.phase) * row
            part[:, cosine + 1] -= np.sin(load.phase) * row
        return cls(parts)

    def times(self, share: float) -> Loading:
        """A share of these loads."""
        return Loading({p: share * part for p, part in self._parts.items()})

    def at(self, omega: float) -> np.ndarray:
        """Coefficients at a frequency, rad/s."""
        return sum(omega**p * part for p, part in self._parts.items())

    def slope(self, omega: float) -> np.ndarray:
        """Their derivative by it."""
        return sum(p * float(omega) ** (p - 1) * part for p, part in self._parts.items())


def load_work(
    balance: Balance, loads: Iterable[Load], X: np.ndarray, omegas: np.ndarray
) -> np.ndarray:
    """Work of the loads per cycle, J, (N,), on motions X (N, n, K) at their frequencies (N,)."""
    loading, periods = Loading.of(balance, loads), balance.fourier.periods
    h = np.arange(1, balance.fourier.harmonics * periods + 1) / periods
    F = np.array([loading.at(omega) for omega in omegas])
    along = np.einsum("pnh,pnh->ph", F[:, :, 1::2], X[:, :, 2::2])
    against = np.einsum("pnh,pnh->ph", F[:, :, 2::2], X[:, :, 1::2])
    return np.pi * (along - against) @ h
