"""Least-squares fit of poles and rank-one residues to measured functions, with covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

#: Rounds of weights, and most Gauss-Newton steps in each; chosen: fits converge in fewer.
_SWEEPS, _STEPS = 3, 30
#: Number of lines over which a function's noise is taken as constant.
_WINDOW = 9
#: Numbers in a batch of rows, 80 MB.
_BATCH = 10_000_000
#: Least noise, relative to the root mean square of a function: far below any test's.
_LEAST = 1e-9


@dataclass(frozen=True, eq=False)
class FRFColumns:
    """K measured functions.

    Attributes:
        f: Frequencies, Hz, shape (n,).
        values: Values, shape (n, K).
        rows: Index of each function's response, shape (K,).
        columns: Index of each function's reference, shape (K,).
        power: 0 for receptances, 1 for mobilities, 2 for accelerances.
        components: Number of each reference's group, whose members share sensors, (n_refs,).
        n_rows: Number of responses.
    """

    f: np.ndarray
    values: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    power: int
    components: np.ndarray
    n_rows: int

    def of_row(self, row: int) -> FRFColumns:
        """The functions of one response."""
        kept = self.rows == row
        return replace(
            self,
            values=self.values[:, kept],
            columns=self.columns[kept],
            rows=np.zeros(kept.sum(), dtype=int),
            n_rows=1,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of responses and references."""
        return self.n_rows, len(self.components)

    def matrix(self, values: np.ndarray) -> np.ndarray:
        """Each function, (..., K), as a matrix of responses and references; 0 for none."""
        found = np.zeros((*values.shape[:-1], *self.shape), dtype=values.dtype)
        found[..., self.rows, self.columns] = values
        return found


@dataclass(frozen=True, eq=False)
class ModeFit:
    """Modes of functions (i w)^q (sum_r a_ir b_jr / (i w - p_r) + conj. + U_ij - L_ij / w^2).

    The standard deviations of a mode are widened by the fit's residual near the mode, and by the
    residual's correlation from line to line.

    Attributes:
        poles: p, rad/s, shape (m,).
        responses: a, shape (n_responses, m).
        references: b, shape (n_references, m), of unit length among those that share sensors.
        frequencies_sd: Standard deviations of the frequencies, Hz, shape (m,).
        damping_sd: Standard deviations of the damping ratios, shape (m,).
        rest: Measured minus fitted, shape (n, K).
        residual: Root mean square of ``rest``, relative to that of the measured values.
        covariance: Covariance of Re p, Im p, Re b, Im b, shape (2 m + 2 m n_references,) squared.
        own: Covariance of Re a, Im a at given poles and references, (n_responses, 2 m, 2 m).
        slopes: Derivatives of Re a, Im a by Re p, Im p, Re b, Im b, shape (n_responses, 2 m,
            2 m + 2 m n_references).
    """

    poles: np.ndarray
    responses: np.ndarray
    references: np.ndarray
    frequencies_sd: np.ndarray
    damping_sd: np.ndarray
    rest: np.ndarray
    residual: float
    covariance: np.ndarray
    own: np.ndarray
    slopes: np.ndarray

    def __repr__(self) -> str:
        return f"ModeFit({len(self.poles)} poles, residual {self.residual:.2g})"

    @property
    def frequencies_hz(self) -> np.ndarray:
        """|p| / 2 pi."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def damping(self) -> np.ndarray:
        """-Re p / |p|."""
        return -self.poles.real / np.abs(self.poles)

    def draws(self, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Random samples of responses, (n, n_responses, m), and of references alike."""
        rng, m = np.random.default_rng(seed), len(self.poles)
        parts = rng.normal(size=(n, len(self.covariance))) @ _root(self.covariance).T
        own = np.einsum(
            "iab,nib->nia", _root(self.own), rng.normal(size=(n, *self.slopes.shape[:2]))
        )
        moved = own + np.einsum("iap,np->nia", self.slopes, parts)
        b = parts[:, 2 * m :].reshape(n, 2, *self.references.shape)
        return (
            self.responses + moved[..., :m] + 1j * moved[..., m:],
            self.references + b[:, 0] + 1j * b[:, 1],
        )


def _root(covariance: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]


