"""The data's covariance, entry by entry by hand; and that repeating them adds no knowledge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fenics_joints.diagnosis.evidence.entries import (
    DAMPING,
    FREQUENCY,
    SHAPE,
    Neighbours,
    mode_mixing,
)
from fenics_joints.diagnosis.evidence.evidence import Evidence, evidence_of
from fenics_joints.measurements import TestData
from fenics_joints.structure import Sensors

TORQUES = np.array([5.0, 20.0])
SENSORS = Sensors(np.array([[x, 0.0, 0.0] for x in (0.0, 0.1, 0.4)]), [0.0, 0.0, 1.0])


def measured(**changes) -> TestData:
    given = dict(
        conditions=TORQUES,
        frequencies_hz=[[100.0, 200.0], [110.0, 230.0]],
        mode_names=("a", "b"),
        condition_name="torque",
        condition_unit="N·m",
        noise=0.002,
        damping=[[2e-3, 3e-3], [1e-3, 2e-3]],
        damping_noise=0.2,
        sensors=SENSORS,
        shapes=[[1.0, -2.0], [0.5, np.nan], [-1.0, 4.0]],
        shape_noise=0.04,
        shapes_at=5.0,
    )
    return TestData(**(given | changes))


def on_twelve(hz, shapes) -> Evidence:
    """One torque, and twelve sensors in a line."""
    points = np.column_stack([np.linspace(0, 1, 12), np.zeros((12, 2))])
    sensors = Sensors(points, [0.0, 0.0, 1.0])
    seen = dict(shapes=shapes, shape_noise=0.01, sensors=sensors)
    undamped = dict(damping=None, damping_noise=None)
    return evidence_of(measured(conditions=[5.0], frequencies_hz=[hz], **undamped, **seen), 0.01)


def test_every_entry_of_the_covariance_by_hand():
    evidence = evidence_of(measured(), 0.01)
    C, e = evidence.full_covariance(), evidence.entries
    assert [len(evidence.data), C.shape] == [4 + 4 + 6, (14, 14)]
    assert evidence.data[:4] == pytest.approx(np.log([100, 200, 110, 230]))
    assert evidence.data[4:8] == pytest.approx(np.log([2e-3, 3e-3, 1e-3, 2e-3]))
    # Shapes: unit root mean square over the sensors that were there, at the first torque.
    assert evidence.data[8::2] == pytest.approx(np.array([1.0, 0.5, -1.0]) / np.sqrt(0.75))
    assert evidence.data[9::2] == pytest.approx(
        np.array([-2.0, np.nan, 4.0]) / np.sqrt(10.0), nan_ok=True
    )
    memory = 0.5 + 0.5 * np.exp(-0.5 * (np.log(4.0) / 0.7) ** 2)
    distance = {(0, 1): 0.1, (0, 2): 0.4, (1, 2): 0.3}
    for i in range(14):
        for j in range(14):
            expected = 0.0
            if e.mode[i] == e.mode[j] and e.kind[i] == e.kind[j]:
                slow = 1.0 if e.row[i] == e.row[j] else memory
                if e.kind[i] == FREQUENCY:
                    expected = 0.01**2 * slow + (i == j) * 0.002**2
                if e.kind[i] == DAMPING:
                    expected = 0.3**2 * slow + (i == j) * 0.2**2
                if e.kind[i] == SHAPE:
                    pair = tuple(sorted((e.sensor[i], e.sensor[j])))
                    apart = distance.get(pair, 0.0) / (0.3 * 0.4)
                    # Half of it is each sensor's own.
                    expected = 0.05**2 * (0.5 * np.exp(-0.5 * apart**2) + 0.5 * (i == j))
                    expected += (i == j) * 0.04**2
            assert C[i, j] == pytest.approx(expected, rel=1e-12, abs=1e-18), (i, j)
    extra = evidence.full_covariance(unknown=True) - C
    assert np.linalg.eigvalsh(extra).min() > -1e-12
    # An unknown cause widens each mode on its own.
    assert not extra[e.mode[:, None] != e.mode].any()
    assert np.sqrt(extra.diagonal()[e.kind == FREQUENCY].min()) >= 0.10


def test_what_is_missing_or_held_out_is_not_fitted():
    """A missing sensor alone drops out; a mode that is held out goes with damping and shape."""
    f = np.array([[100.0, np.nan], [110.0, 230.0]])
    data = measured(frequencies_hz=f, damping=[[2e-3, 3e-3], [np.nan, 2e-3]])
    evidence = evidence_of(data, 0.01)
    e = evidence.entries
    lost = {(e.kind[i], e.row[i], e.mode[i], e.sensor[i]) for i in np.flatnonzero(~evidence.fitted)}
    assert lost == {
        (FREQUENCY, 0, 1, -1),
        (DAMPING, 0, 1, -1),
        (DAMPING, 1, 0, -1),
        *((SHAPE, 0, 1, i) for i in range(3)),
    }
    held = np.zeros((2, 2), dtype=bool)
    held[:, 0] = True
    without = evidence.without(held)
    assert not without.fitted[e.mode == 0].any()
    assert np.array_equal(without.fitted[e.mode == 1], evidence.fitted[e.mode == 1])
    used = without.fitted
    assert np.array_equal(without.covariance(), evidence.full_covariance()[np.ix_(used, used)])
    assert evidence_of(measured(shapes=None), 0.01).entries.kind.max() == DAMPING


def test_damping_counts_only_where_its_accuracy_is_known():
    torques = evidence_of(measured(damping_noise=None), 0.01)
    assert torques.log_damping is None
    levels = measured(condition_name="force", condition_unit="N", damping_noise=None)
    by_level = evidence_of(levels, 0.01)
    assert by_level.log_damping is not None and by_level.damping_scatter == 0.0
    # Between levels nobody touched the structure: its model's error is the same.
    C = by_level.full_covariance() - np.diag(by_level.noise_sd() ** 2)
    assert C[0, 2] > 0.975 * C[0, 0]


def information(evidence: Evidence, slope: np.ndarray) -> float:
    """What the data say of one number that moves them along a slope, in 1 / variance."""
    used = evidence.fitted
    return float(slope[used] @ np.linalg.solve(evidence.covariance(), slope[used]))


def test_repeated_data_do_not_sharpen_what_is_known():
    """Sensors beside each other, as many as one likes: the model's error in a shape stays."""
    log_f = np.log([[100.0, 200.0]])
    single = Evidence(np.array([10.0]), log_f, np.full((1, 2), 0.003), 0.01)
    rng = np.random.default_rng(3)
    shape = rng.standard_normal((3, 2))
    near = np.exp(-0.5 * (np.subtract.outer(range(3), range(3)) / 0.9) ** 2)
    few = replace(single, shapes=shape, near=near, shape_sd=0.02)
    copies = np.tile(np.arange(3), 100)
    many = replace(few, shapes=shape[copies], near=near[np.ix_(copies, copies)])
    slope = rng.standard_normal((3, 2))
    nothing = np.zeros(2)
    of_many = information(many, np.concatenate([nothing, slope[copies].ravel()]))
    of_few = information(few, np.concatenate([nothing, slope.ravel()]))
    # What near sensors share of the model's error, half of its variance, stays.
    shared = 0.5 * few.shape_error**2 * near
    bound = sum(column @ np.linalg.solve(shared, column) for column in slope.T)
    assert of_few < of_many < bound


