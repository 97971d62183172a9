"""Measured loops and backbones as data of an identification."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy.linalg

from fenics_joints.errors import InputError, located, member
from fenics_joints.harmonic.backbone import NonlinearMode, free_mode, solve_backbone
from fenics_joints.harmonic.balance import Balance
from fenics_joints.harmonic.fourier import basis
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.measurements.amplitude.backbone import MeasuredBackbone
from fenics_joints.measurements.curves import UNITS
from fenics_joints.measurements.tables import read_table

# -- loops -----------------------------------------------------------------------------------------


#: Largest distance of the force's samples from a sine, relative to its amplitude; chosen.
_NO_SINE = 0.1


@dataclass(frozen=True, repr=False)
class MeasuredLoop:
    """Force and response over one cycle or more.

    Attributes:
        frequency_hz: Frequency of the force, Hz.
        times: s, (n,).
        forces: Force, N, (n,).
        responses: Response at one sensor, in SI units, (n,).
        response: ``displacement``, ``velocity`` or ``acceleration``.

    Raises:
        InputError: If there are too few samples, or the force is no sine of that frequency.
    """

    frequency_hz: float
    times: np.ndarray
    forces: np.ndarray
    responses: np.ndarray
    response: str

    def __post_init__(self):
        if self.response not in UNITS:
            raise InputError(f"response = {self.response!r}: expected one of: {', '.join(UNITS)}.")
        sizes = {len(self.times), len(self.forces), len(self.responses)}
        if len(sizes) > 1 or sizes.pop() < 8:
            raise InputError("a loop: expected eight samples or more, as many of each kind.")
        c = self._force()
        apart = self.forces - basis(2 * np.pi * self.frequency_hz * self.times, 3) @ c
        if not self.level > 0 or np.abs(apart).max() > _NO_SINE * self.level:
            raise InputError(
                f"a loop at {self.frequency_hz:g} Hz: its force is no sine of that frequency; "
                "expected one."
            )

    def __repr__(self) -> str:
        return f"MeasuredLoop({len(self.times)} samples at {self.frequency_hz:g} Hz)"

    def _force(self) -> np.ndarray:
        """Mean, cosine and sine of the force, N, (3,)."""
        angles = 2 * np.pi * self.frequency_hz * self.times
        return np.linalg.lstsq(basis(angles, 3), self.forces, rcond=None)[0]

    @property
    def level(self) -> float:
        """Amplitude of the force, N."""
        return float(np.hypot(*self._force()[1:]))

    def angles(self) -> np.ndarray:
        """Angles at which the force is level * cos(angle), (n,)."""
        _, cosine, sine = self._force()
        return 2 * np.pi * self.frequency_hz * self.times - np.arctan2(sine, cosine)


def read_loops(path: str | Path, response: str) -> tuple[MeasuredLoop, ...]:
    """Read loops from a table: ``frequency``, ``time``, ``force`` and ``response``.

    Units stand in the columns' heads, such as ``time [s]``. Rows of the same frequency are one
    loop.

    Args:
        path: CSV or TOML, as `read_table` reads them.
        response: ``displacement``, ``velocity`` or ``acceleration``.

    Raises:
        InputError: Names the file, the column, and what was expected.
    """
    member("response", response, UNITS)
    table = read_table(path)
    units = {"time": "s", "force": "N", "response": UNITS[response]}
    hz, columns = table.numbers("frequency", "Hz"), [table.numbers(*one) for one in units.items()]
    found = []
    for frequency in np.unique(hz):
        times, forces, responses = (column[hz == frequency] for column in columns)
        with located(path):
            found.append(MeasuredLoop(float(frequency), times, forces, responses, response))
    return tuple(found)


# -- backbones -------------------------------------------------------------------------------------


#: Standard deviations of the model's errors at rest: of its frequency, relative, and of its damping
#: ratio, relative to the lowest one measured; chosen.
_AT_REST, _AT_REST_DAMPING = 0.01, 1.0


@dataclass(frozen=True)
class Offset:
    """Error of the model at rest, the same at all amplitudes, and its standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True, eq=False)
