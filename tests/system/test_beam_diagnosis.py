"""The diagnosis of lapped beams, on virtual tests from finer elements whose cause is known."""

from __future__ import annotations

import numpy as np
import pytest
from case_tables import write_frequencies
from mpi4py import MPI
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, multivariate_t, norm
from virtual_beams import beams

from fenics_joints.beams import Beam, BeamStructure, Clamp, GenericJoint, Held, LumpedMass
from fenics_joints.beams.element import BEAM
from fenics_joints.beams.structure import cell_energies
from fenics_joints.case import load_case
from fenics_joints.commands.diagnose.document import diagnosis_document
from fenics_joints.commands.diagnose.words import zone_words
from fenics_joints.diagnosis import diagnose
from fenics_joints.diagnosis.effects.joint import LOW_PRELOAD
from fenics_joints.diagnosis.evidence import fit
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.diagnosis.location import locate_gap
from fenics_joints.diagnosis.model.prepared import prepare
from fenics_joints.diagnosis.plan.planned import plan
from fenics_joints.diagnosis.zones.laps import lap_as_one, lap_zones
from fenics_joints.errors import InputError
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress
from fenics_joints.reduction import BatchPrediction, ModalPrediction
from fenics_joints.report.html import as_page

STEEL = {"E": 208e9, "nu": 0.3, "rho": 7860.0}
WIDTH, HEIGHT, LAP, K1, K2 = 0.021, 0.0106, 0.05, 1763.2, 37402.0
N_MODES = 8
QUIET = Progress(silent=True)
CASE = (
    beams()
    + """bolted = true
[masses.bolt]
mass = 0.012
points = [[0.335, 0, 0]]
[attached.cable]
kind = "mass"
mass = "15 g"
points = [[0.5, 0, 0]]
[test]
frequencies = "frequencies.csv"
condition = "torque"
noise = "0.05 %"
[test.sees]
along = "x"
positions = [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.36, 0.4, 0.45, 0.5, 0.57]
direction = [0, 0, 1]
[diagnose]
n_modes = 16
joints = "given"
nested = 0
discrepancy = "0.3 %"
"""
)


def measured(
    slap=(1.0,) * 5, slip=(1.0,) * 5, axial=1.0, cable=0.0, seed=1, missed=None
) -> np.ndarray:
    """Frequencies, Hz, with noise, from elements half as long as the diagnosed ones."""
    # Half an element has half the slap and twice the slip (eq. 2 with phi far above 1).
    k1 = np.repeat(np.array(slap) * K1 / 2, 2).tolist()
    k2 = np.repeat(np.array(slip) * K2 * 2, 2).tolist()
    both = [
        Beam("upper", 0.36, WIDTH, HEIGHT, 62, **STEEL),
        Beam("lower", 0.26, WIDTH, HEIGHT, 42, **STEEL),
    ]
    masses = [LumpedMass("bolt", 0.012, (0.335, 0, 0)), LumpedMass("cable", cable, (0.5, 0, 0))]
    model = BeamStructure(both, [GenericJoint("lap", LAP, 10, k1, k2, axial=axial)], masses=masses)
    modes = solve_modes(model, n_modes=N_MODES + 4)
    hz = modes.frequencies_hz[modes.n_rigid :]
    hz = hz[:-1] if missed is None else np.delete(hz, missed)
    return hz * np.exp(5e-4 * np.random.default_rng(seed).standard_normal(N_MODES))


def write_case(folder, hz, *more: str, text: str = CASE):
    write_frequencies(folder, hz, "mode", "torque [N·m]", [23.0])
    (folder / "case.toml").write_text("\n".join([text, *more]), encoding="utf-8")
    return load_case(folder)


def reduced(case):
    model = prepare(case, MPI.COMM_SELF, QUIET)
    model.reduce(QUIET)
    return model


GRADED = {"slap": (2.5, 1.0, 0.4, 1.0, 2.5)}


@pytest.mark.parametrize(
    ("truth", "cause", "region"),
    [
        (GRADED, "joint slap stiffness graded by the distance from the bolt", "lap"),
        ({"cable": 0.02}, "cable mass", "cable"),
    ],
)
def test_the_cause_is_named(tmp_path, truth, cause, region):
    case = write_case(tmp_path, measured(**truth), "max_effects = 1", "patches = 0")
    result = diagnose(case, MPI.COMM_SELF)
    assert result.verdict == "cause", result.summary
    assert result.effects[0].name == cause, result.effects[:4]
    assert result.after.rms < 0.3 * result.before.rms
    shares = {zone.region: zone.share for zone in result.where}
    assert max(shares, key=shares.get) == region
    assert result.model_error == 0.0
    if truth is GRADED:
        leader = next(h for h in result.hypotheses if h.label == cause)
        rows = [row for row in leader.parameters if not row["nuisance"]]
        for row, factor in zip(rows, (0.4, 1.0, 2.5), strict=True):
            sd = 0.5 * np.log(row["high"] / row["low"])
            assert abs(np.log(row["value"] / factor)) < max(2 * sd, 0.1)


