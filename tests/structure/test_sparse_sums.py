"""K(p) and M(p) as sums of kept matrices, against the integrals of another structure."""

from __future__ import annotations

import numpy as np
import pytest
from eigen_slopes import assert_same
from mpi4py import MPI

from fenics_joints.meshes import lap_plates
from fenics_joints.structure import (
    ElasticSupport,
    Parameter,
    PointMass,
    Spring,
    Structure,
    Support,
    interface,
    joint,
    part,
    transition,
)

START = {"E": 7e10, "nu": 0.3, "rho": 2700.0, "s": 1.0, "w": 1.0, "near": 1e9, "away": 2e6}
START |= {"h": 1e-3, "k": 1e4, "m": 0.1, "x": 0.01}
#: A coarse lap with four bolts.
LAP = {"length": 0.2, "width": 0.08, "thickness": 0.008, "lap": 0.08, "layer": 0.002, "zone": 0.02}
LAP |= {"n_length": 10, "n_width": 4, "n_thickness": 1}
LAP |= {"bolts": [(0.14, 0.02), (0.14, 0.06), (0.18, 0.02), (0.18, 0.06)]}


def plates(law: str, wide: bool = False) -> Structure:
    """Two plates on a held and a soft edge, with two joints of which one is by this law."""
    more, cells = {"width": "w"} if wide else {}, "joint_away"
    body = part("plates", ("plate_1", "plate_2"), E="E", nu="nu", rho="rho", stretch="s", **more)
    away = {
        "transition": lambda: transition("away", cells, E="away", nu=0.3, h="h", meshed=0.002),
        "springs": lambda: interface("away", cells, k_n="away", k_t=3e5, meshed=2e-3),
        "graded": lambda: joint("away", cells, E=lambda x, p: p["away"] * x[0], G=4e5),
    }.get(law, lambda: joint("away", cells, E="away", G=2e6, law=law, stretch="s"))()
    near = joint("near", "joint_near", E="near", G=4e8, rho="rho")
    return Structure(
        lap_plates(MPI.COMM_WORLD, **LAP),
        [body, near, away],
        [Parameter(*item) for item in START.items()],
        masses=[PointMass("m", "m", (0.02, 0.04, 0.0), travel="x")],
        springs=[Spring("k", "k", (0.3, 0.04, 0.01))],
        supports=[Support("end_1", (2,)), ElasticSupport("edge", "end_2", k_n="k", k_t=2e3)],
    )


@pytest.mark.parallel
@pytest.mark.parametrize(
    "law", ["isotropic", "uncoupled", "constrained", "transition", "springs", "graded", "wide"]
)
def test_sums_are_what_is_assembled(law):
    """At values that no sample has, once they are summed; also between changes of a law."""
    wide, rng = law == "wide", np.random.default_rng(7)
    # The second has too few solutions for sums.
    model, fresh = (plates("uncoupled" if wide else law, wide) for _ in range(2))
    names = [name for name in START if name != "x"]
    n_turns = 14 if wide else 8
    for turn in range(n_turns):
        moved = dict(zip(names, 1 + 0.2 * rng.standard_normal(len(names)), strict=True))
        given = {name: START[name] * factor for name, factor in moved.items()}
        K, M = model.stiffness(given), model.mass(given)
        if turn >= n_turns - 2:
            assert_same(K, fresh.stiffness(given), 1e-13)
            assert_same(M, fresh.mass(given), 1e-13)


def test_sums_are_not_made_for_a_few_solutions(monkeypatch):
    """Samples take longer than the integrals that they save: these come first, then none at all."""
    model, whole, others = plates("uncoupled"), [], []
    own = model.assembled

    def counted(form, out=None, diagonal=0.0):
        (whole if diagonal else others).append(form)
        return own(form, out, diagonal)

    monkeypatch.setattr(model, "assembled", counted)
    for turn in range(6):
        before = len(whole), len(others)
        model.stiffness({"E": 7e10 + 1e8 * turn}).destroy()
    assert before == (len(whole), len(others))
    # Two of the support; of a part's modulus one sample, of a joint that does not stretch two.
    assert len(whole) < 4 and len(others) <= 2 + 1 + 2 + 2
