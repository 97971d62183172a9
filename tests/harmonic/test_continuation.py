"""A branch that was kept is taken up again."""

from types import SimpleNamespace

import numpy as np
import pytest
from oscillators import BAND, PUSH, jenkins

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.harmonic import ContinuationSettings, solve_harmonic


def test_a_branch_is_taken_up_again(tmp_path):
    """A run that ran out of points goes on from its file to the same curve."""
    file, given = tmp_path / "branch.h5", dict(harmonics=3, samples=64)
    whole = solve_harmonic(jenkins(), "push", PUSH, BAND, **given)
    few = ContinuationSettings(max_points=15)
    with pytest.raises(ConvergenceError, match="max_points") as stopped:
        solve_harmonic(jenkins(), "push", PUSH, BAND, checkpoint=file, settings=few, **given)
    assert len(stopped.value.branch) == 15
    seen, given["checkpoint"], given["resume"] = [], file, True
    told = SimpleNamespace(
        step=lambda text, total=None: seen.append(text),
        advance=lambda n=1, note="": seen.append(note),
    )
    again = solve_harmonic(jenkins(), "push", PUSH, BAND, progress=told, **given)
    assert len(seen) < len(whole) - 10 and seen[-1].endswith("Hz")
    assert np.allclose(again.frequencies_hz, whole.frequencies_hz, rtol=1e-6)
    assert np.allclose(again.coefficients, whole.coefficients, rtol=1e-5, atol=1e-7)
    with pytest.raises(InputError, match="another structure or case.*a branch of"):
        solve_harmonic(jenkins(), "push", 0.1, BAND, **given)
    file.write_bytes(b"no branch")
    with pytest.raises(InputError, match="branch.h5.*checksum.*delete the file"):
        solve_harmonic(jenkins(), "push", PUSH, BAND, **given)
