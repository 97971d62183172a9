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

from fenics_joints.errors import whole
from fenics_joints.forms.checks import check

# Vectors are worked on as lists of components: UFL then keeps what they share, where its own vector
# algebra, with new indices for every product, would copy it, and derivatives grow without bound.


def _parts(vector) -> list:
    return [vector[i] for i in range(vector.ufl_shape[0])]


def _square(parts):
    return sum(x * x for x in parts)


def vector_length(vector):
    """Euclidean length of a UFL vector, with a derivative of zero where all parts are zero."""
    return _length(_parts(vector))


def _length(parts):
    square = _square(parts)
    positive = ufl.gt(square, 0.0)
    return ufl.conditional(positive, ufl.sqrt(ufl.conditional(positive, square, 1.0)), 0.0)


def _either(condition, first, second):
    """Vector whose parts are those of ``first`` where the condition holds, else of ``second``."""
    return ufl.as_vector(
        [ufl.conditional(condition, a, b) for a, b in zip(first, second, strict=True)]
    )


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
    check("stiffness", stiffness, above=0)
    check("strength", strength, "Pa", least=0)
    slip, position = _parts(slip), _parts(position)
    stretch = [x - z for x, z in zip(slip, position, strict=True)]
    length = _length(stretch)
    # Without strength nothing sticks, not even at rest: an open contact has no shear stiffness.
    sticks = ufl.And(ufl.le(stiffness * length, strength), ufl.gt(strength, 0.0))
    share = strength / ufl.conditional(ufl.gt(length, 0.0), length, 1.0)
    sliding = [share * e for e in stretch]
    moved = [x - t / stiffness for x, t in zip(slip, sliding, strict=True)]
    traction = _either(sticks, [stiffness * e for e in stretch], sliding)
    return traction, _either(sticks, position, moved)


def slider_energy(slip, position, stiffness):
    """Energy, J/m3 or J/m2, in the spring of a slider that stands at ``position``."""
    check("stiffness", stiffness, least=0)
    return 0.5 * stiffness * ufl.dot(slip - position, slip - position)


def slider_dissipation(slip, old, new, stiffness):
    """Energy, J/m3 or J/m2, that a slider turned to heat on its way from ``old`` to ``new``.

    The present traction times the way: exact for constant strength.
    """
    check("stiffness", stiffness, least=0)
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
    _check_friction(k_n, k_s, mu)
    check("pressure", pressure, "Pa")
    present = ufl.max_value(pressure - k_n * opening, 0.0)
    traction, position = slider(slip, position, k_s, mu * present)
    return -present, traction, position


def dilatant_coulomb(opening, slip, position, opened, k_n, k_s, mu, pressure=0.0):
    """The same with sliding that opens by mu times its way (Iranzad and Ahmadian 2012, eqs. 1-2).

    Associated plasticity with f = |tau| + mu sigma, and its closest-point return in closed form:
    with H = k_n mu^2 + k_s (eq. 2) and f of the trial stress, tau falls by k_s f / H along itself
    and sigma by k_n mu f / H. Where that would turn tau around, the stress is at the apex: zero.
    What has opened stays open, as in the paper's equations, and sliding dissipates nothing: its
    work tau dz + sigma dw is f times the way, which is zero, so that what friction takes goes into
    pressing the sides apart. A joint that damps, or comes apart and closes again, wants
    `coulomb_stick`.

    Args:
        opened: Opening by sliding so far, scalar. Other arguments as in `coulomb_stick`.

    Returns:
        (normal stress, traction, new position, new ``opened``).
    """
    _check_friction(k_n, k_s, mu)
    check("pressure", pressure, "Pa")
    sigma = k_n * (opening - opened) - pressure
    slip, position = _parts(slip), _parts(position)
    stretch = [x - z for x, z in zip(slip, position, strict=True)]
    length = _length(stretch)
    excess = k_s * length + mu * sigma
    sticks = ufl.le(excess, 0.0)
    way = ufl.conditional(sticks, 0.0, excess / (k_n * mu**2 + k_s))
    apex = ufl.And(ufl.gt(excess, 0.0), ufl.lt(k_n * mu * length, sigma))
    advance = way / ufl.conditional(ufl.gt(length, 0.0), length, 1.0)
    cone = [k_s * (1.0 - advance) * e for e in stretch]
    moved = [z + advance * e for z, e in zip(position, stretch, strict=True)]
    moved = [ufl.conditional(apex, x, z) for x, z in zip(slip, moved, strict=True)]
    opens = ufl.conditional(apex, opening - pressure / k_n, opened + mu * way)
    return (
        ufl.conditional(apex, 0.0, sigma - k_n * mu * way),
        _either(apex, [0.0] * len(cone), cone),
        _either(sticks, position, moved),
        ufl.conditional(sticks, opened, opens),
    )


