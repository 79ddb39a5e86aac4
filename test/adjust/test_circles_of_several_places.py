"""Circles whose outputs read several places each, with orders that nothing determines.

A made-up design: every row reads two places of one circle and one of another. Referee: the dense
algebra.
"""

import numpy as np
import pytest
from scipy.sparse import csr_array

from rotcal_ros.adjust.circles import CircularDesign
from rotcal_ros.adjust.kernels import ConstrainedKernel, LowRankUpdateKernel, fix_open_directions
from rotcal_ros.adjust.outputs import Outputs

N, STEPS = 12, (0, 1, 3, 5, 8)


def design(missing=(), twice=()):
    """Rows in two directions: x and y of d turned by the step, and one circle of their own each.

    As a plate has it: what is constant in d is open, and one order beside it.
    """
    rows = []
    for turn, step in enumerate(STEPS):
        t = 2.0 * np.pi * step / N
        for axis, (x, y) in enumerate(((np.cos(t), np.sin(t)), (-np.sin(t), np.cos(t)))):
            for place in range(N):
                row = np.zeros(4 * N + 2 * len(STEPS))
                row[(place - step) % N], row[N + (place - step) % N] = x, y
                row[(2 + axis) * N + place] = 1.0
                row[4 * N + 2 * turn + axis] = 1.0
                rows.append(row)
    kept = [row for k, row in enumerate(rows) if k not in missing] + [rows[k] for k in twice]
    return CircularDesign.of(csr_array(np.array(kept)), 4, N)


def outputs():
    """What turns back the two circles: two places each, without mean and first harmonic."""
    angle = 2.0 * np.pi * np.arange(N) / N
    rows = np.zeros((2 * N, 4 * N + 2 * len(STEPS)))
    each = np.arange(N)
    rows[each, each], rows[each, N + each] = np.cos(angle), -np.sin(angle)
    rows[N + each, each], rows[N + each, N + each] = np.sin(angle), np.cos(angle)
    return rows


def definitions():
    rows = outputs()
    mean = np.stack([rows[:N].mean(axis=0), rows[N:].mean(axis=0)])
    turning = np.zeros((2, rows.shape[1]))
    turning[0, :N] = turning[1, N : 2 * N] = 1.0 / N
    others = np.zeros((1, rows.shape[1]))
    others[0, 2 * N : 3 * N] = 1.0
    return np.concatenate([mean, turning, others])


@pytest.mark.parametrize(("missing", "twice"), [((), ()), ((5, 17, 40), ()), ((), (3, 4, 60))])
def test_definitions_make_outputs_of_two_places_what_dense_algebra_says(missing, twice):
    found, few = design(missing, twice), csr_array(outputs())
    weight = np.where(found.turns.turn % 2, 2.0, 1.0)
    kernel = found.weighted(weight).kernel()
    assert isinstance(kernel, LowRankUpdateKernel)
    white, dense = found.dense() * weight[:, None], outputs()
    assert kernel.rank == np.linalg.matrix_rank(white)
    defined = ConstrainedKernel.of(kernel, definitions())
    open_ = np.linalg.svd(white)[2][kernel.rank :].T
    fixing, left = fix_open_directions(definitions(), open_, np.ones(len(open_)))
    to = np.eye(len(open_)) - fixing @ definitions()
    gain = dense @ to @ np.linalg.pinv(white)
    rows = np.arange(len(white))
    for asked in (Outputs.alone(few), Outputs.of([dense])):
        np.testing.assert_allclose(defined.response(asked, rows), gain, atol=1e-10)
        variance = (gain**2).sum(axis=1)
        np.testing.assert_allclose(defined.variances_of(asked), variance, atol=1e-10)
    assert np.abs(dense @ left).max(initial=0.0) < 1e-9


def test_squares_between_components_are_those_of_the_whole_matrix():
    found = design((5, 17), (60,))
    kernel = found.with_extra(np.random.default_rng(1).standard_normal((len(found.weight), 2)))
    kernel = kernel.weighted(np.where(found.turns.turn % 2, 2.0, 1.0)).kernel()
    parts = np.stack([found.turns.turn % 2 == 0, found.turns.turn % 2 == 1])
    among = kernel.hat_block(np.arange(len(found.weight)))
    np.testing.assert_allclose(kernel.shared(parts), parts @ among**2 @ parts.T, atol=1e-9)


def test_any_weights_lead_to_least_squares_though_orders_are_open():
    found, random = design(), np.random.default_rng(2)
    white = found.weighted(random.uniform(0.3, 1.0, len(found.weight)))
    read = random.standard_normal(len(found.weight))
    step = white.roughly(read)
    assert step is not None
    expected = white.dense() @ np.linalg.lstsq(white.dense(), read, rcond=1e-9)[0]
    np.testing.assert_allclose(white.times(step), expected, atol=1e-8)
    np.testing.assert_allclose(white.dense() @ white.open_directions, 0.0, atol=1e-12)
    np.testing.assert_allclose(white.normal(), white.dense().T @ white.dense(), atol=1e-12)
