"""Where measured shapes contradict a model: the modified error in the constitutive relation.

For a mode measured at omega with the shape s (sensors P u), the functional (Ladeveze and others;
Deraemaeker, Ladeveze and Leconte, Comput. Methods Appl. Mech. Engrg. 191, 2002, 2427-2444)

    J = gamma (u - v)^T K (u - v) + (1 - gamma) omega^2 (u - w)^T M (u - w) + rho |P u - s|^2,

is made least over u, v, w under equilibrium, K v = omega^2 M w: stresses K v and inertia forces
omega^2 M w that balance exactly, a motion u that is near the sensors, and the laws between them,
which are what is doubted, violated where that costs least. With the multiplier 2 lambda,

    by v:  K lambda = gamma K (u - v),               so v = u - lambda / gamma,
    by w:  M lambda = -(1 - gamma) M (u - w),        so w = u + lambda / (1 - gamma),
    by u:  (K - omega^2 M) lambda + rho P^T P u = rho P^T s,

and equilibrium becomes (K - omega^2 M) u = (K / gamma + omega^2 M / (1 - gamma)) lambda. So two
fields are solved for at once, by one symmetric (indefinite) sparse matrix:

    [ rho P^T P    K - omega^2 M                          ] [   u    ]   [ rho P^T s ]
    [ K - omega^2 M  -(K / gamma + omega^2 M / (1 - gamma)) ] [ lambda ] = [     0     ].

It is regular if the sensors see every mode of the model at omega. A model with the measured mode
has lambda = 0. The error of stiffness is lambda^T K lambda / gamma, that of mass
omega^2 lambda^T M lambda / (1 - gamma): sums over cells, and so over regions and patches. Both
fields are linear in s, so that noise of the shapes adds its own energy to that of the true ones on
the average; it is found from a few draws by the same factorisation, and taken off.

A thin layer that the model has far too stiff shows less of its error than its neighbours do, which
bend where it does not: there the error over the region's own strain energy says more than the
energies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.diagnosis.where.cells import Cells
from fenics_joints.diagnosis.where.patches import Patches
from fenics_joints.errors import InputError
from fenics_joints.structure.points import Sensors

__all__ = ["ConstitutiveError", "constitutive_error", "trust"]

#: Relative error in energy that is taken as lightly as a deviation at the sensors by their noise:
#: shapes are then met to about two thirds of their noise.
_DOUBT = 1e-2
#: Energy per volume, relative to the structure's mean, that a region counts with at least.
_LITTLE = 0.25


@dataclass(frozen=True, repr=False)
class ConstitutiveError:
    """Error in the constitutive relation, by region and patch and by measured mode.

    All energies of a mode are relative to its own strain energy in the whole structure.

    Attributes:
        frequencies_hz: Measured frequencies, (m,).
        regions: Names of the regions.
        stiffness: Error of the stiffness of each region, (n_regions, m).
        inertia: Error of its mass, (n_regions, m).
        by_noise: What noise of the shapes alone adds to ``stiffness`` on average.
        strain: Strain energy of each region, (n_regions, m); columns sum to 1.
        volume: Share of each region in the volume, (n_regions,).
        patches: Names of the patches, if asked for.
        patch_stiffness: As ``stiffness`` by patch, (P, m).
        patch_by_noise: As ``by_noise`` by patch, (P, m).
        patch_strain: As ``strain`` by patch, (P, m).
        patch_volume: As ``volume`` by patch, (P,).
        deviation: Root mean square of P u - s over that of s, by mode, (m,).
    """

    frequencies_hz: np.ndarray
    regions: tuple[str, ...]
    stiffness: np.ndarray
    inertia: np.ndarray
    by_noise: np.ndarray
    strain: np.ndarray
    volume: np.ndarray
    patches: tuple[str, ...]
    patch_stiffness: np.ndarray
    patch_by_noise: np.ndarray
    patch_strain: np.ndarray
    patch_volume: np.ndarray
    deviation: np.ndarray

    def __repr__(self) -> str:
        return f"ConstitutiveError({len(self.regions)} regions, {len(self.frequencies_hz)} modes)"

    @property
    def total(self) -> np.ndarray:
        """Whole error of each mode, (m,)."""
        return self.stiffness.sum(axis=0) + self.inertia.sum(axis=0)

    @property
    def relative(self) -> np.ndarray:
        """Error of the stiffness of each region, without what noise alone would make, over its own
        strain energy, all modes together, (n_regions,); below zero where it is less than that.

        A region that is strained little, as a free end is, tells little of its law: it counts with
        a quarter of the structure's mean energy per volume at least.
        """
        return _over(self.stiffness - self.by_noise, self.strain, self.volume)

    @property
    def patch_relative(self) -> np.ndarray:
        """The same by patch, (P,)."""
        return _over(self.patch_stiffness - self.patch_by_noise, self.patch_strain,
                     self.patch_volume)  # fmt: skip

    def to_json(self) -> dict:
        """Plain lists."""
        regions = {
            "name": self.regions, "relative": self.relative, "stiffness": self.stiffness,
            "inertia": self.inertia, "by_noise": self.by_noise, "strain": self.strain,
        }  # fmt: skip
        patches = {
            "name": self.patches, "relative": self.patch_relative,
            "stiffness": self.patch_stiffness, "by_noise": self.patch_by_noise,
            "strain": self.patch_strain,
        }  # fmt: skip
        return {
            "frequencies_hz": self.frequencies_hz.tolist(),
            "total": self.total.tolist(),
            "deviation": self.deviation.tolist(),
            "regions": _rows(regions),
            "patches": _rows(patches),
        }


def _over(error: np.ndarray, strain: np.ndarray, volume: np.ndarray) -> np.ndarray:
    own = strain.sum(axis=1)
    return error.sum(axis=1) / np.maximum(own, _LITTLE * volume * own.sum())


def _rows(columns: Mapping[str, Sequence]) -> list[dict]:
    """A table's rows, of plain numbers and lists."""
    plain = [np.asarray(values).tolist() for values in columns.values()]
    return [dict(zip(columns, row, strict=True)) for row in zip(*plain, strict=True)]


