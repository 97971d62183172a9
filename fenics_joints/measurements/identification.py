"""Modes of a structure from its measured frequency response functions.

Poles are estimated by the least-squares complex frequency method (LSCF) of sdypy-EMA over rising
orders of the model. From the stable poles starts a non-linear least-squares fit of all functions
with residues of rank one, which removes the method's bias under noise and gives a covariance. Modes
that the method missed, such as close or repeated ones, show in the residual of that fit.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fenics_joints.errors import InputError, real, reals, wanted, whole
from fenics_joints.formatting import first_of
from fenics_joints.measurements.data import TestData
from fenics_joints.measurements.frfs import MeasuredFRFs
from fenics_joints.measurements.poles import FRFColumns, ModeFit
from fenics_joints.measurements.selection import select_modes
from fenics_joints.response.units import KINDS

#: Share of a shape's square below which a sensor stands still in a mode and links no sets.
_STILL = 1e-6
#: Most names in a message.
_NAMED = 6


class Links:
    """Links that put all sensors of a test on one scale.

    Functions that share a sensor or a force, directly or through others, form a set, in which
    residues A_ij = a_i b_j determine all ratios. By reciprocity a_i of one set and b_j of another
    (or the same, at a driving point) are of one degree of freedom, which determines the product of
    both sets' scales. Ratios of scales follow over an even number of such products, a scale itself
    over an odd one.

    Attributes:
        rows: Set of each response, shape (n_responses,).
        columns: Set of each reference, shape (n_references,).
    """

    def __init__(self, data: MeasuredFRFs):
        self.there = data.measured
        n, k = self.there.shape
        i, j = np.nonzero(self.there)
        graph = coo_array((np.ones(len(i)), (i, n + j)), shape=(n + k, n + k))
        sets = connected_components(graph, directed=False)[1]
        self.measured = self.there.any(axis=1)
        self.rows, self.columns = sets[:n], sets[n:]
        self.pairs: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
        for i, j, sign in data.same_dofs():
            a, b = int(self.rows[i]), int(self.columns[j])
            if self.measured[i] and self.there[:, j].any():
                self.pairs.setdefault((a, b), []).append((i, j, sign))
        own = [a for a, b in self.pairs if a == b]
        self.root = own[0] if own else int(self.columns[0])
        #: (set, sign), the pair of sets that leads to it, and from where.
        self.chain = [((self.root, 1), None, None)]
        for at, _, _ in self.chain:
            reached = {one for one, _, _ in self.chain}
            for a, b in self.pairs:
                for here, there in ((a, b), (b, a)):
                    to = (there, -at[1])
                    if here == at[0] and to not in reached:
                        reached.add(to)
                        self.chain.append((to, (a, b), at))
        self._check(data)

    def _check(self, data: MeasuredFRFs) -> None:
        reached = {one for (one, sign), _, _ in self.chain if sign > 0}
        lost = [one for one in np.unique(self.columns) if one not in reached]
        if lost:
            responses, references = np.array(data.response_names), np.array(data.reference_names)
            texts = [
                f"responses {first_of(responses[self.rows == one], _NAMED)} by references "
                f"{first_of(references[self.columns == one], _NAMED)}"
                for one in (self.root, *lost)
            ]
            raise InputError(
                f"the FRFs form sets without a common sensor or force: {'; '.join(texts)}; "
                "the scale and sign between their shapes are unknown. Expected a sensor, or a "
                "place of the force, that is in both sets, or FRFs of one set only"
            )

    @property
    def scaled(self) -> bool:
        """Whether driving points give the modal mass."""
        return (self.root, -1) in {one for one, _, _ in self.chain}

    def shapes(
        self, a: np.ndarray, b: np.ndarray, poles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Shapes of unit length, as real as they can be turned, and factors to unit modal mass.

        A residue is A_ij = phi_i phi_j / (2 i w_d) of a mass-normalised real mode (Ewins, Modal
        Testing, 2nd ed., 2.5).

        Args:
            a: At responses, shape (..., n_responses, m).
            b: At references, shape (..., n_references, m).
            poles: rad/s, shape (m,).

        Returns:
            The shapes, (..., n_responses, m), nan where nothing was measured or the mode stands
            still at every link; and the factors, (..., m), nan where they are unknown.
        """
        values = {(self.root, 1): np.ones(a.shape[:-2] + a.shape[-1:], dtype=complex)}
        for to, pair, start in self.chain[1:]:
            values[to] = self._product(a, b, poles, pair) / values[start]
        shape = np.full(a.shape, np.nan, dtype=complex)
        for one in np.unique(self.columns):
            at = (self.rows == one) & self.measured
            shape[..., at, :] = values[one, 1][..., None, :] * a[..., at, :]
        square = np.nansum(shape**2, axis=-2)
        # Turning a shape by an angle turns its sum of squares by twice the angle.
        turn = np.exp(0.5j * np.angle(square))
        turn = turn * np.sqrt(np.nansum(np.abs(shape) ** 2, axis=-2))
        mass = values.get((self.root, -1), np.full(turn.shape, np.nan)) * turn**2
        with np.errstate(invalid="ignore"):
            factor = np.sqrt(np.where(mass.real > 0, mass.real, np.nan))
        return shape / turn[..., None, :], factor

    def _product(self, a, b, poles, pair) -> np.ndarray:
        """Product of the scales of two sets, from all places that link them."""
        above, below = 0.0, 0.0
        for i, j, sign in self.pairs[pair]:
            above = above + sign * b[..., j, :] * a[..., i, :].conj()
            below = below + np.abs(a[..., i, :]) ** 2
        own = (np.abs(a[..., self.rows == pair[0], :]) ** 2).sum(axis=-2)
        found = 2j * poles.imag * above / np.where(below > 0, below, 1.0)
        return np.where(below > _STILL * own, found, np.nan)


