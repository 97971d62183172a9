"""Zones: the values that they start from, and which bolts are one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from effect_rig import RIG

from fenics_joints.case import Case
from fenics_joints.diagnosis.zones.joints import bolt_labels, with_places
from fenics_joints.diagnosis.zones.zone import Zone, bonded_values, equal_shares
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


def zones_at(*bolts, rings=1, given=()):
    """Zones without a mesh, of bolts: joint, point on the axis, and face."""
    sections = {
        joint: SimpleNamespace(
            bolted=False, normal=(0.0, 0.0, 1.0), bolts=[] if joint in given else None
        )
        for joint, *_ in bolts
    }
    points = {joint: [at for j, at, _ in bolts if j == joint] for joint in sections}
    case = SimpleNamespace(joints=sections)
    labels = {joint: iter(each) for joint, each in bolt_labels(case, points, 1e-5).items()}
    spans = ((0.0, 5e-3), (6e-3, 9e-3))[:rings]
    zones = [
        Zone(
            f"{joint}_b{n}_r{ring}",
            joint=joint,
            held=face or joint,
            bolt=label,
            ring=ring,
            distance=span,
        )
        for n, (joint, _, face) in enumerate(bolts, start=1)
        for label in [next(labels[joint])]
        for ring, span in enumerate(spans, start=1)
    ]
    own = {zone.name: sections[zone.joint] for zone in zones}
    return with_places(SimpleNamespace(joints=own), zones)


def test_bolts_of_stacked_layers_are_one_and_those_of_other_joints_are_not():
    stacked = zones_at(("low", [0.1, 0, 0], ""), ("up", [0.1, 0, 0.02], ""), given=("low", "up"))
    assert stacked.by("bolt") == {"bolt 1": stacked.names}
    assert stacked.places == {}
    apart = zones_at(("left", [0, 0, 0], ""), ("right", [0.5, 0, 0], ""), rings=2)
    names = apart.names
    assert apart.by("bolt") == {"bolt 1": names[:2], "right bolt 1": names[2:]}
    # A joint with one bolt is that bolt's place.
    assert apart.places == {"joint": {"left": names[:2], "right": names[2:]}}
    assert apart.away == names[1::2]
    groups = {"ring 1": names[::2], "ring 2": names[1::2]}
    assert apart.gradings == {"from zone to zone": groups}


def test_screws_in_line_in_one_joint_are_two():
    """As at both ends of a wall; and of joints whose bolts the mesh knows, by where they are."""
    found = zones_at(
        ("all", [0.1, 0, 0.0], "base and wall"),
        ("all", [0.1, 0, 0.07], "wall and lid"),
        ("foot", [0.1, 0, 0.0], ""),
        ("top", [0.1, 0, 0.2], ""),
    )
    low, high, foot, top = ((name,) for name in found.names)
    assert found.by("bolt") == {"bolt 1": low + foot, "bolt 2": high, "top bolt 1": top}
    # Faces of one joint are places of their own, but for what a bolt holds together.
    assert found.places["joint"] == {
        "base and wall, foot": low + foot,
        "wall and lid": high,
        "top": top,
    }


def test_groups_have_equal_shares_and_equal_values_stay_together():
    values = np.array([5.0, 1.0, 1.0, 2.0, 1.0 + 1e-9, 4.0])
    weights = np.array([1.0, 1.0, 1.0, 3.0, 1.0, 2.0])
    assert equal_shares(values, weights, 3).tolist() == [2, 0, 0, 1, 0, 2]
    assert equal_shares(np.ones(4), np.ones(4), 3).tolist() == [0] * 4
