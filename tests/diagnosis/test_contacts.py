"""A bolted contact as zones of a layer: against separate bodies, and on virtual tests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.case import build_preload, build_structure, load_case
from fenics_joints.diagnosis import diagnose
from fenics_joints.diagnosis.effects.joint import lost_contact
from fenics_joints.diagnosis.zones.contacts import contact_zones
from fenics_joints.modal import solve_modes
from fenics_joints.preload import solve_preload
from fenics_joints.preload.linear_joint import LinearJoint
from fenics_joints.updating import CutoffModel

DEMO = Path(__file__).resolve().parents[2] / "demos" / "c_beam"


def on_mesh(degree: int, size: float, middle: float, **diagnose):
    """The demo's case on another mesh."""
    case = load_case(DEMO).diagnosed()
    change = {
        "degree": degree,
        "element_size": size,
        "radial_size": size / 2,
        "middle_size": middle,
        "n_thickness": (1, 1),
    }
    return case.model_copy(
        update={
            "mesh": case.mesh.model_copy(update=change),
            "diagnose": case.diagnose.model_copy(update=diagnose),
        }
    )


def elastic(model, given=None) -> np.ndarray:
    return solve_modes(model, given, n_modes=12).frequencies_hz[6:12]


@pytest.mark.parallel
def test_layer_loses_contact_as_separate_bodies_do():
    """Two ways to one contact: zones of a layer, and pairs of vertices held or free."""
    comm = MPI.COMM_WORLD
    case = on_mesh(2, 8e-3, 60e-3)
    model = build_preload(case, comm)
    pairs = CutoffModel(solve_preload(model))
    zones = contact_zones(case, comm, 12)
    layer = build_structure(zones.case, comm, tagged=zones.tagged)
    effect = lost_contact(zones.all)
    # Each cell of the layer got the pressure of its own facet: areas and forces agree.
    volumes = layer.volumes()[1:] / zones.all[0].thickness
    area = np.array([zone.area for zone in zones])
    assert volumes == pytest.approx(area, rel=1e-9)
    state = next(iter(pairs.states))
    low, high = np.array([zone.pressure for zone in zones]).T
    assert low @ area <= state.normal_force <= high @ area
    # As stiff as the bodies it is as good as none. Bolts as masses for bolts as beams are in this.
    stuck = elastic(LinearJoint(model))
    nominal = elastic(layer)
    assert nominal == pytest.approx(stuck, rel=6e-3)
    for cutoff in (6e6, 30e6):
        values = layer.values()
        effect.apply(values, {"cutoff": cutoff}, 0.0)
        fall = elastic(layer, values) / nominal - 1
        known = pairs.solve(pairs.step_at(cutoff)).frequencies_hz[6:12] / stuck - 1
        # The layer's zones are wider than the facets' steps.
        assert fall == pytest.approx(known, rel=0.2, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["contact lost at low pressure", "modulus error"])
def test_virtual(cause):
    """Data of two bodies on a finer mesh, with noise: lost contact is found, and not elsewhere."""
    comm = MPI.COMM_WORLD
    finer = build_preload(on_mesh(2, 4e-3, 30e-3), comm)
    if cause == "modulus error":
        truth = elastic(LinearJoint(finer), {"beams.E": 0.8 * 194e9})
    else:
        pairs = CutoffModel(solve_preload(finer))
        step = pairs.step_at(20e6)
        truth = pairs.solve(step).frequencies_hz[6:12]
    few = {"samples": 4, "max_effects": 1, "zones": 12, "patches": 0}
    case = on_mesh(2, 6e-3, 60e-3, **few)
    noise = np.random.default_rng(1).normal(0, 2e-3, 6)
    data = replace(case.measurements(), frequencies_hz=(truth * np.exp(noise))[None])
    found = diagnose(case, comm, data=data)
    lead = found.hypotheses[0]
    assert found.verdict == "cause"
    by_name = {e.name: e for e in found.effects}
    assert by_name[cause].probability > 0.3
    if cause == "modulus error":
        assert by_name["contact lost at low pressure"].probability < 0.01
        return
    alone = ("contact lost at low pressure (joint)",)
    lost = next(h for h in found.hypotheses if h.effects == alone)
    (fitted,) = (p["value"] for p in lost.parameters if p["name"] == "cutoff")
    # Within the pressures of neighbouring zones.
    assert 12e6 < fitted < 30e6
    # The wrong parts are told apart, and held-out modes are predicted better than by any of them.
    assert lead.effects[0].endswith("(joint)")
    assert found.heldout_after < 0.5 * found.placebo_after
