"""A model's counterpart of a test's data, and its derivatives by the parameters.

FRF lines may be taken where the model has what the test has there. A line between two resonances of
the test is moved to the same place, in ln f, between the model's two:

    ln f' = ln f + sum_j B_j(f) (ln f_j,model - ln f_j,test),

B piecewise linear in ln f, constant outside. Resonance then meets resonance, however far the model
is off, and the FRFs differ by their shape alone: the differences at one and the same frequency jump
by the height of a peak when a resonance slips across a line, which is why updating on them is badly
behaved (Lin and Ewins, Mech. Syst. Signal Process. 8, 1994; Grafe, Model updating of large
structural dynamics models using measured response functions, Imperial College, 1998, who compares
FRFs over a shifted frequency).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError, whole
from fenics_joints.measurements import Pairing, Target, pair_modes
from fenics_joints.modal import Modes, frequency_sensitivity, solve_modes
from fenics_joints.response import shape_gradients, solve_frf
from fenics_joints.response.complex_modes import damping_ratios
from fenics_joints.response.units import KINDS
from fenics_joints.structure.damping import Damping

#: Modes beyond those of the test, so that none is missed when modes change places; chosen.
_SPARE = 4
#: Modes of a full model reach this multiple of the highest FRF line; chosen: residual vectors stand
#: for the rest.
_REACH = 1.5
#: Most modes among which the test's are sought, as a multiple of the usual number; chosen.
_SEARCHED = 4
#: Relative step of a line for the FRF's slope by frequency: small beside a resonance's width.
_STEP = 1e-5
#: Damping ratio below which a mode counts as undamped: round-off.
_UNDAMPED = 1e-12


@dataclass(frozen=True, eq=False, repr=False)
class Prediction:
    """The model's counterpart of a `Target` at values of the parameters.

    Slopes are by the p parameters of the fit, per unit of their values.

    Attributes:
        frequencies_hz: Of the paired modes, Hz, (m,).
        frequency_slopes: d ln f / dp, (m, p).
        pairs: Index of each test mode's among the model's, (m,); None without frequencies or shapes
            of a test.
        mac: MAC of each pair, (m,); None without shapes.
        shapes: Mass-normalised shapes at the shape sensors, (n_s, m); None without sensors.
        shape_slopes: (n_s, m, p); None unless shapes are data.
        damping_ratios: (m,); None unless they are data.
        damping_slopes: d zeta / dp, (m, p).
        lines_hz: Where the FRFs are taken, Hz, (n_f,): the test's lines, or moved ones.
        frfs: (n_f, n_sensors, n_excitations); None unless they are data.
        frf_slopes: Total derivatives, with what the lines' moving does, (..., p).
        frf_by_line: d H / d ln f' at the lines; None unless they are moved.
    """

    frequencies_hz: np.ndarray
    frequency_slopes: np.ndarray
    mac: np.ndarray | None = None
    shapes: np.ndarray | None = None
    shape_slopes: np.ndarray | None = None
    damping_ratios: np.ndarray | None = None
    damping_slopes: np.ndarray | None = None
    lines_hz: np.ndarray | None = None
    frfs: np.ndarray | None = None
    frf_slopes: np.ndarray | None = None
    frf_by_line: np.ndarray | None = None
    pairs: np.ndarray | None = None

    def __repr__(self) -> str:
        frequencies = ", ".join(f"{f:.5g}" for f in self.frequencies_hz[:6])
        lines = "" if self.lines_hz is None else f", FRFs at {len(self.lines_hz)} lines"
        return f"Prediction({frequencies or 'no'} Hz{lines})"


class Predictor:
    """Predictions of a model for a target. Collective for a full model.

    Args:
        model: A `Structure`, whose FRFs are found by modes with residual vectors; or a reduced one,
            `ReducedStructure` or `ArrayModel`, that was made for the target's sensors.
        target: The data.
        names: The parameters by which derivatives are wanted.
        fixed: Values of the model's other parameters that differ from their nominal ones.
        damping: The damping; its numbers may be parameters of the model.
        n_modes: Modes to compute, rigid-body ones included; more where they are too few.

    Attributes:
        calls: Number of sets of values that were computed.
        follows: Whether modes are paired by the shapes last given to `follow`, not by the test's.
        moves: B, the share of each mode's slip by which each line moves, (n_f, m).
    """

    def __init__(
        self,
        model,
        target: Target,
        names: Sequence[str],
        fixed: Mapping[str, float] | None = None,
        *,
        damping: Damping | None = None,
        n_modes: int | None = None,
    ):
        if n_modes is not None:
            whole("n_modes", n_modes)
        self.model, self.target, self.fixed = model, target, dict(fixed or {})
        self.damping = damping or Damping()
        self.n_modes = n_modes or 6 + len(target) + _SPARE
        self.most = max(self.n_modes, _SEARCHED * (6 + len(target) + _SPARE))
        position = list(model.parameters)
        self.columns = [position.index(name) for name in names]
        self.moves = None if target.frfs is None else self._moves()
        self.calls, self._solver = 0, None
        self._last: dict[tuple, Prediction] = {}
        self._follows, self._followed = False, None

    @property
    def follows(self) -> bool:
        return self._follows

    @follows.setter
    def follows(self, on: bool) -> None:
        self._follows, self._followed = on, None
        self._last.clear()

    def follow(self, found: Prediction) -> None:
        """From now on modes are those that are most like the ones of a prediction."""
        self._followed = found.shapes

    def __call__(self, values: Mapping[str, float], moved: bool = False) -> Prediction:
        """The prediction at values of the parameters, at the test's lines or at ``moved`` ones.

        Raises:
            InputError: If the model refuses the values, or has too few modes that the test could
                see.
            ConvergenceError: If modes or FRFs were not found.
        """
        given = {**self.fixed, **values}
        key = moved, *given.values()
        if key not in self._last:
            if len(self._last) > 3:
                self._last.clear()
            self._last[key] = self._predict(given, moved)
            self.calls += 1
        return self._last[key]

    def _predict(self, given, moved: bool) -> Prediction:
        target = self.target
        modes, pairing = self._modes(given)
        found = {
            "frequencies_hz": np.empty(0),
            "frequency_slopes": np.empty((0, len(self.columns))),
        }
        if len(target):
            found["frequencies_hz"] = modes.frequencies_hz[pairing.index]
            slopes = frequency_sensitivity(modes, pairing.index)
            found["frequency_slopes"] = slopes[:, self.columns]
            found |= {"mac": pairing.mac, "shapes": pairing.shapes, "pairs": pairing.index}
        if "shapes" in target.kinds:
            slopes = shape_gradients(modes, pairing.index, target.shape_sensors)
            found["shape_slopes"] = np.asarray(slopes)[..., self.columns]
        if "damping" in target.kinds:
            found |= self._damping(modes, pairing, given)
        if target.frfs is not None:
            found |= self._frfs(modes, given, found if moved else None)
        return Prediction(**found)

    # -- modes ---------------------------------------------------------------------------------

    def _modes(self, given) -> tuple[Modes, Pairing | None]:
        """Modes and their pairing; more modes where a soft joint puts others between the test's."""
        target, spare = self.target, len(self.target) + _SPARE
        while True:
            count = min(self.n_modes, self.model.n_dofs)
            modes = solve_modes(self.model, given, n_modes=count, solver=self._solver)
            self._solver = modes.solver
            last = count >= min(self.most, self.model.n_dofs)
            if not last and not self._reaches(modes):
                self._more(spare)
                continue
            if not len(target):
                return modes, None
            try:
                return modes, pair_modes(
                    modes, len(target), target.shape_sensors, reference=self._reference()
                )
            except InputError:
                if last:
                    raise
                self._more(spare)

    def modes(self, values: Mapping[str, float]) -> tuple[Modes, Pairing]:
        """The model's modes at values of the parameters, and their pairing with the test's."""
        return self._modes({**self.fixed, **values})

    def _reference(self) -> np.ndarray | None:
        """Shapes by which modes are paired."""
        return self.target.shapes if self._followed is None else self._followed

    def _more(self, spare: int) -> None:
        if self._solver is not None:
            self._solver.destroy()
        self.n_modes, self._solver = self.n_modes + spare, None

    def _reaches(self, modes: Modes) -> bool:
        """Whether the modes reach beyond the FRFs' lines; those of a reduced model need not."""
        if self.target.frfs is None or self.model.is_dense:
            return True
        return modes.frequencies_hz[-1] >= _REACH * self.target.frfs.frequencies_hz.max()

    def _damping(self, modes: Modes, pairing: Pairing, given) -> dict[str, np.ndarray]:
        ratios, slopes = damping_ratios(
            self.model, given, self.damping, modes, pairing.index, gradients=True
        )
        none = np.isfinite(self.target.damping_ratios) & (ratios < _UNDAMPED)
        if none.any():
            raise InputError(
                f"damping_ratios: the model's mode {int(np.argmax(none)) + 1} of the test has no "
                "damping; expected some of every mode whose ratio was measured"
            )
        return {"damping_ratios": ratios, "damping_slopes": slopes[:, self.columns]}

    # -- FRFs ----------------------------------------------------------------------------------

    def _moves(self) -> np.ndarray:
        """B of the module's docstring: hat functions over the test's ln f."""
        lines, f = self.target.frfs.frequencies_hz, self.target.frequencies_hz
        moves, known = np.zeros((len(lines), len(f))), np.flatnonzero(np.isfinite(f))
        known = known[np.argsort(f[known])]
        for j in known:
            moves[:, j] = np.interp(np.log(lines), np.log(f[known]), (known == j).astype(float))
        return moves

    def _frfs(self, modes: Modes, given, paired: dict | None) -> dict[str, np.ndarray]:
        """FRFs at the test's lines, or at lines moved with the paired frequencies."""
        lines = self.target.frfs.frequencies_hz
        if paired is not None and self.moves.any():
            slip = np.log(paired["frequencies_hz"]) - np.log(self.target.frequencies_hz)
            lines = lines * np.exp(self.moves @ np.where(self.moves.any(axis=0), slip, 0.0))
        else:
            paired = None
        values, slopes, by_line = self._response(modes, given, lines, paired is not None)
        if paired is not None:
            by_parameter = self.moves @ paired["frequency_slopes"]
            slopes = slopes + by_line[..., None] * by_parameter[:, None, None, :]
        return {"lines_hz": lines, "frfs": values, "frf_slopes": slopes, "frf_by_line": by_line}

    def _response(self, modes: Modes, given, lines, by_line: bool) -> tuple:
        """H, dH/dp at fixed lines and, if asked for, dH / d ln f."""
        frfs = self.target.frfs
        common = {
            "excitation": frfs.excitation,
            "sensors": frfs.sensors,
            "damping": self.damping,
            "kind": frfs.kind,
        }
        found = solve_frf(
            self.model,
            given,
            frequencies_hz=lines,
            gradients=True,
            method="modal",
            modes=modes,
            check=0,
            **common,
        )
        slopes = found.gradients[..., self.columns]
        if not by_line:
            return found.values, slopes, None
        beside = np.concatenate([lines * (1 + _STEP), lines * (1 - _STEP)])
        loads, reads = (
            found.modal.project(self.model.loads(at)) for at in (frfs.excitation, frfs.sensors)
        )
        values = found.modal.response(beside, loads, reads).values
        values = values * ((2j * np.pi * beside) ** KINDS[frfs.kind])[:, None, None]
        up, down = np.split(values, 2)
        return found.values, slopes, (up - down) / (2 * _STEP)
