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

__all__ = ["ConstitutiveError", "Energies", "constitutive_error", "trust"]

#: Relative error in energy that is taken as lightly as a deviation at the sensors by their noise:
#: shapes are then met to about two thirds of their noise.
_DOUBT = 1e-2
#: Energy per volume, relative to the structure's mean, that a region counts with at least.
_LITTLE = 0.25


@dataclass(frozen=True, repr=False)
class Energies:
    """Errors of some regions or patches, and their strain energy, by measured mode.

    All energies of a mode are relative to its own strain energy in the whole structure.

    Attributes:
        name: Names of the regions, n of them.
        volume: Share of each region in the volume, (n,).
        stiffness: Error of the stiffness of each region, (n, m).
        inertia: Error of its mass, (n, m).
        by_noise: What noise of the shapes alone adds to ``stiffness`` on average.
        strain: Strain energy of each region, (n, m); columns sum to 1.
    """

    name: tuple[str, ...]
    volume: np.ndarray
    stiffness: np.ndarray
    inertia: np.ndarray
    by_noise: np.ndarray
    strain: np.ndarray

    @property
    def relative(self) -> np.ndarray:
        """Error of the stiffness of each region, without what noise alone would make, over its own
        strain energy, all modes together, (n,); below zero where it is less than that.

        A region that is strained little, as a free end is, tells little of its law: it counts with
        a quarter of the structure's mean energy per volume at least.
        """
        own, error = self.strain.sum(axis=1), self.stiffness - self.by_noise
        return error.sum(axis=1) / np.maximum(own, _LITTLE * self.volume * own.sum())

    def rows(self, *keys: str) -> list[dict]:
        """Attributes of each region, in plain numbers and lists."""
        columns = [np.asarray(getattr(self, key)).tolist() for key in keys]
        return [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]


@dataclass(frozen=True, repr=False)
class ConstitutiveError:
    """Error in the constitutive relation, by region and patch and by measured mode.

    Attributes:
        frequencies_hz: Measured frequencies, (m,).
        regions: The regions' energies.
        patches: Those of the patches; empty if not asked for.
        deviation: Root mean square of P u - s over that of s, by mode, (m,).
    """

    frequencies_hz: np.ndarray
    regions: Energies
    patches: Energies
    deviation: np.ndarray

    def __repr__(self) -> str:
        n = len(self.regions.name)
        return f"ConstitutiveError({n} regions, {len(self.frequencies_hz)} modes)"

    @property
    def total(self) -> np.ndarray:
        """Whole error of each mode, (m,)."""
        return self.regions.stiffness.sum(axis=0) + self.regions.inertia.sum(axis=0)

    def to_json(self) -> dict:
        """Plain lists."""
        keys = "name", "relative", "stiffness", "by_noise", "strain"
        return {
            "frequencies_hz": self.frequencies_hz.tolist(),
            "total": self.total.tolist(),
            "deviation": self.deviation.tolist(),
            "regions": self.regions.rows(*keys, "inertia"),
            "patches": self.patches.rows(*keys),
        }


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
    volume = cells.sums(cells.region, cells.volume, len(cells.regions))
    *tables, deviation = zip(*modes, strict=True)
    places = (cells.regions, volume), (split.names, split.volume)
    regions, patches = (
        Energies(names, size / volume.sum(), *np.moveaxis(table, 0, -1))
        for (names, size), table in zip(places, tables, strict=True)
    )
    return ConstitutiveError(hz, regions, patches, np.array(deviation))


def _mode(system, cells: Cells, given, shape, omega, gamma, noise, split, draws):
    """Energies by region and by patch, (4, n) each in the order of `Energies`, and the deviation at
    the sensors, of a measured mode."""
    there = np.isfinite(shape)
    s = np.where(there, shape, 0.0)
    s = s / np.sqrt(np.mean(s[there] ** 2))
    rng = np.random.default_rng(len(s))
    loads = [s, *(noise * there * rng.standard_normal((draws, len(s))))]
    weight = trust(cells.structure.total_mass(given), there, omega, noise)
    fields = system.solve(loads, there, omega, weight)

    def by_cell(x) -> np.ndarray:
        return np.array(cells.energies(x, omega, given))

    u, lam = fields[0]
    motion, error = by_cell(u), by_cell(lam)
    chance = sum((by_cell(field) for _, field in fields[1:]), 0 * error) / max(draws, 1)
    off = (system.read(u) - s)[there]
    system.release(fields)
    # Errors of stiffness and mass, what noise makes of the former, and the strain energy.
    table = np.array([error[0] / gamma, error[1] / (1 - gamma), chance[0] / gamma, motion[0]]).T
    by_region = cells.sums(cells.region, table, len(cells.regions)).T
    by_patch = cells.sums(split.number, table, len(split)).T
    whole = by_region[-1].sum()
    return by_region / whole, by_patch / whole, float(np.sqrt(np.mean(off**2)))


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