# -- modes -----------------------------------------------------------------------------------------


#: Part of the band that is put before it when it is moved to begin near 0 Hz.
_MARGIN = 0.1
#: Relative changes of frequency and damping from order to order within which a pole is stable.
_STABLE_F, _STABLE_DAMPING = 2e-3, 0.1
#: Part of the orders in which a pole must be stable to be taken for a mode.
_STAYS = 0.4
#: Draws of the residues, from which the shapes' deviations are known to 9 %.
_DRAWS = 64
#: Phase collinearity below which a mode is doubtful.
_MIXED = 0.8


@dataclass(frozen=True, eq=False)
class StabilisationDiagram:
    """What a stabilisation diagram shows: poles of models of rising order, n of them in all.

    Attributes:
        order: Number of modes of the model, shape (n,).
        frequencies_hz: Shape (n,).
        damping: Ratios, shape (n,).
        stable_frequency: Whether a model of one mode less has that frequency, within 0.2 %, (n,).
        stable: Whether it has that damping too, within 10 %, shape (n,).
    """

    order: np.ndarray
    frequencies_hz: np.ndarray
    damping: np.ndarray
    stable_frequency: np.ndarray
    stable: np.ndarray

    def __repr__(self) -> str:
        return f"StabilisationDiagram({len(self.order)} poles, {max(self.order, default=0)} orders)"


@dataclass(frozen=True, eq=False)
class IdentifiedModes:
    """Modes identified from measured functions, m of them, with their standard deviations.

    The deviations are those that the residual of the fit allows, coloured as it is over frequency;
    how a test repeats itself from day to day is not in them.

    Attributes:
        frequencies_hz: Undamped natural frequencies |pole| / 2 pi, shape (m,), ascending.
        damping: Ratios, shape (m,).
        frequencies_sd: Hz, shape (m,).
        damping_sd: Shape (m,).
        shapes: Real shapes at the responses of ``frfs``, shape (n_responses, m); mass-normalised,
            1/sqrt(kg), where a driving point was measured, or else of largest component 1.
        shapes_sd: Of a component, in its unit, shape (n_responses, m).
        phase_collinearity: 1 for a real mode, towards 0 for a complex one, shape (m,).
        mass_normalised: Whether the scale of the shapes is that of the modal mass.
        scatter: Relative standard deviations, over the orders, of the stable poles' frequency and
            damping, shape (m, 2); nan where no pole is stable.
        residual: Root mean square of measured minus fitted, relative to measured.
        poles: All poles of all orders.
        frfs: The functions, in the band; forces and responses may be exchanged.
        notes: Doubts about the result, in sentences.
    """

    frequencies_hz: np.ndarray
    damping: np.ndarray
    frequencies_sd: np.ndarray
    damping_sd: np.ndarray
    shapes: np.ndarray
    shapes_sd: np.ndarray
    phase_collinearity: np.ndarray
    mass_normalised: bool
    scatter: np.ndarray
    residual: float
    poles: StabilisationDiagram
    frfs: MeasuredFRFs
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        low, high = self.frequencies_hz.min(), self.frequencies_hz.max()
        return f"IdentifiedModes({len(self.damping)} modes, {low:.4g} to {high:.4g} Hz)"

    def test_data(
        self,
        names: Sequence[str] | None = None,
        condition: float = 1.0,
        condition_name: str = "row",
        noise: Sequence[float] | float = 0.0,
    ) -> TestData:
        """The modes as a test of one condition, for updating and diagnosis. Needs DOLFINx.

        Args:
            names: Of the modes; ``mode 1`` and so on by default.
            condition: Such as the torque.
            condition_name: What it is.
            noise: Relative standard deviation of a frequency from test to test, of all or each
                mode, which the fit cannot know; it is added to that of the fit, in squares.

        Raises:
            InputError: If the names do not fit.
        """
        rms = np.sqrt(np.nanmean(self.shapes**2, axis=0))
        return TestData.of_modes(
            self.frequencies_hz,
            names,
            condition,
            condition_name,
            damping=self.damping[None],
            noise=np.hypot(self.frequencies_sd / self.frequencies_hz, noise),
            sensors=self.frfs.sensors(),
            shapes=self.shapes,
            damping_noise=float(np.sqrt(np.mean((self.damping_sd / self.damping) ** 2))),
            shape_noise=float(np.sqrt(np.nanmean((self.shapes_sd / rms) ** 2))),
            notes=self.notes,
        )


