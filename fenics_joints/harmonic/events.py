"""Harmonics of stress of laws without memory whose branches change within the cycle.

Where a stop is met or friction turns, stress has a kink. Sampled evenly, its harmonics are off by
the square of the step, and as functions of the motion they have a kink each time the contact
passes a sample: Newton's method and the continuation stumble over these, the more the stiffer the
stop. Here the times at which a law's switches change their signs are found, and Gauss's rule
integrates between them, so that the harmonics are as smooth as the motion's physics allows.
"""

from __future__ import annotations

import numpy as np

from fenics_joints.harmonic.fourier import Fourier, basis
from fenics_joints.joint_laws.kernel import HarmonicStress, LawKernel

__all__ = ["event_times", "memoryless_stress"]

#: Samples that a panel of Gauss's rule replaces, and nodes in it: at 8 H samples or more, what a
#: Jacobian integrates, up to twice the highest harmonic, goes through 2 pi in a panel.
_PANEL, _NODES = 4, 8
_GAUSS = np.polynomial.legendre.leggauss(_NODES)
#: Most points that are integrated at once.
_BLOCK = 64
_BISECTIONS, _NEWTONS = 40, 60


def memoryless_stress(
    kernel: LawKernel, X: np.ndarray, omega: float, fourier: Fourier, values: np.ndarray, *,
    jacobian: bool = True,
) -> HarmonicStress:  # fmt: skip
    """Harmonics of stress by those of strain, of a law without memory.

    Args:
        kernel: The law.
        X: Harmonics of strain, (P, d, K).
        omega: Angular frequency, rad/s.
        fourier: Harmonics and samples.
        values: Parameters, (P, E, n_parameters).
        jacobian: Whether the derivatives are wanted.
    """
    (P, d, K), T, G = X.shape, fourier.samples, fourier.derivative
    Z = np.concatenate([X, omega * (X @ G.T)], axis=1) if kernel.rated else X
    inputs = Z @ fourier.synthesis.T
    stress = kernel.history(inputs.transpose(0, 2, 1), None, values)[0]
    F, J = np.empty((P, d, K)), np.empty((P, d, K, Z.shape[1], K)) if jacobian else None
    times = event_times(kernel, Z, fourier, values)
    even = 2 * np.pi * np.arange(T) / T
    rules = [(even, np.full(T, 2 * np.pi / T)) if not len(t) else _rule(t, T) for t in times]
    for many in _blocks(rules):
        made = _integrated(kernel, Z[many], [rules[i] for i in many], values[many], jacobian)
        F[many] = made[0]
        if jacobian:
            J[many] = made[1]
    by_omega = None
    if kernel.rated and jacobian:
        by_rate = J[..., d:, :]
        by_omega = np.einsum("pakbl,pbl->pak", by_rate, X @ G.T)
        J = np.ascontiguousarray(J[..., :d, :] + omega * by_rate @ G)
    state = np.zeros((*values.shape[:2], 0))
    strain = np.ascontiguousarray(inputs[:, :d].transpose(0, 2, 1))
    return HarmonicStress(F, J, strain, stress, state, 0.0, by_omega)


def event_times(
    kernel: LawKernel, Z: np.ndarray, fourier: Fourier, values: np.ndarray
) -> list[np.ndarray]:
    """Phases w t, rising, at which a switch of each point changes its sign.

    Args:
        kernel: The law.
        Z: Harmonics of what it asks for, (P, inputs, K).
        fourier: Harmonics, and the samples between which a switch may turn once.
        values: Parameters, (P, E, n_parameters).
    """
    P, T, K = len(Z), fourier.samples, fourier.size
    if not kernel.n_switches:
        return [np.empty(0)] * P
    changes, step = Z @ fourier.derivative.T, 2 * np.pi / T

    def at(points, phases, numbers):
        """Switches by number and their slopes by phase."""
        there = basis(phases, K)[..., None]
        g, slopes = kernel.switches((Z[points] @ there)[..., 0], values[points])
        rows = np.arange(len(points))
        change = (changes[points] @ there)[..., 0]
        return g[rows, numbers], np.einsum("ni,ni->n", slopes[rows, numbers], change)

    inputs = (Z @ fourier.synthesis.T).transpose(0, 2, 1).reshape(P * T, -1)
    change = (changes @ fourier.synthesis.T).transpose(0, 2, 1).reshape(P * T, -1)
    g, slopes = kernel.switches(inputs, np.repeat(values, T, axis=0))
    slope = np.einsum("nsi,ni->ns", slopes, change).reshape(P, T, -1)
    g = g.reshape(P, T, -1)
    after, slope_after = np.roll(g, -1, axis=1), np.roll(slope, -1, axis=1)
    found = _bracketed(at, *_cells((g >= 0) != (after >= 0), step))
    sign = np.where(g >= 0, 1.0, -1.0)
    start, end, down, up = sign * g, sign * after, sign * slope, sign * slope_after
    turns = ((g >= 0) == (after >= 0)) & (down < 0) & (up > 0)
    # Where the tangents of both ends meet, what is convex between them is not below.
    meet = start + down * (end - up * step - start) / np.where(turns, down - up, 1.0)
    grazed = _cells(turns & (meet < 0), step)
    if len(grazed[0]):
        found += _hidden(at, *grazed)
    by_point = [[] for _ in range(P)]
    for point, phase in found:
        by_point[point].append(phase % (2 * np.pi))
    return [np.unique(np.array(phases)) for phases in by_point]


