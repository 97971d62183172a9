"""Predictions of a hypothesis by single solutions: one mode at one condition after another."""

from __future__ import annotations

import numpy as np


def one_by_one(hypothesis, forward, evidence, z, baseline) -> np.ndarray:
    """Everything in `Evidence.data` but single numbers, (N,), by single solutions."""
    m, names = evidence.shape[1], list(forward.model.parameters)
    sensing = hypothesis.sensing(z, m, len(forward.sensors))
    at_rest = [
        p.value(x)
        for p, x in zip(hypothesis.dampings, z[hypothesis.places["dampings"]], strict=True)
    ]
    log_f, log_damping = np.zeros((2, len(evidence.conditions), m))
    for row, condition in enumerate(evidence.conditions):
        for i, look in enumerate(hypothesis.view_of(m)):
            mode = hypothesis.views[look]
            values = hypothesis.values(z, condition, baseline, row, mode)
            found, by_values = forward(values)
            log_f[row, i] = found[i]
            if hypothesis.damped:
                loss_factors = hypothesis.loss_factors(z, condition, np.exp(found[i]), mode)
                shares = {
                    key: 2 * by_values[i, names.index(key)] * values[key] if key else 1.0
                    for key in loss_factors
                }
                lost = sum(0.5 * eta * shares[key] for key, eta in loss_factors.items())
                log_damping[row, i] = np.log(at_rest[i] + lost)
    blocks = [log_f[:, sensing.order], *[log_damping[:, sensing.order]][: hypothesis.damped]]
    if evidence.shapes is not None:
        row = evidence.shape_row
        values = hypothesis.values(z, evidence.conditions[row], baseline, row)
        modes, pairing = forward.solve({name: values[name] for name in names})
        x, model = modes.shapes[:, pairing.index], forward.model
        moved = sum(
            s[:, None] * (rows @ x)
            for s, rows in zip(sensing.shifts, model.shift_rows, strict=False)
        )
        read = sensing.gains[:, None] * (model.sensor_rows @ x + moved)
        there = np.isfinite(evidence.shapes)
        scale = [
            np.linalg.lstsq(read[own, i, None], evidence.shapes[own, i], rcond=None)[0][0]
            for i, own in enumerate(there.T)
        ]
        blocks.append(read * scale)
    return np.concatenate([block.ravel() for block in blocks])