class ModeData:
    """Frequencies and damping over amplitude; a residual for each, in shares of ``noise``.

    The law is in how they change: frequencies are compared up to a factor and damping up to a
    constant, which the model at rest may be off (``rest``, ``rest_damping``, standard deviations),
    so that their covariance is that of the noise and of one common error. ``widths`` are how much
    larger than stated the deviations are taken, of frequencies and of damping, each of its own.

    Attributes:
        measured: The backbone, its amplitudes not of force.
        sensor: The sensor's name.
        noise: What one standard deviation counts.
        rest: Relative.
        rest_damping: Absolute.
        widths: 1 or more.
    """

    measured: MeasuredBackbone
    sensor: str
    noise: float
    rest: float = _AT_REST
    rest_damping: float = 0.0
    widths: tuple[float, float] = (1.0, 1.0)

    def __len__(self) -> int:
        return len(self.measured) + int(self._damped.sum())

    @property
    def level(self) -> float:
        """The highest amplitude."""
        return float(self.measured.amplitudes[-1])

    @property
    def displacements(self) -> np.ndarray:
        """Amplitudes as displacements, m, (n,)."""
        return self.measured.displacements

    @property
    def _damped(self) -> np.ndarray:
        return np.isfinite(self.measured.damping)

    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower Cholesky factors of the covariances of ln f and of the damping ratios."""
        m, d = self.measured, self._damped
        parts = (
            (m.frequencies_sd / m.frequencies_hz, self.widths[0], self.rest),
            (m.damping_sd[d], self.widths[1], self.rest_damping),
        )
        # A deviation far below the common error would be lost in round-off.
        wide = [(np.maximum(width * sd, 1e-5 * common), common) for sd, width, common in parts]
        return tuple(np.linalg.cholesky(np.diag(sd**2) + common**2) for sd, common in wide)

    def solve(self, model: InterfaceModel, force: str, options, warm) -> NonlinearMode:
        """The model's mode at the measured amplitudes."""
        return solve_backbone(
            model,
            at=self.displacements,
            sensor=self.sensor,
            near=float(self.measured.frequencies_hz[0]),
            initial=warm,
            **options,
        )

    def apart(self, found: NonlinearMode) -> tuple[np.ndarray, np.ndarray]:
        """ln of the model's frequency over the measured one, and its damping less the measured."""
        m, d = self.measured, self._damped
        return (
            np.log(found.frequencies_hz / m.frequencies_hz),
            found.damping_ratios[d] - m.damping[d],
        )

    def residual(self, found: NonlinearMode) -> np.ndarray:
        """Whitened, times ``noise``, (len,)."""
        return self.noise * self._whitened(*self.apart(found))

    def jacobian(self, found: NonlinearMode, change, values) -> np.ndarray:
        """Derivatives of the residual by the parameters, (len, parameters)."""
        hz, damping = found.by_parameters(change, values)
        ln_f = hz / found.frequencies_hz[:, None]
        return self.noise * self._whitened(ln_f, damping[self._damped])

    def _whitened(self, ln_f: np.ndarray, damping: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [
                scipy.linalg.solve_triangular(factor, part, lower=True) if len(part) else part
                for factor, part in zip(self._factors(), (ln_f, damping), strict=True)
            ]
        )

    def objective(self, residual: np.ndarray) -> float:
        """The sum of the residuals' sizes: one standard deviation counts ``noise``."""
        return float(np.abs(residual).sum())

    def widened(self, residual: np.ndarray, taken: int) -> ModeData:
        """With the deviations that the residuals have, if those are larger than stated.

        Args:
            residual: At the present widths.
            taken: Numbers that these data determined, shared out by their count.
        """
        n, scores = len(self.measured), residual / self.noise
        widths = []
        for part, width in zip((scores[:n], scores[n:]), self.widths, strict=True):
            free = max(len(part) * (1 - (taken + 2) / max(len(scores), 1)), 1.0)
            widths.append(max(1.0, width * float(np.sqrt(part @ part / free))))
        return replace(self, widths=tuple(widths))

    def offsets(self, found: NonlinearMode) -> dict[str, Offset]:
        """Errors of the model at rest: of the frequency, relative, and of the damping ratio."""
        names = ("frequency at rest", "damping at rest")
        priors = (self.rest, self.rest_damping)
        m, d = self.measured, self._damped
        deviations = (
            self.widths[0] * m.frequencies_sd / m.frequencies_hz,
            self.widths[1] * m.damping_sd[d],
        )
        made = {}
        for name, prior, sd, r in zip(names, priors, deviations, self.apart(found), strict=True):
            if prior > 0 and len(r):
                precision = np.sum(1 / sd**2) + 1 / prior**2
                made[name] = Offset(float(-np.sum(r / sd**2) / precision), float(precision**-0.5))
        return made

    @staticmethod
    def of(
        backbone: MeasuredBackbone,
        sensor: str,
        noise: float,
        rest: float | None = None,
        rest_damping: float | None = None,
    ) -> ModeData:
        """Data with the usual errors at rest where none are given.

        Raises:
            InputError: If there are fewer than two points.
        """
        if len(backbone) < 2:
            raise InputError("the backbone has one point; expected two or more amplitudes.")
        if rest_damping is None:
            there = backbone.damping[backbone.damping > 0]
            rest_damping = _AT_REST_DAMPING * float(there.min()) if len(there) else 0.0
        return ModeData(backbone, sensor, noise, _AT_REST if rest is None else rest, rest_damping)


def as_motion(
    backbone: MeasuredBackbone, model: InterfaceModel, force: str, sensor: str
) -> MeasuredBackbone:
    """A backbone whose amplitudes are of the response, also one by the force at resonance.

    There the force is opposed by the damping alone: x = F phi_f phi_s / (2 zeta w^2), with the
    model's shape phi at rest.

    Raises:
        InputError: If damping is missing at a level of force, or the force does not drive the mode.
    """
    if backbone.response != "force":
        return backbone
    if not np.all(backbone.damping > 0):
        raise InputError(
            "the backbone is by level of force: expected damping at each level too, which says the "
            "response"
        )
    shape = free_mode(Balance(model, harmonics=1), sensor, float(backbone.frequencies_hz[0])).shape
    share = abs(float(model.row("forces", force) @ shape)) / float(shape @ model.M @ shape)
    if not share > 0:
        raise InputError("the force does not drive the mode; expected another place.")
    squares = (2 * np.pi * backbone.frequencies_hz) ** 2
    x = backbone.amplitudes * share / (2 * backbone.damping * squares)
    return replace(backbone, response="displacement", amplitudes=x)