def _cells(chosen: np.ndarray, step: float):
    """(points, numbers of switches, lower and upper phase) of chosen cells, (P, T, S)."""
    points, samples, numbers = np.nonzero(chosen)
    return points, numbers, step * samples, step * (samples + 1)


def _hidden(at, points, numbers, low, high) -> list[tuple[int, float]]:
    """Both changes of a switch that turns within a cell, if it changes at all."""
    g, slope = at(points, low, numbers)
    sign, a, b = np.where(g >= 0, 1.0, -1.0), low.copy(), high.copy()
    for _ in range(_BISECTIONS):
        middle = 0.5 * (a + b)
        falls = sign * at(points, middle, numbers)[1] < 0
        a, b = np.where(falls, middle, a), np.where(falls, b, middle)
    met = sign * at(points, a, numbers)[0] < 0
    points, numbers, low, high, a = (v[met] for v in (points, numbers, low, high, a))
    return _bracketed(at, points, numbers, low, a) + _bracketed(at, points, numbers, a, high)


def _bracketed(at, points, numbers, low, high) -> list[tuple[int, float]]:
    """The phase at which each switch changes its sign between two, by Newton's method."""
    if not len(points):
        return []
    low, high = low.copy(), high.copy()
    positive = at(points, low, numbers)[0] >= 0
    x = 0.5 * (low + high)
    for _ in range(_NEWTONS):
        g, slope = at(points, x, numbers)
        before = (g >= 0) == positive
        low, high = np.where(before, x, low), np.where(before, high, x)
        with np.errstate(divide="ignore", invalid="ignore"):
            new = x - g / slope
        inside = (new > low) & (new < high)
        new = np.where(inside, new, 0.5 * (low + high))
        moved, x = np.abs(new - x).max(), new
        if moved < 1e-14:
            break
    return list(zip(points.tolist(), x.tolist(), strict=True))


def _rule(times: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of Gauss's rule over a period, in panels that end at the times."""
    count = -(-samples // _PANEL)
    ends = np.union1d(np.linspace(0.0, 2 * np.pi, count + 1), times)
    middle, half = 0.5 * (ends[1:] + ends[:-1]), 0.5 * np.diff(ends)
    nodes, weights = _GAUSS
    return (middle[:, None] + half[:, None] * nodes).ravel(), (half[:, None] * weights).ravel()


def _blocks(rules) -> list[np.ndarray]:
    """Points with as many nodes each, not too many at once."""
    sizes, found = np.array([len(nodes) for nodes, _ in rules]), []
    for size in np.unique(sizes):
        same = np.flatnonzero(sizes == size)
        found += [same[i : i + _BLOCK] for i in range(0, len(same), _BLOCK)]
    return found


def _integrated(kernel: LawKernel, Z, rules, values, jacobian: bool):
    """Harmonics of stress (P, d, K) by a rule each, and their derivatives by Z, or None."""
    phases, weights = (np.array(part) for part in zip(*rules, strict=True))
    (P, n, K), N = Z.shape, phases.shape[1]
    there = basis(phases, K)
    inputs = there @ Z.transpose(0, 2, 1)
    stress, _, tangent = kernel.step(inputs.reshape(P * N, n), None, np.repeat(values, N, axis=0))
    analysis = (there * (weights / np.pi)[..., None]).transpose(0, 2, 1)
    analysis[:, 0] /= 2
    F = (analysis @ stress.reshape(P, N, -1)).transpose(0, 2, 1)
    if not jacobian:
        return F, None
    d = F.shape[1]
    tangent = tangent.reshape(P, N, d, n)
    J = np.empty((P, d, K, n, K))
    for a in range(d):
        for b in range(n):
            J[:, a, :, b] = (analysis * tangent[:, None, :, a, b]) @ there
    return F, J
