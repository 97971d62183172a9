"""Steps of hysteretic joints: stress and new memory, from the last memory and the present strain.

Pure functions of UFL, for a thin layer (shear strain; moduli in Pa) or a zero-thickness interface
(slip, m; stiffness in Pa/m) alike. Slip, state and traction are UFL vectors in the tangent plane,
of 1 or 2 components (or 3, as `fenics_joints.forms.contact` has them); tractions point along the
slip. All laws are isotropic in that plane and independent of rate. The tangent is
``ufl.derivative`` of what they return: the consistent one.

Signs in the normal direction: opening and tension are positive, and so is a pressure in
compression.
"""

from __future__ import annotations

import ufl

__all__ = [
    "bouc_wen",
    "coulomb_matrix",
    "coulomb_stick",
    "dilatant_coulomb",
    "parallel",
    "slider",
    "slider_dissipation",
    "slider_energy",
    "valanis",
]


def _length(vector):
    """Euclidean length, with a derivative of zero where the vector is zero."""
    square = ufl.dot(vector, vector)
    positive = ufl.gt(square, 0.0)
    return ufl.conditional(positive, ufl.sqrt(ufl.conditional(positive, square, 1.0)), 0.0)


def _either(condition, first, second):
    """Conditional of vectors, component by component."""
    n = first.ufl_shape[0]
    return ufl.as_vector([ufl.conditional(condition, first[i], second[i]) for i in range(n)])


def slider(slip, position, stiffness, strength):
    """A spring in series with a dry slider (Jenkins): elastic, perfectly plastic.

    Radial return (Simo and Hughes, Computational Inelasticity, 1998, sec. 1.2), exact for a step
    along a straight line. On a line, its loop follows Masing's rule.

    Args:
        slip: Present slip.
        position: Where the slider stood after the last step.
        stiffness: Stiffness of the spring, > 0.
        strength: Traction, Pa, at which it slides, >= 0.

    Returns:
        (traction, new position); the position of a sticking slider is returned as it is.
    """
    stretch = slip - position
    length = _length(stretch)
    sticks = ufl.le(stiffness * length, strength)
    direction = stretch / ufl.conditional(sticks, 1.0, length)
    traction = _either(sticks, stiffness * stretch, strength * direction)
    return traction, _either(sticks, position, slip - strength / stiffness * direction)


def slider_energy(slip, position, stiffness):
    """Energy, J/m3 or J/m2, in the spring of a slider that stands at ``position``."""
    return 0.5 * stiffness * ufl.dot(slip - position, slip - position)


def slider_dissipation(slip, old, new, stiffness):
    """Energy, J/m3 or J/m2, that a slider turned to heat on its way from ``old`` to ``new``.

    The present traction times the way: exact for constant strength.
    """
    return ufl.dot(stiffness * (slip - new), new - old)


def parallel(slip, positions, stiffness, strength):
    """Sliders side by side: the parallel-series model of Iwan.

    Args:
        slip: Present slip.
        positions: Positions of the sliders after the last step, N vectors.
        stiffness: Their stiffnesses, N numbers.
        strength: Their strengths, Pa, N numbers.

    Returns:
        (traction, list of N new positions).
    """
    steps = [slider(slip, x, k, s) for x, k, s in zip(positions, stiffness, strength, strict=True)]
    return sum((t for t, _ in steps[1:]), steps[0][0]), [x for _, x in steps]


def coulomb_stick(opening, slip, position, k_n, k_s, mu, pressure=0.0):
    """Elastic sticking and Coulomb friction under the present pressure of a one-sided spring.

    The pressure is max(pressure - k_n * opening, 0), the slider's strength mu times that. Sliding
    does not open the interface (non-associated): the friction of metals.

    Args:
        opening: Opening since the interface carried ``pressure``, scalar.
        slip: Slip.
        position: Where the slider stood after the last step.
        k_n: Normal stiffness.
        k_s: Tangential stiffness of sticking.
        mu: Coefficient of friction.
        pressure: Pressure, Pa, at zero opening.

    Returns:
        (normal stress, Pa, tension positive: minus the pressure; traction; new position).
    """
    present = ufl.max_value(pressure - k_n * opening, 0.0)
    traction, position = slider(slip, position, k_s, mu * present)
    return -present, traction, position


def dilatant_coulomb(opening, slip, position, opened, k_n, k_s, mu, pressure=0.0):
    """The same with sliding that opens the interface by mu times its way (seed 003, eqs. 1-2).

    Associated plasticity with f = |tau| + mu sigma, and its closest-point return in closed form:
    with H = k_n mu^2 + k_s (eq. 2) and f of the trial stress, tau falls by k_s f / H along itself
    and sigma by k_n mu f / H. Where that would turn tau around, the stress is at the apex: zero.
    What has opened stays open, as in the seed's equations; a joint that comes apart and closes
    again wants `coulomb_stick`.

    Args:
        opened: Opening by sliding so far, scalar. Other arguments as in `coulomb_stick`.

    Returns:
        (normal stress, traction, new position, new ``opened``).
    """
    sigma = k_n * (opening - opened) - pressure
    stretch = slip - position
    length = _length(stretch)
    excess = k_s * length + mu * sigma
    H = k_n * mu**2 + k_s
    sticks = ufl.le(excess, 0.0)
    way = ufl.conditional(sticks, 0.0, excess / H)
    apex = ufl.And(ufl.gt(excess, 0.0), ufl.lt(k_n * mu * length, sigma))
    direction = stretch / ufl.conditional(ufl.gt(length, 0.0), length, 1.0)
    closed = ufl.Not(apex)
    sigma = ufl.conditional(closed, sigma - k_n * mu * way, 0.0)
    zero = 0.0 * slip
    traction = _either(closed, k_s * stretch - k_s * way * direction, zero)
    moved = _either(closed, position + way * direction, slip)
    opens = ufl.conditional(closed, opened + mu * way, opening - pressure / k_n)
    return (
        sigma,
        traction,
        _either(sticks, position, moved),
        ufl.conditional(sticks, opened, opens),
    )


