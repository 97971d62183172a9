"""Zones: the values that they start from, and which bolts are one."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

pytest.importorskip("dolfinx")

from effect_rig import RIG

from fenics_joints.case import Case
from fenics_joints.diagnosis.zones.joints import LayerZone, placed
from fenics_joints.diagnosis.zones.zone import bonded_values
from fenics_joints.forms import lame_from_moduli


def test_given_joints_are_those_of_the_case():
    data = {
        **RIG,
        "joints": {
            "near": RIG["joints"]["near"],
            "away": {"cells": "joint_away", "law": "isotropic", "E": 1e9, "G": 4e8},
        },
    }
    case = Case.model_validate(data | {"diagnose": {"joints": "given"}})
    values = bonded_values(case)
    assert (values["near.E"], values["near.G"]) == (1e9, 4e8)
    # lambda + 2 G of E = 1 GPa, nu = 0.25.
    assert values["away.E"] == pytest.approx(1.2e9) and values["away.G"] == 4e8
    assert sum(lame_from_moduli(1e9, 4e8)) + 4e8 == pytest.approx(1.2e9)
    bonded = bonded_values(Case.model_validate(data))
    assert bonded["near.E"] == pytest.approx(2e11 * 0.7 / (1.3 * 0.4))
    with pytest.raises(ValueError, match="joints"):
        Case.model_validate(data | {"diagnose": {"joints": "glued"}})


def zones_at(joints, axes):
    """Zones without a mesh, two rings each."""
    rows = [
        LayerZone(f"{joint}_b1_r{ring}", joint, 1.0, 1, ring, span, axis)
        for joint, axis in zip(joints, axes, strict=True)
        for ring, span in ((1, (0.0, 5e-3)), (2, (6e-3, 9e-3)))
    ]
    own = {row.name: SimpleNamespace(bolted=False, normal=(0.0, 0.0, 1.0)) for row in rows}
    return placed(SimpleNamespace(joints=own), rows)


def test_bolts_of_stacked_layers_are_one_and_those_of_other_joints_are_not():
    stacked = zones_at(["low", "up"], [[0.1, 0, 0], [0.1, 0, 0.02]])
    assert stacked.by("bolt") == {"bolt 1": stacked.names}
    assert stacked.places == {}
    apart = zones_at(["left", "right"], [[0, 0, 0], [0.5, 0, 0]])
    assert apart.by("bolt") == {"bolt 1": apart.names[:2], "right bolt 1": apart.names[2:]}
    # A joint with one bolt is that bolt's place.
    assert apart.places == {"joint": {"left": apart.names[:2], "right": apart.names[2:]}}
    assert apart.away == ("left_b1_r2", "right_b1_r2")
    (grading,) = apart.gradings
    assert grading.groups == {
        "ring 1": ("left_b1_r1", "right_b1_r1"),
        "ring 2": ("left_b1_r2", "right_b1_r2"),
    }


def test_screws_in_line_in_one_joint_are_two():
    """As at both ends of a wall; and of joints whose bolts the mesh knows, by where they are."""
    rows = [
        LayerZone(f"{joint}_b{bolt}_r1", joint, 1.0, bolt, 1, (0.0, 5e-3), (0.1, 0, z), True, face)
        for joint, bolt, z, face in (
            ("all", 1, 0.0, "base and wall"),
            ("all", 2, 0.07, "wall and lid"),
            ("foot", 1, 0.0, ""),
            ("top", 1, 0.2, ""),
        )
    ]
    own = {row.name: SimpleNamespace(bolted=False, normal=(0.0, 0.0, 1.0)) for row in rows}
    found = placed(SimpleNamespace(joints=own), rows)
    assert found.by("bolt") == {
        "bolt 1": ("all_b1_r1", "foot_b1_r1"),
        "bolt 2": ("all_b2_r1",),
        "top bolt 1": ("top_b1_r1",),
    }
    # Faces of one joint are places of their own, but for what a bolt holds together.
    assert found.places["joint"] == {
        "base and wall, foot": ("all_b1_r1", "foot_b1_r1"),
        "wall and lid": ("all_b2_r1",),
        "top": ("top_b1_r1",),
    }
