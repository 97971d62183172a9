"""Frequency and damping of one mode over its amplitude, each with its standard deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.errors import InputError, member, reals

#: SI unit of what an amplitude may be of.
RESPONSES = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s2", "force": "N"}
#: What a backbone may come from.
KINDS = ("backbone", "constant response", "constant force", "ring-down")
#: Most levels of a test that is made of it: a diagnosis computes each.
_LEVELS = 8
#: Points that are known this much worse than the typical one do not make a level.
_POOR = 10.0


@dataclass(frozen=True, eq=False)
class MeasuredBackbone:
    """A mode over its amplitude at one sensor, points in ascending order of the amplitude.

    Attributes:
        response: ``displacement``, ``velocity``, ``acceleration`` of the sensor; or ``force``, that
            at resonance.
        amplitudes: Peak values (not rms), in SI units, (n,).
        frequencies_hz: Natural frequencies, Hz, (n,).
        frequencies_sd: Their standard deviations, Hz, (n,).
        damping: Damping ratios, (n,); nan where not measured.
        damping_sd: Their standard deviations, (n,); nan likewise.
        kind: One of `KINDS`: what was measured.
        notes: What is doubtful or was left out, in sentences.
    """

    response: str
    amplitudes: np.ndarray
    frequencies_hz: np.ndarray
    frequencies_sd: np.ndarray
    damping: np.ndarray
    damping_sd: np.ndarray
    kind: str = "backbone"
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        member("response", self.response, RESPONSES)
        member("kind", self.kind, KINDS)
        a = reals("amplitudes", self.amplitudes, (None,), above=0)
        f = reals("frequencies_hz", self.frequencies_hz, a.shape, "Hz", above=0)
        if not len(a):
            raise InputError("amplitudes: expected one point or more.")
        arrays = {"amplitudes": a, "frequencies_hz": f}
        arrays["frequencies_sd"] = reals(
            "frequencies_sd", self.frequencies_sd, a.shape, "Hz", above=0
        )
        zeta, sd = (np.array(v, dtype=float) for v in (self.damping, self.damping_sd))
        there = np.isfinite(zeta)
        if zeta.shape != a.shape or sd.shape != a.shape or not np.all(sd[there] > 0):
            raise InputError(
                "damping, damping_sd: expected a ratio and its deviation above 0 for each "
                "amplitude, nan where damping was not measured."
            )
        arrays |= {"damping": zeta, "damping_sd": np.where(there, sd, np.nan)}
        order = np.argsort(a, kind="stable")
        for key, value in arrays.items():
            object.__setattr__(self, key, value[order])

    def __len__(self) -> int:
        return len(self.amplitudes)

    def __repr__(self) -> str:
        a = self.amplitudes
        reach = f"{a[0]:.3g} to {a[-1]:.3g} {RESPONSES[self.response]}"
        return f"MeasuredBackbone({len(self)} points, {reach}, {self.kind})"

    @property
    def displacements(self) -> np.ndarray:
        """Amplitudes as displacements, m, (n,), unless they are of force."""
        times = tuple(RESPONSES).index(self.response)
        return self.amplitudes / (2 * np.pi * self.frequencies_hz) ** times

    @property
    def has_damping(self) -> bool:
        """Whether damping was measured at some amplitude."""
        return bool(np.isfinite(self.damping).any())

    def with_noise(
        self, frequency: float | np.ndarray = 0.0, damping: float = 0.0
    ) -> MeasuredBackbone:
        """With further relative deviations, of what the files do not show: drift, reassembly."""
        return replace(
            self,
            frequencies_sd=np.hypot(self.frequencies_sd, frequency * self.frequencies_hz),
            damping_sd=np.hypot(self.damping_sd, damping * np.abs(self.damping)),
        )

    def condensed(self, most: int = _LEVELS) -> MeasuredBackbone:
        """At most so many points: means, by their precision, over even steps of ln amplitude."""
        good = self.frequencies_sd <= _POOR * np.median(self.frequencies_sd)
        x = np.log(self.amplitudes)
        if good.sum() <= most:
            step = np.where(good, np.cumsum(good), -1)
        else:
            edges = np.linspace(x[good][0], x[good][-1] + 1e-9, most + 1)
            step = np.where(good, np.digitize(x, edges), -1)
        rows = [np.flatnonzero(step == i) for i in np.unique(step[good])]
        f = [_mean(self.frequencies_hz[r], self.frequencies_sd[r]) for r in rows]
        zeta = [_mean(self.damping[r], self.damping_sd[r]) for r in rows]
        amplitudes = [np.exp(_mean(x[r], self.frequencies_sd[r])[0]) for r in rows]
        return replace(
            self,
            amplitudes=amplitudes,
            frequencies_hz=[m for m, _ in f],
            frequencies_sd=[s for _, s in f],
            damping=[m for m, _ in zeta],
            damping_sd=[s for _, s in zeta],
        )


def joined(parts: Sequence[MeasuredBackbone]) -> MeasuredBackbone:
    """Points of several records of one mode together.

    Raises:
        InputError: If they are of different responses.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    for part in parts:
        if part.response != first.response:
            raise InputError(
                f"one record is of {first.response}, another of {part.response}; expected one "
                "kind of response"
            )
    arrays = {
        key: np.concatenate([getattr(part, key) for part in parts])
        for key in ("amplitudes", "frequencies_hz", "frequencies_sd", "damping", "damping_sd")
    }
    notes = tuple(dict.fromkeys(note for part in parts for note in part.notes))
    return MeasuredBackbone(first.response, **arrays, kind=first.kind, notes=notes)


def _mean(values: np.ndarray, sd: np.ndarray) -> tuple[float, float]:
    """Mean by precision and its deviation, widened where the values scatter by more."""
    there = np.isfinite(values)
    if not there.any():
        return np.nan, np.nan
    values, weights = values[there], 1 / sd[there] ** 2
    mean = float(np.sum(weights * values) / np.sum(weights))
    spread = np.sum(weights * (values - mean) ** 2) / max(len(values) - 1, 1)
    return mean, float(np.sqrt(max(spread, 1.0) / np.sum(weights)))