def identify_modes(
    frfs: MeasuredFRFs,
    *,
    near: Sequence[float] | None = None,
    band: tuple[float, float] | None = None,
    order: int = 30,
    max_damping: float = 0.1,
    exponential_window: float | None = None,
) -> IdentifiedModes:
    """Identify the modes in a band.

    Where forces stood at more places than sensors, as with a roving hammer, the shapes are those at
    the forces, by reciprocity (H_ij = H_ji): ``frfs`` of the result has the two exchanged. A pair
    of modes at one frequency is separated by two references or more, never by one.

    Args:
        frfs: Measured functions; evenly spaced lines.
        near: About where the frequencies are, Hz, one for each mode; by default the modes are the
            poles that are stable in many orders.
        band: Hz, that of the data by default.
        order: Highest number of modes of a model; a few times that of the modes in the band.
        max_damping: Ratio above which a pole is none of a mode.
        exponential_window: Time, s, in which the analyser's exponential window falls to 1/e; the
        damping that it adds, 1 / (2 pi f time), is subtracted. By default there was none.

    Raises:
        InputError: If sdypy-EMA is missing, the lines are unevenly spaced or too few, no pole is
            stable or none near an asked frequency, functions have nothing in common, or the
            window has more damping than the modes.
    """
    if not isinstance(frfs, MeasuredFRFs):
        raise wanted("frfs", frfs, "MeasuredFRFs, as read_frfs gives them")
    whole("order", order, 2)
    real("max_damping", max_damping, above=0.0, most=1.0)
    if exponential_window is not None:
        real("exponential_window", exponential_window, "s", above=0.0)
    if near is not None and not len(reals("near", near, (None,), "Hz", above=0.0)):
        raise wanted("near", near, "the frequency of a mode at least, or None")
    low, high = (0.0, np.inf) if band is None else reals("band", band, (2,), "Hz", least=0.0)
    data = frfs.band(max(low, np.nextafter(0.0, 1.0)), high)
    used = np.flatnonzero(data.measured.any(axis=0))
    data = data.select(references=[data.reference_names[j] for j in used])
    if data.values.shape[2] > data.values.shape[1]:
        data = data.reciprocal()
    rows, columns = np.nonzero(data.measured)
    values = data.values[:, rows, columns]
    if not values.any(axis=0).all():
        k = int(np.argmin(values.any(axis=0)))
        raise InputError(
            f"the FRF of {data.response_names[rows[k]]} by "
            f"{data.reference_names[columns[k]]} is zero in the band; expected measured values"
        )
    links = Links(data)
    functions = FRFColumns(
        data.frequencies_hz,
        values,
        rows,
        columns,
        KINDS[data.kind],
        links.columns,
        data.values.shape[1],
    )
    poles = _diagram(_lscf(data, values.T, order), data, max_damping)
    groups = _groups(poles, order)
    start = np.array([_pole(poles, group) for group in groups])
    fit, notes = select_modes(functions, start, max_damping, data.response_names)
    inside = np.zeros(0, dtype=int) if fit is None else _inside(fit, data)
    if not len(inside):
        raise InputError(
            f"no pole is stable between {data.frequencies_hz[0]:g} and {data.frequencies_hz[-1]:g} "
            f"Hz in models of up to {order} modes, damped below {max_damping:g}; expected another "
            "band, order or max_damping, or better data"
        )
    chosen = inside if near is None else inside[_nearest(fit.frequencies_hz[inside], near)]
    return _modes(data, links, fit, poles, chosen, notes, exponential_window)


