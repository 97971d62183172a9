"""The points of a branch, and their file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.files import read_arrays, write_arrays


@dataclass(frozen=True, repr=False)
class Branch:
    """Points of a branch, in the order in which they were found.

    Attributes:
        z: Unknowns and, last, the parameter, (points, N + 1).
        tangents: Tangent of the branch at each point, of any length, (points, N + 1).
        iterations: Newton steps that each point took, (points,).
        jacobians: Jacobians that they took, (points,).
        step: Next step, in scaled arc length.
        complete: Whether the branch has reached a bound.
    """

    z: np.ndarray
    tangents: np.ndarray
    iterations: np.ndarray
    jacobians: np.ndarray
    step: float
    complete: bool

    def __len__(self) -> int:
        return len(self.z)

    def __repr__(self) -> str:
        first, last = self.z[0, -1], self.z[-1, -1]
        return f"Branch({len(self)} points, parameter {first:.4g} to {last:.4g})"

    def first(self, n: int) -> Branch:
        """Its first ``n`` points."""
        parts = {name: getattr(self, name)[:n] for name in ("z", "tangents", "iterations")}
        return replace(self, jacobians=self.jacobians[:n], **parts)

    def with_point(self, z, tangent, effort, step: float, complete: bool) -> Branch:
        """The branch with one more point; effort: (Newton steps, Jacobians)."""
        longer = self.with_inserted(len(self), z, tangent, effort)
        return replace(longer, step=step, complete=complete)

    def with_inserted(self, i: int, z, tangent, effort) -> Branch:
        """The branch with a new point ``i``."""
        return replace(
            self,
            z=np.insert(self.z, i, z, axis=0),
            tangents=np.insert(self.tangents, i, tangent, axis=0),
            iterations=np.insert(self.iterations, i, effort[0]),
            jacobians=np.insert(self.jacobians, i, effort[1]),
        )


def save_branch(path: str | Path, branch: Branch, name: str = "") -> None:
    """Write a branch (npz) through a temporary sibling, so that no reader sees a part of it.

    Args:
        path: The file.
        branch: The branch.
        name: What it is a branch of.

    Raises:
        InputError: If the file cannot be written.
    """
    write_arrays(path, **vars(branch), name=name)


def load_branch(path: str | Path, name: str = "") -> Branch | None:
    """A branch from its file; None if there is no such file.

    Raises:
        InputError: If the file is not one of a branch of that name: a branch may be hours of work,
            so it is not replaced unasked.
    """
    path = Path(path)
    if not path.exists():
        return None
    anew = "made by another version or damaged: delete it to compute the branch anew"
    try:
        stored = read_arrays(path)
    except InputError as error:
        raise InputError(f"{error}; {anew}") from error
    try:
        found = str(stored.pop("name"))
        branch = Branch(**{key: value[()] for key, value in stored.items()})
    except (KeyError, TypeError) as error:
        raise InputError(f"{path}: holds no branch ({error}); {anew}") from error
    if found != name:
        raise InputError(
            f"{path}: holds a branch of {found!r}, expected {name!r}; delete it or choose another "
            "file."
        )
    return branch
