"""What the tests of the database share."""

from __future__ import annotations

import pytest

from fenics_joints.database import Surfaces, seed_database


@pytest.fixture(scope="session")
def seed_surfaces() -> Surfaces:
    """Kriging of all 35 rows."""
    return Surfaces.fit(seed_database())