# -- poles -----------------------------------------------------------------------------------------


def _lscf(data: MeasuredFRFs, measured: np.ndarray, order: int) -> list[np.ndarray]:
    """Poles, rad/s, of models of 1 to ``order`` modes.

    The band is moved to begin near 0 Hz: a model with real coefficients is badly conditioned in a
    narrow band far up, and the functions of a band are rational wherever it is put.
    """
    f = data.frequencies_hz
    if len(f) < 4 * order:
        raise InputError(
            f"order = {order}: expected at most {len(f) // 4}, a quarter of the {len(f)} lines in "
            "the band"
        )
    step = (f[-1] - f[0]) / (len(f) - 1)
    if np.abs(np.diff(f) - step).max() > 0.02 * step + 2e-5 * f[-1]:
        raise InputError("frequencies_hz: expected evenly spaced lines for the identification")
    before = int(_MARGIN * len(f)) + 1
    # The model leaves the last line out.
    moved = np.zeros((len(measured), before + len(f) + 1), dtype=complex)
    moved[:, before:-1] = measured / np.linalg.norm(measured, axis=1, keepdims=True)
    grid = step * np.arange(moved.shape[1])
    model = _ema().Model(
        moved,
        grid,
        lower=grid[before],
        upper=grid[-1],
        pol_order_high=int(order),
        frf_form=data.kind,
    )
    model.get_poles(method="lscf", show_progress=False)
    offset = 2j * np.pi * (f[0] - grid[before])
    return [np.asarray(p)[np.imag(p) > 0] + offset for p in model.all_poles]


def _ema():
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from sdypy import EMA
    except ImportError as error:
        raise InputError(
            "modal identification needs sdypy-EMA, which is not installed; expected "
            "pip install 'fenics-joints[frf]'"
        ) from error
    return EMA


