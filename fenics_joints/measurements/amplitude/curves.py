"""Backbones from stepped or slowly swept sines, at constant response or at constant force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError, located, reals
from fenics_joints.measurements.amplitude.backbone import RESPONSES, MeasuredBackbone
from fenics_joints.measurements.amplitude.oscillator import fit_oscillator
from fenics_joints.response.units import KINDS as TIMES

#: Points whose response per force is below this share of the largest are other modes' as well.
_FLANK = 0.2
#: Amplitudes at which k and c are unknown are at most this factor apart; the lowest is this share
#: of the lowest sweep's largest.
_APART, _LOWEST = 1.7, 0.35
#: Points for each such amplitude at least, and how well one is known at most that is kept.
_POINTS, _POOR_HZ, _POOR_DAMPING = 4, 0.02, 0.5
#: Kinds of functions by that of the response.
_FUNCTION = dict(zip(("displacement", "velocity", "acceleration"), TIMES, strict=True))


@dataclass(frozen=True, eq=False)
class Sweep:
    """One sweep across a resonance.

    Attributes:
        level: What was held: amplitude of the response, in SI units, or of the force, N.
        frequencies_hz: Hz, (n,).
        functions: Response over force, in SI units, complex with their phase, or sizes, (n,).
        forces: Amplitudes of the force, N, (n,).
    """

    level: float
    frequencies_hz: np.ndarray
    functions: np.ndarray
    forces: np.ndarray

    def __post_init__(self):
        f = reals("frequencies_hz", self.frequencies_hz, (None,), "Hz", above=0)
        h = np.asarray(self.functions)
        forces = np.broadcast_to(np.asarray(self.forces, dtype=float), f.shape)
        if h.shape != f.shape or not (np.isfinite(h).all() and np.all(np.abs(h) > 0)):
            raise InputError("functions: expected a number that is not zero for each frequency.")
        if not np.all(forces > 0):
            raise InputError("forces: expected amplitudes above 0 N.")
        if len(np.unique(f)) < 3:
            raise InputError(f"{len(np.unique(f))} different frequencies; expected three or more")
        for key, value in (("frequencies_hz", f), ("functions", h), ("forces", forces)):
            object.__setattr__(self, key, value)

    @property
    def has_phase(self) -> bool:
        """Whether the functions are complex."""
        return np.iscomplexobj(self.functions)

    def near(self, band: tuple[float, float] | None) -> Sweep:
        """The points near the resonance, and in a band, Hz."""
        size = np.abs(self.functions) / self.frequencies_hz**2
        low, high = band or (0.0, np.inf)
        inside = (self.frequencies_hz >= low) & (self.frequencies_hz <= high)
        if not inside.any():
            raise InputError(f"no point is in the band of {low:g} to {high:g} Hz")
        kept = inside & (size >= _FLANK * size[inside].max())
        return Sweep(self.level, self.frequencies_hz[kept], self.functions[kept], self.forces[kept])

    def receptance(self, response: str) -> tuple[np.ndarray, np.ndarray]:
        """(angular frequencies, displacement over force)."""
        omega = 2 * np.pi * self.frequencies_hz
        times = TIMES[_FUNCTION[response]]
        factor = (1j * omega) ** times if self.has_phase else omega**times
        return omega, self.functions / factor


def from_constant_response(
    sweeps: Sequence[Sweep], response: str, band: tuple[float, float] | None = None
) -> MeasuredBackbone:
    """One point of the backbone from each sweep, that of the linear oscillator it shows.

    Args:
        sweeps: One for each level of the response.
        response: ``displacement``, ``velocity`` or ``acceleration``.
        band: Frequencies to take, Hz.

    Raises:
        InputError: Names the level whose sweep shows no resonance.
    """
    found, notes = [], []
    for sweep in sweeps:
        words = f"level {sweep.level:g} {RESPONSES[response]}"
        with located(words):
            near = sweep.near(band)
            omega, receptance = near.receptance(response)
            top = int(np.argmax(np.abs(receptance)))
            if omega[top] in (omega.min(), omega.max()):
                raise InputError(
                    f"its response per force is largest at the end of the sweep, "
                    f"{omega[top] / (2 * np.pi):.6g} Hz; expected points on both sides of the peak"
                )
            ones = np.ones((len(omega), 1))
            found.append(fit_oscillator(omega, receptance, ones, phase=near.has_phase))
        if found[-1].scatter > 0.1:
            notes.append(f"{words}: one oscillator leaves {100 * found[-1].scatter:.0f} % of it")
    levels = np.array([sweep.level for sweep in sweeps])
    arrays = {
        key: np.array([getattr(one, key)[0] for one in found])
        for key in ("frequencies_hz", "frequencies_sd", "damping", "damping_sd")
    }
    wrong = arrays["damping"] * _not_held(levels, arrays["frequencies_hz"], response)
    arrays["damping"] = arrays["damping"] + wrong
    arrays["damping_sd"] = np.hypot(arrays["damping_sd"], 0.5 * wrong)
    return _backbone(response, levels, arrays, "constant response", notes)


def _not_held(levels: np.ndarray, hz: np.ndarray, response: str) -> np.ndarray:
    """By how much damping is off where acceleration or velocity is held and stiffness depends on
    displacement, relative.

    At a held w^n a, a falls along the sweep, so that k(a) turns the slope of k - m w^2 as a modal
    mass larger by the share n d ln w0 / d ln a would, and zeta = c / (2 m w0).
    """
    times = TIMES[_FUNCTION[response]]
    if not times or len(np.unique(levels)) < 2:
        return np.zeros(len(levels))
    x, first = np.unique(np.log(levels / hz**times), return_index=True)
    slope = np.gradient(np.log(hz[first]), x)
    return times * np.interp(np.log(levels / hz**times), x, slope)


def from_constant_force(
    sweeps: Sequence[Sweep], response: str, band: tuple[float, float] | None = None
) -> MeasuredBackbone:
    """The backbone that all sweeps share, where each point has an amplitude of its own.

    k(a) and c(a) are piecewise linear in ln a; the modal mass comes from the two sides of the peak,
    where the same amplitude is met at two frequencies. Folds and jumps do not matter. The points'
    errors are not independent: they share the mass.

    Args:
        sweeps: One for each level of the force, or branch of it.
        response: ``displacement``, ``velocity`` or ``acceleration``.
        band: Frequencies to take, Hz.

    Raises:
        InputError: If they hold too few points, or no resonance.
    """
    near = [sweep.near(band) for sweep in sweeps]
    phase = all(sweep.has_phase for sweep in near)
    if not phase:
        near = [Sweep(s.level, s.frequencies_hz, np.abs(s.functions), s.forces) for s in near]
    omega, receptance = (
        np.concatenate(parts) for parts in zip(*(s.receptance(response) for s in near), strict=True)
    )
    motion = [np.abs(s.receptance(response)[1]) * s.forces for s in near]
    x = np.log(np.concatenate(motion))
    knots = _supported(x, _knots([float(np.log(a.max())) for a in motion], len(x)))
    fit = fit_oscillator(omega, receptance, _hats(x, knots), phase=phase)
    poor = (fit.frequencies_sd > _POOR_HZ * fit.frequencies_hz) | ~(
        fit.damping_sd < _POOR_DAMPING * fit.damping
    )
    notes = []
    if poor.all():
        raise InputError(
            "the sweeps do not determine frequency and damping at any amplitude; expected more "
            "points near the peaks" + ("" if phase else ", or the phase")
        )
    if poor.any():
        lost = ", ".join(f"{a:.3g} m" for a in np.exp(knots[poor]))
        notes.append(f"frequency and damping are not determined at {lost}, and left out")
    if fit.scatter > 0.1:
        notes.append(f"one mode with one backbone leaves {100 * fit.scatter:.0f} % of the sweeps")
    w = 2 * np.pi * fit.frequencies_hz
    amplitudes = np.exp(knots) * w ** TIMES[_FUNCTION[response]]
    arrays = {
        key: getattr(fit, key)[~poor]
        for key in ("frequencies_hz", "frequencies_sd", "damping", "damping_sd")
    }
    return _backbone(response, amplitudes[~poor], arrays, "constant force", notes)


def _backbone(response, amplitudes, arrays, kind, notes) -> MeasuredBackbone:
    # Data without any noise leave nothing, to which no deviation can be given.
    for key in ("frequencies", "damping"):
        value = arrays["frequencies_hz" if key == "frequencies" else key]
        arrays[f"{key}_sd"] = np.maximum(arrays[f"{key}_sd"], 1e-9 * value)
    return MeasuredBackbone(
        response, np.asarray(amplitudes), **arrays, kind=kind, notes=tuple(notes)
    )


def _knots(tops: list[float], n: int) -> np.ndarray:
    """ln of the amplitudes at which k and c are unknown: the sweeps' largest, and between."""
    tops = np.unique(np.round(tops, 6))
    ends = [tops[0] + np.log(_LOWEST)]
    for top in tops:
        if top - ends[-1] > 0.5 * np.log(_APART) or len(ends) == 1:
            ends.append(top)
    ends[-1] = tops[-1]
    most, apart = max(n // _POINTS, 2), np.log(_APART)
    while True:
        parts = np.maximum(1, np.ceil(np.diff(ends) / apart - 1e-9).astype(int))
        if parts.sum() + 1 <= most or np.all(parts == 1):
            break
        apart *= 1.2
    spans = zip(ends[:-1], ends[1:], parts, strict=True)
    pieces = [np.linspace(low, high, k, endpoint=False) for low, high, k in spans]
    return np.append(np.concatenate(pieces), ends[-1])


def _supported(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """The knots with points about them: one that has none, as in a jump, is nobody's."""
    while len(knots) > 2:
        weight = _hats(x, knots).sum(axis=0)
        if weight.min() >= 0.5 * _POINTS:
            break
        knots = np.delete(knots, int(np.argmin(weight)))
    return knots


def _hats(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Values of the piecewise linear basis, (n, L); constant beyond the knots."""
    return np.column_stack([np.interp(x, knots, row) for row in np.eye(len(knots))])