def test_no_gap_is_said(tmp_path):
    case = write_case(tmp_path, measured(), "max_effects = 1")
    result = diagnose(case, MPI.COMM_SELF)
    assert result.verdict == "no gap", result.summary
    reasons = {s.effect: s.reason for s in result.silent}
    assert "no loss of contact takes" in reasons["contact lost at low pressure"]
    assert "shapes" in reasons["sensor misplaced"]
    page = as_page(diagnosis_document(result))
    assert "Virtual beams" in page and "seen from the side" in page


def test_patches_and_zones_say_where(tmp_path):
    """The zone tests find a lap that is softer in one stretch, and the patches find the place of a
    cable whose mass the nominal model lacks."""
    soft = {"slap": (1, 0.5, 1, 1, 1), "slip": (1, 0.5, 1, 1, 1)}
    cases = ((soft, "lap", "lap", 0.32, 0.33), ({"cable": 0.02}, "cable", "beams", 0, 1))
    for truth, region, place, low, high in cases:
        model = reduced(write_case(tmp_path, measured(**truth)))
        location = locate_gap(model)
        found, first = location.patches, location.ranked[0]
        assert first.region == location.shares[0].region == region and first.log_f < 0
        alone = np.flatnonzero(found.sufficient)
        best = max(alone, key=lambda i: found.tests[i].log_odds)
        assert found.region[best] == place
        assert low <= found.middle[best, 0] <= high
        if place == "beams":
            cells = model.full.cells
            x = cells.vertices[found.patch == best][:, :, 0]
            assert x.min() <= 0.5 <= x.max()


@pytest.mark.parametrize("axial", ["", "k_axial = 4.6e9"])
def test_energies_of_elements_are_all_there_is(tmp_path, axial):
    """By Rayleigh: of free beams all cells' energies together are the eigenvalues."""
    text = CASE.replace("k2 = 37402.0", f"k2 = 37402.0\n{axial}")
    model = prepare(write_case(tmp_path, measured(), text=text), MPI.COMM_SELF, QUIET)
    modes = solve_modes(model.full, model.baseline, n_modes=12)
    found = cell_energies(model.full, modes.shapes, model.baseline)
    np.testing.assert_allclose(found.pop("rho").sum(axis=0)[3:], 1.0, atol=0.05)
    total = sum(values.sum(axis=0) for values in found.values())
    np.testing.assert_allclose(total[3:], modes.eigenvalues[3:], rtol=1e-8)
    assert bool(axial) == np.any(found["k_axial"][:, 3:] > 0)


def test_evidence_of_a_missed_mode_is_that_of_a_sampler(tmp_path):
    """Importance sampling of the whole likelihood, tolerances and scales of errors; and with the
    mode missed the test is explained."""
    model = reduced(write_case(tmp_path, measured(missed=4)))
    named = {effect.key: effect for effect in model.effects}
    keys = "mode missed by the test (mode 5)", "joint slap stiffness (joint)"
    for chosen in (keys, [*keys[:1], "modulus error (beams)"]):
        hypothesis = model.hypothesis([named[key] for key in chosen])
        found = fit(hypothesis, model.forward, model.evidence, model.baseline)
        assert found.p_value > 0.05
        log_z, error = drawn(model, found)
        assert error < 0.03
        assert found.log_evidence == pytest.approx(log_z, abs=0.08), chosen
    # The batched prediction takes the threshold of visible modes from the model it was made of.
    lean = BatchPrediction(model.forward, model.forward.model)
    usual = ModalPrediction(lean.model, None, 1, 1).threshold
    assert lean.threshold == model.forward.threshold != usual
    for a, b in ((lean, model.forward), (lean.further, model.forward.further)):
        prepared = a.log_f_at([model.baseline])[0]
        np.testing.assert_allclose(prepared, b(model.baseline)[0], rtol=1e-9)