def smooth(values: np.ndarray) -> np.ndarray:
    """Mean over neighbouring lines, along the first axis; the window shrinks at the ends."""
    n, half = len(values), _WINDOW // 2
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    at = np.arange(n)
    low, high = np.maximum(at - half, 0), np.minimum(at + half + 1, n)
    return (total[high] - total[low]) / (high - low).reshape(-1, *[1] * (values.ndim - 1))


def fit_modes(
    functions: FRFColumns,
    poles: np.ndarray,
    references: np.ndarray | None = None,
    *,
    fixed: bool = False,
    room: np.ndarray | None = None,
) -> ModeFit:
    """Non-linear least squares on functions, started at poles nearby.

    Residues are of rank one over responses and references. The functions are linear in the
    responses and in the residuals of modes outside the band, which are projected out (variable
    projection; Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973). Weights follow from each
    function's misfit and from the noise of all functions over frequency.

    Args:
        functions: The functions.
        poles: rad/s, shape (m,).
        references: Start values, shape (n_references, m); by default from the residues of each
            function.
        fixed: Whether the references stay fixed.
        room: Prior standard deviation of the poles around their start values, rad/s, shape (m,);
            None: no prior.
    """
    poles = np.array(poles, dtype=complex)
    prior = None if room is None else (poles, 1 / room**2)
    rest, residues = free_residues(functions, poles)
    if references is None:
        references = rank_one(functions, residues)
    size = np.sqrt((np.abs(functions.values) ** 2).mean(axis=0))
    for _ in range(_SWEEPS):
        noise = _noise(rest, _LEAST * size)
        state = _State(functions, noise, poles, _normalised(functions, references), prior)
        for _ in range(_STEPS):
            step, parts = state.step(fixed)
            for _ in range(8):
                moved = _normalised(functions, state.references + parts)
                trial = _State(functions, noise, state.poles + step, moved, prior)
                if trial.cost <= state.cost:
                    break
                step, parts = step / 2, parts / 2
            else:
                break
            gain, state = state.cost - trial.cost, trial
            if np.abs(step / state.poles).max() < 1e-10 or gain < 1e-7 * state.cost:
                break
        poles, references, rest = state.poles, state.references, state.rest
    return _result(state)


def _noise(rest: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Size of the noise of each function at each line, the product of two factors, shape (n, K).

    The factor over lines comes from second differences, which hardly contain smooth errors of the
    fit; the factor of a function comes from its whole misfit.
    """
    of_function = np.hypot(np.sqrt((np.abs(rest) ** 2).mean(axis=0)), least)
    rough = np.zeros(len(rest))
    rough[1:-1] = (np.abs(np.diff(rest / of_function, 2, axis=0)) ** 2).mean(axis=1) / 6
    rough[[0, -1]] = rough[[1, -2]]
    over = smooth(rough)
    over = np.sqrt(np.maximum(over, 1e-6 * over.mean() + 1e-300))
    return of_function * over[:, None]


def _basis(functions: FRFColumns, poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Complex columns: (n, 4 m) for residues and derivatives by poles; (n, 4) for other modes."""
    s = 2j * np.pi * functions.f[:, None]
    factor = s**functions.power
    columns = []
    for power in (1, 2):
        one, two = factor / (s - poles) ** power, factor / (s - poles.conj()) ** power
        columns += [one + two, 1j * (one - two)]
    smooth_part = np.hstack([factor * np.ones_like(s), factor / s**2])
    return np.hstack(columns), np.hstack([smooth_part, 1j * smooth_part])


def fitted(functions: FRFColumns, fit: ModeFit) -> np.ndarray:
    """The modes' part of the functions, without modes outside the band, shape (n, K)."""
    m = len(fit.poles)
    columns = _basis(functions, fit.poles)[0]
    residues = fit.responses[functions.rows] * fit.references[functions.columns]
    return columns[:, :m] @ residues.real.T + columns[:, m : 2 * m] @ residues.imag.T


def _stacked(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values.real, values.imag])


