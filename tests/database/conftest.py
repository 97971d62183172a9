"""What the tests of the database share."""

from __future__ import annotations

import pytest

from fenics_joints.database import JointSurfaces, seed_database


@pytest.fixture(scope="session")
def seed_surfaces() -> JointSurfaces:
    """Kriging of all 35 rows."""
    return JointSurfaces.fit(seed_database())