def drawn(model, found, count=1000) -> tuple[float, float]:
    """ln Z by importance sampling from a wide Student distribution about a fit, and its error."""
    h, evidence = found.hypothesis, model.evidence
    many = ManyPredictions(h, model.forward, evidence, model.baseline)
    used, (low, high) = evidence.fitted, h.limits.T
    proposal = multivariate_t(found.z, 1.2 * found.covariance, df=5, seed=1)
    z = proposal.rvs(count)
    z = z[np.all((z > low) & (z < high), axis=1)]
    predicted = many(z)[0][:, used]
    there = np.isfinite(predicted).all(axis=1)
    z, predicted = z[there], predicted[there]
    log_l = []  # over all scales of the stated errors
    for scale, weight in evidence.scales.tried():
        lower = evidence.at(scale).lower()
        law = multivariate_normal(evidence.data[used], lower @ lower.T)
        log_l.append(weight + law.logpdf(predicted))
    log_w = np.full(count, -np.inf)
    log_w[: len(z)] = logsumexp(log_l, axis=0) + norm.logpdf(z).sum(axis=1) - proposal.logpdf(z)
    log_w -= np.log(norm.cdf(high) - norm.cdf(low)).sum()
    w = np.exp(log_w - log_w.max())
    return np.log(w.mean()) + log_w.max(), w.std() / w.mean() / np.sqrt(count)


def test_a_lap_as_one_piece_is_a_beam_of_twice_the_height(tmp_path):
    text = CASE.replace('joints = "given"', "")
    model = prepare(write_case(tmp_path, measured(), text=text), MPI.COMM_SELF, QUIET)
    q = (
        STEEL
        | dict.fromkeys(("stretch", "width"), 1.0)
        | dict.fromkeys(("offset", "mass_offset"), 0.0)
    )
    q |= {"height": 2 * HEIGHT, "breadth": WIDTH, "length": LAP / 5, "shear": 1.2}
    _, _, bending, shear = BEAM.stiffness_terms(q)
    assert model.baseline["lap_s3.k2"] == pytest.approx(bending * 5 / LAP, rel=1e-9)
    assert model.baseline["lap_s3.k1"] == pytest.approx(3 * shear * 5 / LAP, rel=1e-9)
    # And it goes with its parts: 10 % more height is 33 % more bending stiffness.
    thicker = next(e for e in model.effects if e.key == "thickness error (beams)")
    values = dict(model.baseline)
    thicker.apply(values, {"factor": 1.1}, 23.0)
    assert values["lap_s3.k2"] == pytest.approx(1.331 * model.baseline["lap_s3.k2"])
    assert values == values | lap_as_one(model.case, model.zones, values)
    soft = next(e for e in model.effects if e.key == "joint slip stiffness (joint)")
    soft.apply(values, {"slip": 0.5}, 23.0)
    assert values["lap_s3.k2"] == pytest.approx(1.331 / 3 * model.baseline["lap_s3.k2"])


def test_elastic_ends_become_held_ones():
    beam = Beam("beam", 0.5, WIDTH, HEIGHT, 12, **STEEL)
    held = BeamStructure([beam], held=[Held(0.0)])
    clamp = [Clamp("left", False, 1e19, 1e19)]
    hz = solve_modes(BeamStructure([beam], clamps=clamp), n_modes=4).frequencies_hz
    np.testing.assert_allclose(hz, solve_modes(held, n_modes=4).frequencies_hz, rtol=1e-5)
    # A stiff beam on a soft foot sways as a body on springs: z, and the turn about the face.
    foot = [Clamp("left", False, 1e6, 1e3)]
    sway = solve_modes(BeamStructure([beam], clamps=foot), n_modes=1).frequencies_hz[0]
    A, m, L = WIDTH * HEIGHT, STEEL["rho"] * WIDTH * HEIGHT * 0.5, 0.5
    turn = 1e6 * A * HEIGHT**2 / 12
    K = np.array([[1e3 * A, 0], [0, turn]])
    M = m * np.array([[1, L / 2], [L / 2, L**2 / 3 + HEIGHT**2 / 12]])
    exact = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).min()) / (2 * np.pi)
    assert sway == pytest.approx(exact, rel=1e-3)


def test_zones_of_laps(tmp_path):
    """Five zones, symmetric about the bolt or about the middle; and bad bolts."""
    finer = CASE.replace("lap_elements = 5", "lap_elements = 8")
    case = write_case(tmp_path, measured(), text=finer)
    zones = lap_zones(case)
    assert [zones.laps[0].zones.count(z) for z in zones.names] == [2, 1, 2, 1, 2]
    by_distance = zones.gradings["by the distance from the bolt"]
    assert [len(group) for group in by_distance.values()] == [1, 2, 2]
    assert zone_words(zones.names[1]) == "lap, stretch 2"
    off = CASE.replace("bolted = true", "bolts = [[0.32, 0, 0]]")
    zones = lap_zones(write_case(tmp_path, measured(), text=off))
    by_distance = zones.gradings["by the distance from the bolt"]
    assert next(iter(by_distance.values())) == ("lap_s1", "lap_s2")
    beside = CASE.replace("bolted = true", "bolts = [[0.3, 0, 0]]")
    wrong = write_case(tmp_path, measured(), text=beside)
    with pytest.raises(InputError, match=r"lap.bolts\[0\].*0.31 to 0.36"):
        lap_zones(wrong)
    taken = CASE.replace("[masses.bolt]", "[masses.lap_s1]")
    with pytest.raises(InputError, match="'lap_s1' is needed for a zone"):
        lap_zones(write_case(tmp_path, measured(), text=taken))


