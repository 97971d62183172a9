"""Tests by level: backbones in one table."""

from __future__ import annotations

import numpy as np
import pytest

from fenics_joints.errors import InputError
from fenics_joints.measurements import read_test_data


def test_a_backbone_is_one_table(tmp_path):
    """Level, frequency, damping, as they come from a test; per cent by the head's unit."""
    table = tmp_path / "backbone.csv"
    table.write_text("level [m/s2],f [Hz],damping [%]\n20,80.2,0.19\n5,80.4,0.145\n")
    data = read_test_data(table, condition="level")
    assert data.by_level and data.mode_names == ("f",)
    np.testing.assert_allclose(data.damping[:, 0], [0.00145, 0.0019])
    rows = "1,10,0.01,20,\n2,9,0.02,19,0.03\n"
    table.write_text("level [N],a [Hz],a damping,b [Hz],b damping\n" + rows)
    data = read_test_data(table, condition="level")
    np.testing.assert_allclose(data.damping, [[0.01, np.nan], [0.02, 0.03]])
    assert data.mode_names == ("a", "b")
    table.write_text("level [N],a [Hz],b [Hz],damping\n1,10,20,0.01\n")
    with pytest.raises(InputError, match="'damping' is of one mode"):
        read_test_data(table, condition="level")
    table.write_text("level [N],a [Hz],damping\n1,10,1.5\n")
    with pytest.raises(InputError, match=r"below 1 \(or a unit \[%\]"):
        read_test_data(table, condition="level")