def _diagram(
    orders: list[np.ndarray], data: MeasuredFRFs, max_damping: float
) -> StabilisationDiagram:
    columns, before = [], np.zeros(0, dtype=complex)
    low, high = data.frequencies_hz[[0, -1]]
    for i, poles in enumerate(orders):
        f, damping = np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)
        kept = (f >= low) & (f <= high) & (damping > 0) & (damping < max_damping)
        f, damping = f[kept], damping[kept]
        f_old, damping_old = np.abs(before) / (2 * np.pi), -before.real / np.abs(before)
        close = np.abs(f[:, None] - f_old) < _STABLE_F * f[:, None]
        alike = np.abs(damping[:, None] - damping_old) < _STABLE_DAMPING * damping[:, None]
        columns.append((np.full(len(f), i + 1), f, damping, close.any(1), (close & alike).any(1)))
        before = poles[kept]
    return StabilisationDiagram(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _groups(poles: StabilisationDiagram, order: int) -> list[np.ndarray]:
    """Indices of the stable poles of each mode. Poles are of different modes if there is a gap
    between them, or if both occur in many orders, however close.
    """
    index = np.flatnonzero(poles.stable)
    index = index[np.argsort(poles.frequencies_hz[index])]
    if not len(index):
        return []
    f = poles.frequencies_hz[index]
    parts = np.split(index, np.flatnonzero(np.diff(f) > _STABLE_F * f[1:]) + 1)
    least = max(3, _STAYS * order)
    return [
        mode
        for part in parts
        if len(np.unique(poles.order[part])) >= least
        for mode in _apart(part, poles.order[part], least)
    ]


def _apart(part: np.ndarray, orders: np.ndarray, least: float) -> list[np.ndarray]:
    """Poles of ascending frequency as the modes that they are in at least so many orders."""
    count = np.bincount(orders)
    for n in range(int(count.max()), 1, -1):
        if (count == n).sum() >= least:
            rows = [part[orders == o] for o in np.flatnonzero(count == n)]
            return list(np.array(rows).T)
    return [part]


def _inside(fit: ModeFit, data: MeasuredFRFs) -> np.ndarray:
    """Index of modes in the band, ascending."""
    order, (low, high) = np.argsort(fit.frequencies_hz), data.frequencies_hz[[0, -1]]
    return np.array([i for i in order if low <= fit.frequencies_hz[i] <= high], dtype=int)


def _nearest(at: np.ndarray, near: Sequence[float]) -> list[int]:
    """Index of the mode nearest to each frequency, ascending."""
    found = []
    for f in near:
        i = int(np.argmin(np.abs(at - f)))
        if abs(at[i] - f) > 0.05 * f or i in found:
            there = ", ".join(f"{x:.5g}" for x in at)
            raise InputError(
                f"near = {f:g} Hz: expected a stable pole of its own within 5 %; the poles of the "
                f"FRFs are at {there} Hz"
            )
        found.append(i)
    return sorted(found)


def _pole(poles: StabilisationDiagram, group: np.ndarray) -> complex:
    """The median of a group, rad/s."""
    f, damping = np.median(poles.frequencies_hz[group]), np.median(poles.damping[group])
    return 2 * np.pi * f * (-damping + 1j * np.sqrt(1 - damping**2))


# -- the result ------------------------------------------------------------------------------------


def _modes(
    data, links, fit: ModeFit, poles: StabilisationDiagram, chosen, notes, window
) -> IdentifiedModes:
    found = links.shapes(fit.responses, fit.references, fit.poles)
    shapes, factor = (x[..., chosen] for x in found)
    normalised = links.scaled and not np.isnan(factor).any()
    largest = np.nanargmax(np.abs(shapes.real), axis=0), np.arange(len(chosen))
    shapes = shapes * np.sign(shapes.real[largest])
    scale = factor if normalised else 1 / shapes.real[largest]
    drawn, factors = (x[..., chosen] for x in links.shapes(*fit.draws(_DRAWS), fit.poles))
    turned = drawn.real * np.sign(np.nansum(drawn.real * shapes.real, axis=-2, keepdims=True))
    scales = factors if normalised else 1 / turned[(slice(None), *largest)]
    rows = ~np.isnan(shapes).any(axis=1)
    spread = np.full(shapes.shape, np.nan)
    spread[rows] = np.nanstd((turned * scales[:, None, :])[:, rows], axis=0)
    real, imag = shapes.real[rows], shapes.imag[rows]
    xx, yy, xy = (real**2).sum(0), (imag**2).sum(0), (real * imag).sum(0)
    decay = 0.0 if window is None else 1 / window
    damping = fit.damping[chosen] - decay / np.abs(fit.poles[chosen])
    if (damping <= 0).any():
        r = int(np.argmin(damping))
        raise InputError(
            f"exponential_window = {window:g} s: has more damping than was measured, "
            f"{100 * fit.damping[chosen][r]:.3g} % at {fit.frequencies_hz[chosen][r]:.5g} Hz; "
            "expected the time in which the window falls to 1/e"
        )
    collinearity = ((xx - yy) ** 2 + 4 * xy**2) / (xx + yy) ** 2
    notes = [*notes, *_doubts(fit.frequencies_hz[chosen], fit.frequencies_sd[chosen], collinearity)]
    return IdentifiedModes(
        fit.frequencies_hz[chosen],
        damping,
        fit.frequencies_sd[chosen],
        fit.damping_sd[chosen],
        scale * shapes.real,
        spread,
        collinearity,
        normalised,
        _scatter(poles, fit, chosen),
        fit.residual,
        poles,
        data,
        tuple(notes),
    )


def _doubts(f: np.ndarray, sd: np.ndarray, collinearity: np.ndarray) -> list[str]:
    close = np.flatnonzero(np.diff(f) < 2 * np.hypot(sd[1:], sd[:-1]))
    return [
        f"{f[i]:.6g} Hz: the shape is far from real; it may mix two close modes"
        for i in np.flatnonzero(collinearity < _MIXED)
    ] + [
        f"{f[i]:.6g} and {f[i + 1]:.6g} Hz: two modes at nearly the same frequency; each shape "
        "may be a mix of both"
        for i in close
    ]


def _scatter(poles: StabilisationDiagram, fit: ModeFit, chosen: np.ndarray) -> np.ndarray:
    found = []
    for f, z in zip(fit.frequencies_hz[chosen], fit.damping[chosen], strict=True):
        near = poles.stable & (np.abs(poles.frequencies_hz - f) < _STABLE_F * f)
        parts = poles.frequencies_hz[near] / f, poles.damping[near] / z
        found.append([np.std(part) if near.any() else np.nan for part in parts])
    return np.array(found)