def coulomb_matrix(traction, k_n, k_s, mu):
    """Increments of (sigma, tau) by those of (opening, slip) while sliding (seed 003, eq. 1).

    C - C n n^T C / H with C = diag(k_n, k_s, k_s), n = (mu, beta_1, beta_2) and H = n^T C n =
    k_n mu^2 + k_s: the continuum tangent of `dilatant_coulomb`. Worked out, the first term is
    k_n (1 - mu^2 k_n / H); eq. 1 prints mu^2 k_n^2 / H, which is not of the right dimension. In
    eq. 2, beta_i is tau_i / sqrt(tau_1^2 + tau_2^2), where the seed lost subscript and squares.

    Args:
        traction: Present traction, not zero, shape (1,) or (2,).
        k_n: Normal stiffness.
        k_s: Tangential stiffness.
        mu: Coefficient of friction.

    Returns:
        UFL matrix, (2, 2) or (3, 3).
    """
    beta = traction / ufl.sqrt(ufl.dot(traction, traction))
    size = traction.ufl_shape[0]
    H = k_n * mu**2 + k_s
    rows = [[k_n * (1 - mu**2 * k_n / H)] + [-k_n * k_s * mu * beta[i] / H for i in range(size)]]
    for i in range(size):
        row = [-k_s * k_s * beta[i] * beta[j] / H + (k_s if i == j else 0.0) for j in range(size)]
        rows.append([rows[0][i + 1], *row])
    return ufl.as_matrix(rows)


def _decay(c):
    """(exp(-c), (1 - exp(-c)) / c) for c >= 0; the latter by its series where it cancels."""
    small = ufl.lt(c, 1e-4)
    safe = ufl.conditional(small, 1.0, c)
    decay = ufl.exp(-c)
    series = 1.0 - c / 2.0 + c**2 / 6.0
    return decay, ufl.conditional(small, series, (1.0 - ufl.exp(-safe)) / safe)


def bouc_wen(slip, last, z, beta, gamma, n, *, substeps=1):
    """Hysteretic variable of Bouc and Wen, isotropic (Park, Wen and Ang, 1986; any n).

    dz = dx - z |z|^(n-2) (beta |z . dx| + gamma z . dx); on a line, dz = dx - |z|^n (beta |dx| +
    gamma dx sign z). Each substep is an exponential midpoint rule: second order, and stable
    however long (beta >= |gamma|). More of them cost compile time, not only run time.

    Args:
        slip: Present slip.
        last: Slip after the last step.
        z: The variable after the last step, in units of the slip.
        beta: Parameter, 1/slip^n.
        gamma: Parameter, 1/slip^n, at most beta in size.
        n: Exponent, >= 1.
        substeps: Number of substeps of a step.

    Returns:
        The new z; on a backbone it tends to (beta + gamma)^(-1/n).
    """
    dx = (slip - last) / substeps
    for _ in range(substeps):
        # Half a step, implicit but for the rate of forgetting, then a whole one from its end.
        middle = (z + 0.5 * dx) / (1.0 + 0.5 * _forgetting(z, dx, beta, gamma, n))
        decay, mean = _decay(_forgetting(middle, dx, beta, gamma, n))
        z = decay * z + mean * dx
    return z


def _forgetting(z, dx, beta, gamma, n):
    """|z|^(n-2) (beta |z . dx| + gamma z . dx), which tends to zero with z."""
    square, along = ufl.dot(z, z), ufl.dot(z, dx)
    positive = ufl.gt(square, 0.0)
    power = ufl.conditional(positive, square, 1.0) ** (0.5 * n - 1.0)
    ahead = ufl.conditional(ufl.gt(along, 0.0), gamma + beta, gamma - beta)
    return ufl.conditional(positive, power * ahead * along, 0.0)


def valanis(slip, last, z, rate):
    """Hysteretic variable of Valanis' endochronic model in its simplest form, isotropic.

    dz = dx - rate |dx| z (Valanis, Arch. Mech. 23, 1971; Gaul and Lenz, Acta Mech. 125, 1997, with
    kappa = 0), whose solution along a straight step is taken exactly.

    Args:
        slip: Present slip.
        last: Slip after the last step.
        z: The variable after the last step, in units of the slip.
        rate: Rate of forgetting, 1/slip.

    Returns:
        The new z; on a backbone it is (1 - exp(-rate x)) / rate.
    """
    dx = slip - last
    decay, mean = _decay(rate * _length(dx))
    return decay * z + mean * dx
