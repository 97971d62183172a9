"""Pairing of modes by what a test could see, and the gap between the two."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.errors import InputError
from fenics_joints.measurements import Gap, mac, pair_modes
from fenics_joints.measurements.gap import largest_difference, partnered, rms, skipped
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.surrogate import ReducedModel
from fenics_joints.structure import Parameter, Sensors, Structure, part

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="writes a case in a folder")

LENGTH, WIDTH = 0.3, 0.06
FINE = np.array([[x, WIDTH / 2, 0.006] for x in np.linspace(0.01, 0.29, 25)])
LINE = FINE[::3]
ACROSS, FINELY = (Sensors(points, [0.0, 0.0, 1.0]) for points in (LINE, FINE))


@pytest.fixture(scope="module")
def strip():
    """A free strip, 6 mm thick as meshed, that can be made thicker: its modes then cross."""
    body = part("strip", "body", E=69e9, nu=0.3, rho=2700.0, stretch="t")
    tagged = box(MPI.COMM_SELF, (LENGTH, WIDTH, 0.006), (10, 2, 1))
    return Structure(tagged, [body], [Parameter("t", 1.0)])


@pytest.fixture(scope="module")
def modes(strip):
    return solve_modes(strip, n_modes=24)


def kinds(modes):
    """Kind of each mode by its motion along and across the strip: an independent look at it."""
    edge = LINE + [0.0, WIDTH / 2, 0.0]
    middle = modes.at(ACROSS)
    twist = modes.at(Sensors(edge, [0.0, 0.0, 1.0])) - middle
    plane = modes.at(Sensors(LINE, [0.0, 1.0, 0.0]))
    size = np.array([np.sum(a**2, axis=0) for a in (middle, twist, plane)])
    return [("bending", "torsion", "in plane")[i] for i in np.argmax(size, axis=0)]


def test_a_test_that_lacks_the_lowest_modes_is_noticed(modes):
    """A lone driven mode is the fourth; all lower, or a few off a little, are no reason."""
    f = modes.frequencies_hz[6:]
    assert skipped(0.9 * f[3:4], f) == 3
    assert skipped(1.1 * f[1:4], f) == 1
    assert [skipped(scale * f[:3], f) for scale in (0.5, 0.8, 1.2)] == [0, 0, 0]


def test_torsion_and_in_plane_modes_between_are_left_out(modes):
    kind = kinds(modes)
    pairing = pair_modes(modes, 4, ACROSS)
    bending = [i for i in range(modes.n_rigid, 16) if kind[i] == "bending"]
    assert pairing.index.tolist() == bending[:4]
    assert {i for i in pairing.visible if i < 16} == set(bending)
    between = {kind[i] for i in range(pairing.index[0], pairing.index[-1])}
    assert between == {"bending", "torsion", "in plane"}
    # Euler and Bernoulli's free strip, which knows no other modes.
    beta = np.array([4.73004, 7.85320]) / LENGTH
    exact = beta**2 * np.sqrt(69e9 * 0.006**2 / 12 / 2700) / (2 * np.pi)
    assert modes.frequencies_hz[pairing.index[:2]] == pytest.approx(exact, rel=0.02)
    # A test that says nothing of what it saw takes them in order.
    assert pair_modes(modes, 4).index.tolist() == [6, 7, 8, 9]


def test_crossing_modes_are_followed_by_shape_and_not_by_order(strip):
    """Thicker, the strip bends at higher frequencies and moves in its plane at the same ones."""
    both = Sensors(
        np.vstack([LINE, LINE]), np.repeat([[0, 0, 1.0], [0, 1.0, 0]], len(LINE), axis=0)
    )
    thin, thick = (solve_modes(strip, {"t": t}, n_modes=18) for t in (1.0, 2.5))
    start = pair_modes(thin, 4, both)
    kind = [kinds(thin)[i] for i in start.index]
    first = kind.index("in plane")
    assert first > 0 and kind[first - 1] == "bending"
    by_order = pair_modes(thick, 4, both)
    assert [kinds(thick)[i] for i in by_order.index] != kind
    followed = pair_modes(thick, 4, both, reference=start.shapes)
    assert [kinds(thick)[i] for i in followed.index] == kind
    assert followed.crossing == ((first - 1, first),)
    assert start.crossing == by_order.crossing == ()
    assert np.all(followed.mac > 0.95)
    in_plane = [m.frequencies_hz[p.index[first]] for m, p in ((thin, start), (thick, followed))]
    assert in_plane[1] == pytest.approx(in_plane[0], rel=5e-3)


def test_of_modes_that_look_alike_at_few_sensors_the_near_one_counts(strip):
    """At the middle and the ends many bending modes look alike, and by MAC alone noise decides."""
    few = Sensors([LINE[0], LINE[4], LINE[8]], [0.0, 0.0, 1.0])
    modes = solve_modes(strip, n_modes=40)
    exact = pair_modes(modes, 3, few)
    noise = np.random.default_rng(3).normal(0.0, 0.05, (20, *exact.shapes.shape))
    for each in noise:
        measured = exact.shapes * (1.0 + each)
        found = mac(measured, modes.at(few)[:, exact.visible])
        alike = np.sum(found > 0.95, axis=1)
        assert alike.max() > 1  # or this test says nothing
        assert pair_modes(modes, 3, few, reference=measured).index.tolist() == exact.index.tolist()


def test_too_few_visible_modes_say_what_to_do(strip):
    modes = solve_modes(strip, n_modes=9)
    with pytest.raises(InputError, match=r"n_modes = 9: .* expected at least 6. Compute more"):
        pair_modes(modes, 6, ACROSS)
    with pytest.raises(InputError, match="has 3 modes below .* expected at least 4"):
        pair_modes(modes, 4)


def test_mac_by_hand():
    a = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    b = np.array([[2.0, 0.0], [0.0, -3.0]])
    assert mac(a, b) == pytest.approx(np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 0.0]]))
    angle = 0.3
    turned = np.array([[np.cos(angle)], [np.sin(angle)]])
    assert mac(b[:, :1], turned) == pytest.approx(np.cos(angle) ** 2)
    # Complex shapes: a common phase does not matter.
    assert mac(turned * np.exp(0.7j), -turned) == pytest.approx(1.0)
    a, b = np.array([[1.0, 0.2], [2.0, -1.0]]), np.array([[1.0, 0.0], [1.5, 0.0]])
    for unit in (1e-90, 1e90):
        assert mac(unit * a, b / unit) == pytest.approx(mac(a, b), rel=1e-12)


def test_mac_leaves_missing_sensors_out_mode_by_mode():
    """As if each shape had been compared over the sensors that measured it alone."""
    rng = np.random.default_rng(4)
    a, b = rng.standard_normal((6, 3)), rng.standard_normal((6, 4))
    a[1, 0] = a[4, 0] = a[5, 2] = np.nan
    found = mac(a, b)
    for i, column in enumerate(a.T):
        there = np.isfinite(column)
        assert found[i] == pytest.approx(mac(column[there, None], b[there])[0], rel=1e-12)
    a[:, 1] = np.nan
    assert np.array_equal(mac(a, b)[1], np.zeros(4))
    # A model's own shapes are found again through the gaps.
    gappy = b[:, [2, 0, 3]].copy()
    gappy[0, 0] = gappy[3, 2] = np.nan
    assert mac(gappy, b).argmax(axis=1).tolist() == [2, 0, 3]
    assert mac(gappy, b).max(axis=1) == pytest.approx(np.ones(3))


def test_gap_leaves_missing_data_out():
    test = np.array([[100.0, 200.0], [np.nan, 250.0]])
    model = np.array([[110.0, 190.0], [120.0, 250.0]])
    gap = Gap(np.array([5.0, 10.0]), ["a", "b"], test, model)
    assert gap.rms == pytest.approx(np.sqrt((0.1**2 + 0.05**2) / 3))
    assert gap.by_mode() == pytest.approx([0.1, 0.05 / np.sqrt(2)])
    assert gap.by_condition() == pytest.approx([np.sqrt((0.1**2 + 0.05**2) / 2), 0.0])
    assert np.isnan(gap.relative[1, 0])
    assert rms([0.3, np.nan, -0.4]) == pytest.approx(np.sqrt(0.125))


def test_modes_that_are_like_none_go_by_their_order(modes):
    """Beside well-matched ones, a shape that no mode has is the next mode, not a far one that is a
    little more like it."""
    plain = pair_modes(modes, 4, FINELY)
    shapes = modes.at(FINELY)
    odd = plain.shapes.copy()
    # Unlike all that are seen, but for a little of the highest.
    basis = np.linalg.qr(shapes[:, plain.visible])[0]
    noise = np.random.default_rng(2).standard_normal(len(odd))
    noise -= basis @ (basis.T @ noise)
    last = shapes[:, plain.visible[-1]]
    odd[:, 2] = noise / np.linalg.norm(noise) + 0.5 * last / np.linalg.norm(last)
    match = mac(odd, shapes[:, plain.visible])[2]
    assert match.argmax() == len(plain.visible) - 1 and match.max() < 0.3
    again = pair_modes(modes, 4, FINELY, reference=odd)
    assert again.index.tolist() == plain.index.tolist()


def test_a_mode_that_is_not_to_be_told_takes_none_from_the_others(modes):
    """The shape of another mode, better matched by what is no mode of the model: left untold it
    gets what is left, and all others stay."""
    plain = pair_modes(modes, 4, FINELY)
    thief = plain.shapes.copy()
    # The fourth is measured poorly; the third is not the third, but the fourth to a hair.
    thief[:, 2] = plain.shapes[:, 3]
    thief[:, 3] += 0.3 * plain.shapes[:, 2]
    taken = pair_modes(modes, 4, FINELY, reference=thief)
    assert taken.index[2] == plain.index[3] != taken.index[3]
    untold = np.where(np.arange(4) == 2, np.nan, thief)
    left = pair_modes(modes, 4, FINELY, reference=untold)
    assert left.index[[0, 1, 3]].tolist() == plain.index[[0, 1, 3]].tolist()
    assert left.index[2] == plain.index[2] and left.mac[2] == 0 and left.crossing == ()


def test_a_measured_shape_is_matched_with_a_mode_that_the_sensors_see_faintly(modes):
    """Sensors a little aslant see in-plane bending at a tenth: no candidate by itself, but no other
    is like a measured one. Bending keeps its partners, though others are there now."""
    aslant = Sensors(LINE, np.array([0.0, 0.1, 1.0]) / np.sqrt(1.01))
    elastic = np.arange(modes.n_rigid, len(modes))
    kind, plain = kinds(modes), pair_modes(modes, 4, aslant)
    plane = next(i for i in elastic if kind[i] == "in plane")
    assert 0.05 < modes.visibility(aslant)[plane] < 0.3 and plane not in plain.visible
    measured = modes.at(aslant)[:, [*plain.index[:3], plane]]
    measured = measured / np.abs(measured).max(axis=0)
    found = pair_modes(modes, 4, aslant, reference=measured)
    assert found.index.tolist() == [*plain.index[:3], plane] and plane in found.visible
    assert partnered(found, modes.frequencies_hz, modes.frequencies_hz[found.index], measured).all()


def test_a_pair_needs_likeness(modes):
    """A shape that is like none is no partner, whatever its frequency; a poor one is if that
    agrees; without shapes frequencies alone say it, but for what all have in common."""
    plain = pair_modes(modes, 4, ACROSS)
    hz = modes.frequencies_hz[plain.index]

    def of(shapes, test_hz):
        pairing = pair_modes(modes, 4, ACROSS, reference=shapes)
        return partnered(pairing, modes.frequencies_hz, test_hz, shapes).tolist()

    rest = np.linalg.svd(modes.at(ACROSS))[0][:, -1]
    for share, far, near in ((0.0, False, False), (0.5, False, True), (0.9, True, True)):
        shapes = plain.shapes / np.linalg.norm(plain.shapes, axis=0)
        shapes[:, 3] = np.sqrt(share) * shapes[:, 3] + np.sqrt(1 - share) * rest
        assert of(shapes, hz) == [True, True, True, near]
        assert of(shapes, hz * [1, 1, 1, 2]) == [True, True, True, far]
        assert of(shapes, hz * [1, 1, 1, 10]) == [True, True, True, False]
    # What most have in common says nothing where these are like none.
    shapes[:, 1:] = rest[:, None]
    assert of(shapes, hz * [1, 4, 4, 4]) == [True, False, False, False]
    ordered = pair_modes(modes, 4, ACROSS)
    for factors, expected in (
        ([10, 1, 1, 1], [False, True, True, True]),
        ([2, 2, 2, 2], [True] * 4),
        ([1, np.nan, 1.2, 1], [True] * 4),
    ):
        given = partnered(ordered, modes.frequencies_hz, hz * factors)
        assert given.tolist() == expected
    exchanged = partnered(ordered, modes.frequencies_hz, hz[[1, 0, 2, 3]])
    assert exchanged.tolist() == [False, False, True, True]


# -- measured shapes -------------------------------------------------------------------------------


HEAD = "bending 1,bending 2,bending 3,bending 4\n"


def _with_shapes(write_case, folder, text: str):
    (folder / "shapes.csv").write_text(text, encoding="utf-8")
    return write_case(folder, ('damping = "damping.csv"', 'shapes = "shapes.csv"'))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + "1,1,1,1\n" * 4, r"shape \(4, 4\): expected \(5, 4\)"),
        (HEAD.replace("bending 2", "bendig 2") + "1,1,1,1\n" * 5, "no column .*bending 2"),
        (HEAD + "1,0,1,1\n" * 5, "no mode of zeros"),
        (HEAD + "1,,1,1\n" * 5, "finite value"),
    ],
)
def test_bad_shapes_are_refused_in_words(write_case, tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        load_case(_with_shapes(write_case, tmp_path, text))


def test_modes_follow_the_measured_shapes_not_the_order(write_case, tmp_path):
    """Columns of the first two modes' shapes exchanged: the model's modes are exchanged too. An
    error is of modes that are alike: of a mixture of two modes the small model takes the one and
    the full model the other, which is no error of the small model."""
    case = load_case(write_case(tmp_path))
    full, start = build_structure(case, MPI.COMM_SELF), case.nominal()
    args = dict(samples=lambda: [start], sensors=case.sensors(), n_modes=16)
    plain = ReducedModel(full, start, n_test=4, **args)
    swapped = plain.pairing.shapes[:, [1, 0, 2, 3]]
    rows = "".join(",".join(f"{x:.6g}" for x in row) + "\n" for row in swapped * 1e3)
    measured = load_case(_with_shapes(write_case, tmp_path, HEAD + rows)).measurements()
    followed = ReducedModel(full, start, shapes=measured.shapes, n_test=4, **args)
    assert followed.pairing.index.tolist() == plain.pairing.index[[1, 0, 2, 3]].tolist()
    assert followed.crossings == {(0, 1)} and plain.crossings == set()
    assert np.argsort(followed.forward(start)[0]).tolist() == [1, 0, 2, 3]

    shapes = plain.pairing.shapes[:, :2] / np.linalg.norm(plain.pairing.shapes[:, :2], axis=0)
    small = ReducedModel(full, start, n_test=1, **args)
    values = {**start, "near.E": 0.03 * start["near.E"]}
    (error,) = small.errors([values])
    both = small.forward.solve(values)[0], small.solve(values)

    def taken(angle):
        mixture = np.cos(angle) * shapes[:, :1] + np.sin(angle) * shapes[:, 1:]
        small.forward.reference = mixture
        small.forward.forget()
        return [small.forward.paired(modes).index[0] for modes in both]

    switches, first = np.array([[0.0, np.pi / 2]] * 2), taken(0.0)
    for _ in range(40):
        for k, middle in enumerate(switches.mean(axis=1)):
            switches[k, int(taken(middle)[k] != first[k])] = middle
    own, theirs = taken(switches.mean())
    assert own != theirs
    assert small.errors([values])[0] < 2 * error < 0.01


def test_a_mode_that_a_small_model_lacks_is_an_error():
    """Five oscillators, coupled; of the small model's basis one mode is missing, and the test has
    it: nothing in the small model is like it."""
    n = 5
    sensors = Sensors(np.column_stack([np.arange(n), np.zeros((n, 2))]), [1.0, 0.0, 0.0])
    K = np.diag(np.arange(1.0, n + 1) ** 2) - 0.3 * (np.eye(n, k=1) + np.eye(n, k=-1))
    vectors = np.linalg.eigh(K)[1]

    def modes(kept):
        Z = vectors[:, kept]
        pencil = AffinePencil({}, [], [], fixed=(Z.T @ K @ Z, np.eye(len(kept))), fixed_mass=n)
        found = solve_modes(ArrayModel(pencil, 1e-3, Z, 0 * Z[None]), {}, n_modes=len(kept))
        return found, pair_modes(found, 2, sensors, reference=vectors[:, [0, 2]])

    full, lacking = modes([0, 1, 2, 3, 4]), modes([0, 1, 3, 4])
    assert largest_difference(*full, *modes([0, 2, 4]), sensors) < 1e-9
    assert largest_difference(*lacking, *full, sensors) > 0.1
