"""Bolt force from tightening torque: Motosh's equation, its friction, and the nut factor.

Motosh, N., "Development of Design Charts for Bolts Preloaded up to the Plastic Range", J. Eng. Ind.
98 (1976) 849, as in Fronk et al. 2019, eq. 8:

    T = F (P / (2 pi) + mu_t r_t / cos(beta) + mu_n r_n).

Fronk et al. 2019 prints, for 5/16-24, 10.2, 16.9, 25.1 N·m to 8.6, 14.3, 21.2 kN but neither
frictions nor radii. The three pairs are one ratio T/F, 1.179 to 1.189 mm within their rounding.
With the radii that are the default here and one friction for thread and head this is a friction of
0.106 to 0.108, found by `friction_from`; 0.1 fits as well with r_n = 0.75 d, so the table alone
does not say which. A friction of 0.3, which that paper uses between its beams, would halve the
forces.
"""

from __future__ import annotations

import math

from fenics_joints.errors import InputError, real
from fenics_joints.preload.threads import Thread, thread


def thread_radius(thread_: str | Thread) -> float:
    """Effective radius r_t of the thread's friction: half the pitch diameter, m (ISO 16047)."""
    return thread(thread_).pitch_diameter / 2


def bearing_radius(
    outer_diameter: float, inner_diameter: float, *, uniform_pressure: bool = False
) -> float:
    """Effective radius r_n of friction on an annulus, m.

    Args:
        outer_diameter: Of the bearing face, m.
        inner_diameter: Of the bearing face, m.
        uniform_pressure: Moment of a uniform pressure, (2/3) (r_o^3 - r_i^3) / (r_o^2 - r_i^2),
            instead of the mean radius that ISO 16047 and VDI 2230 use.

    Raises:
        InputError: If the annulus has no area.
    """
    if not 0 <= inner_diameter < outer_diameter < math.inf:
        raise InputError(
            f"bearing face of {outer_diameter:g} m outer and {inner_diameter:g} m inner diameter: "
            "expected the outer one larger, neither negative"
        )
    outer, inner = outer_diameter / 2, inner_diameter / 2
    if uniform_pressure:
        return 2 / 3 * (outer**3 - inner**3) / (outer**2 - inner**2)
    return (outer + inner) / 2


def motosh_force(
    torque: float,
    thread_: str | Thread,
    friction_thread: float,
    friction_head: float,
    head_radius: float | None = None,
) -> float:
    """Bolt force of a tightening torque (Fronk et al. 2019, eq. 8), N.

    Args:
        torque: N·m.
        thread_: A thread or its name.
        friction_thread: Coefficient of friction mu_t between the threads.
        friction_head: Coefficient of friction mu_n under the part that is turned.
        head_radius: Effective radius r_n of the latter, m; by default the mean radius between
            the width across flats and the clearance hole.

    Raises:
        InputError: For an unknown thread, a negative torque or friction, a radius not above 0.
    """
    ratio = _torque_per_force(thread_, friction_thread, friction_head, head_radius)
    return real("torque", torque, "N·m", least=0) / ratio


def friction_from(
    torque: float, force: float, thread_: str | Thread, head_radius: float | None = None
) -> float:
    """The friction of thread and head with which a torque gives a force (Fronk et al. 2019, eq. 8).

    Args:
        torque: N·m.
        force: N.
        thread_: A thread or its name.
        head_radius: As in `motosh_force`, m.

    Raises:
        InputError: If the torque is below that of a thread without friction.
    """
    t = thread(thread_)
    force = real("force", force, "N", above=0)
    ratio = real("torque", torque, "N·m", least=0) / force
    slope = t.pitch / (2 * math.pi)
    if ratio < slope:
        raise InputError(
            f"torque {torque:g} N·m for {force:g} N on {t.name}: expected at least "
            f"{force * slope:.3g} N·m, which takes no friction at all"
        )
    radii = thread_radius(t) / math.cos(t.half_angle) + _head_radius(t, head_radius)
    return (ratio - slope) / radii


def nut_factor_force(torque: float, diameter: float, K: float = 0.2) -> float:
    """Bolt force of the short form T = K d F, N.

    Args:
        torque: T, N·m.
        diameter: Nominal diameter d, m.
        K: Nut factor; 0.2 is usual for plain, dry steel.

    Raises:
        InputError: For a negative torque, or a diameter or factor not above 0.
    """
    ratio = real("diameter", diameter, "m", above=0) * real("K", K, above=0)
    return real("torque", torque, "N·m", least=0) / ratio


def _torque_per_force(thread_, friction_thread, friction_head, head_radius) -> float:
    t = thread(thread_)
    mu_t = real("friction_thread", friction_thread, least=0)
    mu_n = real("friction_head", friction_head, least=0)
    thread_arm = thread_radius(t) / math.cos(t.half_angle)
    return t.pitch / (2 * math.pi) + mu_t * thread_arm + mu_n * _head_radius(t, head_radius)


def _head_radius(t: Thread, head_radius: float | None) -> float:
    if head_radius is None:
        return bearing_radius(t.width_across_flats, t.hole_diameter)
    return real("head_radius", head_radius, "m", above=0)