def coulomb_matrix(traction, k_n, k_s, mu):
    """Increments of stress by opening and slip in sliding (Iranzad and Ahmadian 2012, eq. 1).

    C - C n n^T C / H with C = diag(k_n, k_s, k_s), n = (mu, beta_1, beta_2) and H = n^T C n =
    k_n mu^2 + k_s: the continuum tangent of `dilatant_coulomb`. Worked out, the first term is
    k_n (1 - mu^2 k_n / H); eq. 1 prints mu^2 k_n^2 / H, which is not of the right dimension. In
    eq. 2, beta_i is tau_i / sqrt(tau_1^2 + tau_2^2), where the paper lost subscript and squares.

    Args:
        traction: Present traction, not zero, shape (1,) or (2,).
        k_n: Normal stiffness.
        k_s: Tangential stiffness.
        mu: Coefficient of friction.

    Returns:
        UFL matrix, (2, 2) or (3, 3).
    """
    _check_friction(k_n, k_s, mu)
    beta = traction / ufl.sqrt(ufl.dot(traction, traction))
    size = traction.ufl_shape[0]
    H = k_n * mu**2 + k_s
    rows = [[k_n * (1 - mu**2 * k_n / H)] + [-k_n * k_s * mu * beta[i] / H for i in range(size)]]
    for i in range(size):
        row = [-k_s * k_s * beta[i] * beta[j] / H + (k_s if i == j else 0.0) for j in range(size)]
        rows.append([rows[0][i + 1], *row])
    return ufl.as_matrix(rows)


def _check_friction(k_n, k_s, mu) -> None:
    check("k_n", k_n, above=0)
    check("k_s", k_s, above=0)
    check("mu", mu, least=0)


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
    however long (beta >= |gamma|).

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
    check("beta", beta)
    check("gamma", gamma)
    check("n", n, least=1)
    substeps = whole("substeps", substeps)
    dx = [(x - x0) / substeps for x, x0 in zip(_parts(slip), _parts(last), strict=True)]
    z = _parts(z)
    for _ in range(substeps):
        # Half a step, implicit but for the rate of forgetting, then a whole one from its end.
        half = 1.0 + 0.5 * _forgetting(z, dx, beta, gamma, n)
        middle = [(a + 0.5 * b) / half for a, b in zip(z, dx, strict=True)]
        decay, mean = _decay(_forgetting(middle, dx, beta, gamma, n))
        z = [decay * a + mean * b for a, b in zip(z, dx, strict=True)]
    return ufl.as_vector(z)


def _forgetting(z, dx, beta, gamma, n):
    """|z|^(n-2) (beta |z . dx| + gamma z . dx), which tends to zero with z."""
    square, along = _square(z), sum(a * b for a, b in zip(z, dx, strict=True))
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
    check("rate", rate, least=0)
    dx = [x - x0 for x, x0 in zip(_parts(slip), _parts(last), strict=True)]
    decay, mean = _decay(rate * _length(dx))
    return ufl.as_vector([decay * a + mean * b for a, b in zip(_parts(z), dx, strict=True)])
