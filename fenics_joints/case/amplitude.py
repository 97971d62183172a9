"""Sections of a case file about data of one mode over its amplitude."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from fenics_joints.case.values import Files, Positive, Section, Spacing, ascending, in_files, listed


class AmplitudeSection(Section):
    """``[test.amplitude."MODE"]``, or ``amplitude = { "MODE" = FILE }``: a mode by amplitude.

    Any of: a table of level, frequency and damping; sweeps at constant response or at constant
    force; ring-downs. The files' columns say which, see ``docs/amplitude.md``. ``levels`` are those
    of the functions of universal files, one for each; ``band`` holds this mode and no other;
    ``sensor`` is the one that the amplitude is of, where a ring-down has several; ``units`` those
    of functions or records whose file does not say them. ``noise`` and ``damping_noise`` are
    relative standard deviations: of a plain table, [test] noise or 0.1 %, and 10 %, unless given;
    of the other kinds, beside what their own scatter says.
    """

    files: Files
    levels: Annotated[list[str], BeforeValidator(listed), Field(min_length=1)] | None = None
    band: ascending(Spacing) | None = None
    sensor: str | None = None
    units: str | None = None
    noise: Positive | None = None
    damping_noise: Positive | None = None


Modes = dict[str, Annotated[AmplitudeSection, BeforeValidator(in_files)]]