def test_laps_without_bolts(tmp_path):
    """Two laps of two sections have no effects of bolts where no bolts are given."""
    text = CASE.replace("laps = 0.05", "laps = [0.05, 0.06]").replace("bolted = true", "")
    for old, new in {
        "[0.36, 0.26]": "[0.36, 0.26, 0.3]",
        "[12, 9]": "[12, 9, 9]",
        '["beam_1", "beam_2"]': '["beam_1", "beam_2", "beam_3"]',
        "[joints.lap]": "[joints.a_s]",
        'cells = "lap"': 'cells = ["lap_1", "lap_2"]',
    }.items():
        text = text.replace(old, new)
    case = write_case(tmp_path, measured(), text=text)
    model = prepare(case, MPI.COMM_SELF, QUIET)
    assert not model.zones.by("bolt") and not len(model.zones.bolts)
    assert not any("bolt" in e.name or "preload" in e.name for e in model.effects)
    assert "no lap has a bolt" in {s.effect: s.reason for s in model.silent}[LOW_PRELOAD]
    free = next(e for e in model.effects if e.name == "joint slip stiffness graded zone by zone")
    assert [p.name for p in free.priors][5] == "lap_2 stretch 1, slip"
    text = text.replace('["lap_1", "lap_2"]', '["lap_1", "lap_2"]\nbolts = [[0.54, 0, 0]]')
    zones = lap_zones(write_case(tmp_path, measured(), text=text))
    assert zones.by("bolt") == {"bolt 1": zones.names[5:]}
    text = text.replace("[[0.54, 0, 0]]", "[[0.54, 0, 0], [0.4, 0, 0]]")
    with pytest.raises(InputError, match=r"bolts\[1\].*0.31 to 0.36 or 0.51 to 0.57 m"):
        lap_zones(write_case(tmp_path, measured(), text=text))
    left = '[joints.left]\ncells = "zone_1"\nlaw = "generic"\nk1 = 1763.2\nk2 = 37402.0\n'
    zoned = CASE.replace("lap_elements = 5", "lap_elements = 5\nlap_zones = [2, 3]")
    zoned = zoned.replace("[joints.lap]", f"{left}[joints.lap]")
    zoned = zoned.replace('cells = "lap"', 'cells = "zone_2"\nk_axial = 1e9')
    with pytest.raises(InputError, match="joints.lap.k_axial: expected none"):
        lap_zones(write_case(tmp_path, measured(), text=zoned))


def test_a_plan_of_a_test_on_beams(tmp_path):
    joint = '"joint slap stiffness", "joint slip stiffness", "joint axial stiffness"'
    case = write_case(tmp_path, measured(), f'effects = [{joint}, "cable mass"]')
    found = plan(case, MPI.COMM_SELF)
    assert not found.classes
    # One more measurement shows what the eight frequencies do not surely detect.
    unseen = [e.name for e in found.effects if e.distance < 2.33]
    assert sorted(unseen) == ["cable mass", "joint axial stiffness"]
    best = found.additions[0]
    assert best.measurement.startswith("the mode shapes") and best.seen == 4


@pytest.mark.skipif(MPI.COMM_WORLD.size == 1, reason="compares two ranks with one")
@pytest.mark.parallel
def test_two_ranks_say_the_same(tmp_path_factory):
    comm = MPI.COMM_WORLD
    folder = comm.bcast(tmp_path_factory.mktemp("beams") if comm.rank == 0 else None)
    if comm.rank == 0:
        listed = 'effects = ["joint slap stiffness", "joint axial stiffness"]'
        write_case(folder, measured(axial=0.3), listed)
    comm.barrier()
    case = load_case(folder)
    ours, alone = diagnose(case, comm), diagnose(case, MPI.COMM_SELF)
    # One mode depends on it: if that is held out, the best rival predicts nearly as well.
    assert ours.verdict == alone.verdict == "likely"
    for a, b in zip(ours.hypotheses, alone.hypotheses, strict=True):
        assert a.label == b.label and a.log_evidence == pytest.approx(b.log_evidence, abs=1e-6)
    shares = ours.location.patches.share
    np.testing.assert_allclose(shares, alone.location.patches.share, atol=1e-9)