def test_close_modes_may_turn_into_one_another_as_far_as_the_models_error_turns_them():
    """Eigenvectors of two close modes under an error of 1 % between them; none of distant ones."""
    rng = np.random.default_rng(4)
    shapes, _ = np.linalg.qr(rng.standard_normal((12, 2)))

    def squares(hz, turned):
        """Mahalanobis' square of a pair of shapes, beside the other shapes' error and noise."""
        evidence = on_twelve(hz, shapes)
        is_shape = evidence.entries.kind == SHAPE
        C = evidence.full_covariance()[np.ix_(is_shape, is_shape)]
        off = (np.sqrt(12) * turned).ravel() - evidence.data[is_shape]
        return off @ np.linalg.solve(C, off)

    for hz in ((100.0, 103.0), (100.0, 160.0)):
        # An error of 1 % of the frequency between the two: 2 % of the eigenvalue.
        square = np.diag(np.square(hz))
        square[0, 1] = square[1, 0] = 0.02 * hz[0] * hz[1]
        turn = np.linalg.eigh(square)[1]
        turn *= np.sign(np.diag(turn))
        assert squares(hz, shapes @ turn) < 8.0, hz  # of 24 data
    a = np.radians(18.0)  # as 1 % turns modes of 100 and 103 Hz
    much = shapes @ [[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]
    assert squares((100.0, 103.0), much) < 8.0
    assert squares((100.0, 160.0), much) > 30.0
    # They turn together: the one by as much as the other, the other way.
    apart = shapes @ [[np.cos(a), -np.sin(a)], [-np.sin(a), np.cos(a)]]
    assert squares((100.0, 103.0), apart) > 2 * squares((100.0, 103.0), much)


def test_a_shape_may_turn_into_a_mode_that_the_test_lacks():
    """As the model has it beside, to its scale; and one that is held out is still there."""
    rng = np.random.default_rng(5)
    modes, _ = np.linalg.qr(rng.standard_normal((12, 3)))  # of a body of 1 kg a node
    hz = np.array([100.0, 160.0, 163.0])
    angle = np.radians(20.0)
    turn = modes.copy()
    turn[:, 1] = np.cos(angle) * modes[:, 1] + np.sin(angle) * modes[:, 2]
    alone = on_twelve(hz[:2], turn[:, :2])
    beside = replace(alone, neighbours=Neighbours(np.log(hz), modes, np.arange(2)))

    def squares(evidence, mode):
        own = (evidence.entries.kind == SHAPE) & (evidence.entries.mode == mode)
        off = (np.sqrt(12) * modes[:, mode]) - evidence.data[own]
        C = evidence.full_covariance()[np.ix_(own, own)]
        return off @ np.linalg.solve(C, off)

    assert squares(alone, 1) > 20.0 and squares(beside, 1) < 8.0  # of 12 data
    # The share of the third in the second: of its own root mean square, by 1 % over ln (163 / 160).
    off = mode_mixing(np.log(hz[:2]), alone.shapes, np.full(2, 0.01), 0.1, beside.neighbours)
    near = next(shape for parts in off for mode, shape in parts if mode == 1)
    size = np.sqrt((0.01 / np.log(163 / 160)) ** 2 - 0.1**2)
    assert near == pytest.approx(size * np.sqrt(12) * modes[:, 2], rel=1e-9)
    hidden = np.array([np.log(100.0), np.nan])
    off = mode_mixing(hidden, alone.shapes, np.full(2, 0.6), 0.1, beside.neighbours)
    # Of both others, and what is then missing.
    assert [mode for parts in off for mode, _ in parts].count(0) == 3
