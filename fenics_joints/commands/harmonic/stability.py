"""Stability, bifurcations and the branches that leave there, as a case asks for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fenics_joints.errors import ConvergenceError
from fenics_joints.formatting import hertz
from fenics_joints.harmonic import (
    Bifurcation,
    HarmonicResult,
    Stability,
    find_bifurcations,
    switch_branch,
)
from fenics_joints.progress import Progress

#: Kinds at which another branch leaves, and to which sides.
_LEAVES = {"branch point": (1, -1), "period doubling": (1,)}


@dataclass(frozen=True, eq=False)
class LevelStability:
    """Stability of the responses at one level.

    Attributes:
        level: Amplitude of the force, N, or of the base's motion, m/s2 or m.
        stability: Which are stable, and the bifurcations.
        branches: Branches that leave there, with the bifurcation each comes from.
        notes: Branches that could not be followed, in words.
    """

    level: float
    stability: Stability
    branches: tuple[tuple[Bifurcation, HarmonicResult], ...] = ()
    notes: tuple[str, ...] = ()

    def records(self) -> list[dict[str, object]]:
        """Kind, place and displacement of each bifurcation, how many disturbances grow before and
        after, and the branches that leave there, in words."""
        rows = []
        for b in self.stability.bifurcations:
            left = [made.frequencies_hz for at, made in self.branches if at is b]
            rows.append(
                {
                    "kind": b.kind,
                    "after_point": b.index,
                    "frequency_hz": b.frequency_hz,
                    "displacement_m": b.amplitude,
                    "unstable": list(b.unstable),
                    "branch": "; ".join(f"{hertz(f.min())} to {hertz(f.max())} Hz" for f in left),
                }
            )
        return rows

    def to_json(self) -> dict[str, object]:
        """Keys: ``stable``, ``bifurcations`` and ``branches``."""
        found = self.stability.bifurcations
        return {
            "stable": self.stability.stable.tolist(),
            "bifurcations": [
                {key: value for key, value in row.items() if key != "branch"}
                for row in self.records()
            ],
            "branches": [
                {"bifurcation": found.index(at), **made.to_dict()} for at, made in self.branches
            ],
        }


def level_stability(
    wanted: str, responses: Sequence[HarmonicResult], progress: Progress
) -> tuple[LevelStability, ...]:
    """Stability of the responses at every level.

    Args:
        wanted: ``no``, ``find``, or ``follow`` for the branches too.
        responses: One branch for each level.
        progress: Told what is being done.
    """
    if wanted == "no":
        return ()
    made = []
    for response in responses:
        level = float(response.force_amplitudes[0])
        progress.step(f"stability of {len(response)} responses")
        stability = find_bifurcations(response)
        branches, notes = [], []
        for at in stability.bifurcations if wanted == "follow" else ():
            for side in _LEAVES.get(at.kind, ()):
                try:
                    found = switch_branch(response, at, side=side, progress=progress)
                    branches.append((at, found))
                except ConvergenceError as error:
                    notes.append(
                        f"the branch from the {at.kind} at {hertz(at.frequency_hz)} Hz was not "
                        f"followed: {error}"
                    )
        made.append(LevelStability(level, stability, tuple(branches), tuple(notes)))
    return tuple(made)
