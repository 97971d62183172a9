"""What an identification found, in words."""

from __future__ import annotations

from fenics_joints.formatting import number, percent, quantity
from fenics_joints.harmonic import IdentificationResult

#: A misfit this many times the noise is spoken of.
_WIDE = 1.5


def source(found: IdentificationResult) -> str:
    """What data the parameters are from."""
    parts = []
    if len(found.frequencies_hz):
        parts.append(f"the curve at {quantity(found.level, 'N')}")
    if found.mode is not None:
        measured = found.mode.measured
        parts.append(f"a mode at {len(measured)} amplitudes ({measured.kind})")
    return " and ".join(parts) or "loops"


def mode_notes(found: IdentificationResult) -> list[str]:
    """What the mode over its amplitude says beside the parameters, and what it cannot, a line each.

    Of none, if none was fitted.
    """
    if found.mode is None:
        return []
    notes = []
    rest = found.offsets.get("frequency at rest")
    if rest is not None:
        notes.append(
            f"at rest the test's frequency is {percent(abs(rest.value), 3)} (s.d. "
            f"{percent(rest.sd, 3)}) {'above' if rest.value > 0 else 'below'} the model's, beside "
            "what the law does"
        )
    damping = found.offsets.get("damping at rest")
    if damping is not None:
        notes.append(
            f"the test has a damping ratio of {percent(abs(damping.value), 3)} (s.d. "
            f"{percent(damping.sd, 3)}) {'more' if damping.value > 0 else 'less'} than the model, "
            "at all amplitudes the same"
        )
    for what, width in zip(("frequencies", "damping ratios"), found.mode.widths, strict=True):
        if width > _WIDE:
            notes.append(
                f"the law does not follow the {what}: it leaves {number(width, 2)} times their "
                "noise, and they were weighed so much less"
            )
    if not found.mode.measured.has_damping:
        notes.append(
            "without damping ratios slip cannot be told from any other softening of the joint"
        )
    return [*notes, *found.mode.measured.notes]


def mode_rows(found: IdentificationResult) -> list[tuple[float, float, float, float, float]]:
    """Displacement, m; measured and computed frequency, Hz, and damping ratio, at each amplitude.

    The computed ones with what the model lacks at rest.
    """
    if found.mode is None:
        return []
    points, measured = found.responses[-1], found.mode.measured
    hz = 1.0 + getattr(found.offsets.get("frequency at rest"), "value", 0.0)
    more = getattr(found.offsets.get("damping at rest"), "value", 0.0)
    columns = (
        found.mode.displacements,
        measured.frequencies_hz,
        hz * points.frequencies_hz,
        measured.damping,
        more + points.damping_ratios,
    )
    return list(zip(*(column.tolist() for column in columns), strict=True))