def constitutive_error(
    cells: Cells,
    given: Mapping[str, float] | None,
    shapes: np.ndarray,
    frequencies_hz: Sequence[float],
    sensors: Sensors,
    *,
    split: Patches | None = None,
    gamma: float = 0.5,
    noise: float = 0.02,
    draws: int = 8,
) -> ConstitutiveError:
    """Where the constitutive laws must be violated for a model to move as measured. Collective.

    Args:
        cells: The cells of the full model.
        given: Values of parameters that differ from their nominal value.
        shapes: Measured shapes, any scale, (n_sensors, m); nan where a sensor was missing.
        frequencies_hz: Measured frequencies, (m,).
        sensors: Where and in which direction they were measured.
        split: Patches to report as well, from `fenics_joints.diagnosis.where.patches.patches`.
        gamma: Doubt of the mass against that of the stiffness, between 0 and 1: near 1 the mass
            is doubted, near 0 the stiffness.
        noise: Standard deviation of the shapes relative to their root mean square. It sets rho:
            a deviation of this size weighs as much as an error of a hundredth of the energy.
        draws: Draws of noise from which its own error is estimated; 0 takes nothing off.

    Raises:
        InputError: If shapes, frequencies and sensors do not agree, or a value is out of range.
        ConvergenceError: If the system is singular: sensors that miss a mode at its frequency.
    """
    shapes, hz = np.asarray(shapes, dtype=float), np.asarray(frequencies_hz, dtype=float)
    _check_measured(shapes, hz, sensors, gamma, noise)
    split = Patches.none(len(cells.volume)) if split is None else split
    system = cells.two_fields(given, sensors, gamma)
    try:
        modes = [
            _mode(system, cells, given, s, omega, gamma, noise, split, draws)
            for s, omega in zip(shapes.T, 2 * np.pi * hz, strict=True)
        ]
    finally:
        system.destroy()
    tables = {key: np.array([mode[key] for mode in modes]).T for key in modes[0]}
    volume = cells.sums(cells.region, cells.volume, len(cells.regions))
    return ConstitutiveError(
        hz, regions=cells.regions, volume=volume / volume.sum(), patches=split.names,
        patch_volume=split.volume / volume.sum(), **tables,
    )  # fmt: skip


def _mode(system, cells: Cells, given, shape, omega, gamma, noise, split, draws) -> dict:
    """Energies by region and patch, and the deviation at the sensors, of a measured mode."""
    there = np.isfinite(shape)
    s = np.where(there, shape, 0.0)
    s = s / np.sqrt(np.mean(s[there] ** 2))
    rng = np.random.default_rng(len(s))
    loads = [s, *(noise * there * rng.standard_normal((draws, len(s))))]
    weight = trust(cells.structure.total_mass(given), there, omega, noise)
    fields = system.solve(loads, there, omega, weight)

    def energies(x) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        stiff, heavy = cells.energies(x, omega, given)
        n = len(cells.regions)
        by_region = (cells.sums(cells.region, values, n) for values in (stiff, heavy))
        return (*by_region, cells.sums(split.number, stiff, len(split)))

    u, lam = fields[0]
    motion, error = energies(u), energies(lam)
    drawn = [energies(field) for _, field in fields[1:]]
    chance = [sum(k) / draws for k in zip(*drawn, strict=True)] or [0 * e for e in error]
    off = (system.read(u) - s)[there]
    system.release(fields)
    whole = motion[0].sum()
    stiff, heavy = 1 / (gamma * whole), 1 / ((1 - gamma) * whole)
    return {
        "stiffness": stiff * error[0],
        "inertia": heavy * error[1],
        "by_noise": stiff * chance[0],
        "strain": motion[0] / whole,
        "patch_stiffness": stiff * error[2],
        "patch_by_noise": stiff * chance[2],
        "patch_strain": motion[2] / whole,
        "deviation": float(np.sqrt(np.mean(off**2))),
    }


def trust(mass: float, there: np.ndarray, omega: float, noise: float) -> float:
    """rho: noise at all sensors weighs as a hundredth of the energy of a motion like s.

    That energy is omega^2 times the modal mass, which is the structure's mass for a motion of root
    mean square 1.

    Args:
        mass: The structure's, kg.
        there: Which sensors measured, (n_sensors,).
        omega: Circular frequency, rad/s.
        noise: See `constitutive_error`.
    """
    return _DOUBT * omega**2 * mass / (noise**2 * float(there.sum()))


def _check_measured(shapes, hz, sensors, gamma, noise) -> None:
    """See `constitutive_error`."""
    if shapes.shape != (len(sensors), len(hz)):
        raise InputError(
            f"shapes has shape {shapes.shape}: expected {(len(sensors), len(hz))}, a row for each "
            "sensor and a column for each frequency."
        )
    if not np.all(hz > 0):
        raise InputError(f"frequencies_hz = {hz.tolist()}: expected numbers above zero.")
    if not np.all(np.any(np.isfinite(shapes) & (shapes != 0), axis=0)):
        raise InputError("shapes: a mode without any motion; expected a finite value in each.")
    for name, value, high in (("gamma", gamma, 1.0), ("noise", noise, np.inf)):
        if not 0 < value < high:
            raise InputError(f"{name} = {value}: expected above 0 and below {high:g}.")