def free_residues(functions: FRFColumns, poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual, (n, K), and residues, (K, m), of a fit with free residues."""
    columns, out = _basis(functions, poles)
    m = len(poles)
    basis = _stacked(np.hstack([columns[:, : 2 * m], out]))
    scale = np.linalg.norm(basis, axis=0)
    y = _stacked(functions.values)
    x = np.linalg.lstsq(basis / scale, y, rcond=1e-12)[0]
    rest = y - basis / scale @ x
    x = x / scale[:, None]
    n = len(functions.f)
    return rest[:n] + 1j * rest[n:], (x[:m] + 1j * x[m : 2 * m]).T


def rank_one(functions: FRFColumns, residues: np.ndarray) -> np.ndarray:
    """References from residues, (K, m): from a chain of the strongest, then by least squares."""
    if functions.shape[1] == 1:
        return np.ones((1, residues.shape[1]), dtype=complex)
    there = functions.matrix(np.ones(len(residues)))
    found = np.empty((functions.shape[1], residues.shape[1]), dtype=complex)
    for r, mode in enumerate(residues.T):
        A = functions.matrix(mode)
        b = _chained(A, there > 0)
        for _ in range(50):
            a = _solve(there, A, b)
            b, before = _solve(there.T, A.T, a), b
            if np.linalg.norm(b - before) <= 1e-6 * np.linalg.norm(b):
                break
        found[:, r] = b
    return _normalised(functions, found)


def _chained(A: np.ndarray, there: np.ndarray) -> np.ndarray:
    """References from the strongest entries that link each to an earlier one (Prim's tree)."""
    size = np.where(there, np.abs(A), -1.0)
    a, b = np.full(len(A), np.nan, dtype=complex), np.full(A.shape[1], np.nan, dtype=complex)
    while np.isnan(b).any():
        by_row = np.where(~np.isnan(a)[:, None] & np.isnan(b), size, -1.0)
        by_column = np.where(np.isnan(a)[:, None] & ~np.isnan(b), size, -1.0)
        if max(by_row.max(), by_column.max()) < 0:
            rest = np.where(np.isnan(b), size, -1.0)
            b[np.unravel_index(np.argmax(rest), A.shape)[1]] = 1.0
            continue
        if by_row.max() >= by_column.max():
            i, j = np.unravel_index(np.argmax(by_row), A.shape)
            b[j] = A[i, j] / (a[i] or 1e-300)
        else:
            i, j = np.unravel_index(np.argmax(by_column), A.shape)
            a[i] = A[i, j] / (b[j] or 1e-300)
    return np.where(np.isfinite(b), b, 0.0)


def _solve(weight: np.ndarray, A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Least-squares a of A = a b^T."""
    below = weight @ np.abs(b) ** 2
    return (weight * A) @ b.conj() / np.where(below > 0, below, 1.0)


def _normalised(functions: FRFColumns, references: np.ndarray) -> np.ndarray:
    found = references.copy()
    for component in np.unique(functions.components):
        at = functions.components == component
        size = np.linalg.norm(found[at], axis=0)
        found[at] /= np.where(size > 0, size, 1.0)
    return found


def _times(columns: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Columns for Re and Im of x, from those of c x; c of shape (..., m)."""
    m = columns.shape[-1] // 2
    one, two = columns[:, :m], columns[:, m:]
    a, b = c.real[..., None, :], c.imag[..., None, :]
    return np.concatenate([one * a + two * b, two * a - one * b], axis=-1)


class _State:
    """The best responses at given poles, references and noise.

    All variations lie in the span of 4 m columns: residues and derivatives by poles. Functions are
    projected on this span once; the rows are then small problems.
    """

    def __init__(self, functions: FRFColumns, noise, poles, references, prior=None):
        self.functions, self.noise, self.prior = functions, noise, prior
        self.poles, self.references = poles, references
        # The noise is a product of one of lines and one of functions.
        over, self.sigma = noise[:, 0] / noise[0, 0], noise[0]
        columns, out = _basis(functions, poles)
        m = len(poles)
        out, columns = (_stacked(part / over[:, None]) for part in (out, columns))
        out = np.linalg.qr(out / np.linalg.norm(out, axis=0))[0]
        columns = columns - out @ (out.T @ columns)
        size = np.linalg.norm(columns, axis=0)
        q, r = np.linalg.qr(columns / size)
        r = r * size
        self.q = q
        self.by_residue, self.by_slope = r[:, : 2 * m], r[:, 2 * m :]
        y = _stacked(functions.values / over[:, None])
        y = y - out @ (out.T @ y)
        self.z = q.T @ y  # (4 m, K)
        self.responses = np.empty((functions.shape[0], m), dtype=complex)
        fitted = np.zeros_like(self.z)
        for rows, index, blocks, z in self._batches():
            pinv = np.linalg.pinv(blocks, rcond=1e-11)
            x = np.einsum("iab,ib->ia", pinv, z)
            self.responses[rows] = x[:, :m] + 1j * x[:, m:]
            back = np.einsum("iab,ib->ia", blocks, x).reshape(len(rows), -1, 4 * m)
            for i, row in enumerate(index):
                for j, k in row:
                    fitted[:, k] = back[i, j] * self.sigma[k]
        left = y - q @ fitted
        self.cost = float(((left / self.sigma) ** 2).sum())
        if prior is not None:
            self.cost += float((np.abs(poles - prior[0]) ** 2 * prior[1]).sum())
        n = len(over)
        self.rest = (left[:n] + 1j * left[n:]) * over[:, None]

    def _batches(self):
        """Batches of rows: their numbers, functions, weighted columns and weighted functions."""
        functions, m = self.functions, len(self.poles)
        n_rows, n_columns = functions.shape
        sigma = np.zeros((n_rows, n_columns))
        sigma[functions.rows, functions.columns] = 1 / self.sigma
        width = 4 * m * n_columns
        for rows in np.array_split(np.arange(n_rows), -(-n_rows * width * 2 * m // _BATCH)):
            blocks = _times(self.by_residue, self.references)  # (n_columns, 4 m, 2 m)
            blocks = sigma[rows][:, :, None, None] * blocks
            z, index = np.zeros((len(rows), n_columns, 4 * m)), []
            for i, row in enumerate(rows):
                own = np.flatnonzero(functions.rows == row)
                index.append([(functions.columns[k], k) for k in own])
                z[i, functions.columns[own]] = (self.z[:, own] / self.sigma[own]).T
            yield rows, index, blocks.reshape(len(rows), width, 2 * m), z.reshape(len(rows), width)

    def normal(self):
        """Gradient and information of poles and references, derivatives of the responses by these,
        the responses' own covariance, and each function's derivatives by the poles over its noise.
        """
        m, n_columns = len(self.poles), self.functions.shape[1]
        count = 2 * m * (1 + n_columns)
        gradient, information = np.zeros(count), np.zeros((count, count))
        follow = np.empty((self.functions.shape[0], 2 * m, count))
        own = np.empty((self.functions.shape[0], 2 * m, 2 * m))
        by_poles = np.empty((len(self.sigma), 4 * m, 2 * m))
        sigma = self.functions.matrix(1 / self.sigma)
        for rows, index, blocks, z in self._batches():
            a = self.responses[rows]
            slopes = np.zeros((len(rows), n_columns, 4 * m, count))
            residues = a[:, None, :] * self.references
            slopes[..., : 2 * m] = _times(self.by_slope, residues)
            by_reference = _times(self.by_residue, a)  # (rows, 4 m, 2 m)
            for j in range(n_columns):
                at = 2 * m + j * m + np.arange(m)
                slopes[:, j, :, at] = by_reference[..., :m].transpose(2, 0, 1)
                slopes[:, j, :, at + m * n_columns] = by_reference[..., m:].transpose(2, 0, 1)
            slopes *= sigma[rows][:, :, None, None]
            slopes = slopes.reshape(len(rows), -1, count)
            pinv = np.linalg.pinv(blocks, rcond=1e-11)
            follow[rows] = -pinv @ slopes
            own[rows] = pinv @ pinv.transpose(0, 2, 1)
            slopes = slopes + blocks @ follow[rows]
            for i, row in enumerate(index):
                for j, k in row:
                    by_poles[k] = slopes[i, 4 * m * j : 4 * m * (j + 1), : 2 * m]
            left = z - np.einsum("iab,ib->ia", blocks, np.hstack([a.real, a.imag]))
            flat = slopes.reshape(-1, count)
            gradient += flat.T @ left.ravel()
            information += flat.T @ flat
        if self.prior is not None:
            away, weight = self.poles - self.prior[0], self.prior[1]
            gradient[: 2 * m] -= np.concatenate([away.real * weight, away.imag * weight])
            information[np.arange(2 * m), np.arange(2 * m)] += np.tile(weight, 2)
        return gradient, information, follow, own, by_poles

    def unknowns(self) -> np.ndarray:
        """Index of poles and references, without references that share no sensor with others."""
        m, components = len(self.poles), self.functions.components
        shared = (components[:, None] == components).sum(axis=0) > 1
        return np.flatnonzero(np.concatenate([np.ones(2 * m), np.tile(np.repeat(shared, m), 2)]))

    def step(self, fixed: bool) -> tuple[np.ndarray, np.ndarray]:
        """Step of the poles and references that reduces the misfit."""
        gradient, information, *_ = self.normal()
        m = len(self.poles)
        used = np.arange(2 * m) if fixed else self.unknowns()
        inverse = _inverse(information, used)
        delta = inverse @ gradient
        step = delta[:m] + 1j * delta[m : 2 * m]
        b = delta[2 * m :].reshape(2, *self.references.shape)
        parts = b[0] + 1j * b[1]
        # No further than half a damping, so that a pole stays on its side and at its peak.
        most = 0.5 * np.abs(self.poles.real)
        shorter = max(1.0, float((np.abs(step) / most).max()))
        return step / shorter, parts / shorter


def _inverse(information: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Inverse for some unknowns, without undetermined directions; zero for the others."""
    part = information[np.ix_(used, used)]
    size = np.sqrt(np.diag(part))
    size[size == 0] = 1.0
    inverse = np.zeros_like(information)
    found = np.linalg.pinv(part / np.outer(size, size), rcond=1e-11, hermitian=True)
    inverse[np.ix_(used, used)] = found / np.outer(size, size)
    return inverse


def _result(state: _State) -> ModeFit:
    functions, poles, m = state.functions, state.poles, len(state.poles)
    _, information, follow, own, by_poles = state.normal()
    wider = _wider(state, by_poles)
    covariance = _inverse(information, state.unknowns())
    each = np.tile(wider, len(information) // m)
    covariance *= np.outer(each, each)
    pairs = [covariance[np.ix_([r, m + r], [r, m + r])] for r in range(m)]
    length = np.abs(poles)
    # Of |p| and -Re p / |p| by Re p and Im p.
    slope_f = np.stack([poles.real / length, poles.imag / length]) / (2 * np.pi)
    slope_z = np.stack([-(poles.imag**2), poles.real * poles.imag]) / length**3
    total = np.linalg.norm(functions.values)
    return ModeFit(
        poles,
        state.responses,
        state.references,
        np.sqrt([slope_f[:, r] @ pairs[r] @ slope_f[:, r] for r in range(m)]),
        np.sqrt([slope_z[:, r] @ pairs[r] @ slope_z[:, r] for r in range(m)]),
        state.rest,
        float(np.linalg.norm(state.rest) / total),
        covariance,
        own * np.outer(np.tile(wider, 2), np.tile(wider, 2)),
        follow,
    )


def _wider(state: _State, by_poles: np.ndarray) -> np.ndarray:
    """Factor on the standard deviations of each mode beyond the weights, shape (m,).

    It comes from the residual at the lines and functions that determine the mode's pole, in units
    of the weights (real and imaginary parts have a variance of 1/2), as in the covariance of White
    (Econometrica 48, 1980); and from the residual's correlation c from line to line: sqrt((1 + c) /
    (1 - c)), not below 1.
    """
    n, count = state.rest.shape
    m = len(state.poles)
    left = np.abs(state.rest / state.noise) ** 2
    next_ = (state.rest[1:] * state.rest[:-1].conj()).real / (state.noise[1:] * state.noise[:-1])
    power, total, squares, shared, alone = np.zeros((5, m))
    for k in range(count):
        slopes = (state.q @ by_poles[k]) ** 2
        weight = slopes.reshape(2, n, 2, m).sum(axis=(0, 2))
        both = np.sqrt(weight[1:] * weight[:-1])
        power += left[:, k] @ weight
        total, squares = total + weight.sum(axis=0), squares + (weight**2).sum(axis=0)
        shared += next_[:, k] @ both
        alone += 0.5 * (left[1:, k] + left[:-1, k]) @ both
    # A mode's unknowns absorb their share of the residual at its lines.
    share = 2 * sum(state.functions.shape) * squares / (2 * total**2)
    c = np.clip(shared / np.where(alone > 0, alone, 1.0), 0.0, 1 - 2 / n)
    return np.sqrt(0.5 * power / total / np.maximum(1 - share, 0.2) * (1 + c) / (1 - c))
