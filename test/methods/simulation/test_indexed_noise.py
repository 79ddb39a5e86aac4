"""Random numbers by index."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource


@given(first=st.integers(0, 5000), count=st.integers(0, 1500))
def test_any_slice_is_part_of_the_one_sequence(first, count):
    whole = IndexedNoise(7, NoiseSource.TRACER).normal(0, 6500)
    noise = IndexedNoise(7, NoiseSource.TRACER)
    noise.uniform(first // 2, 5)
    assert np.array_equal(noise.normal(first, count), whole[first : first + count])


def test_distributions():
    noise = IndexedNoise(1, NoiseSource.SPIKE)
    assert stats.kstest(noise.normal(0, 20_000), "norm").pvalue > 1e-3
    assert stats.kstest(noise.uniform(0, 20_000), "uniform").pvalue > 1e-3


@pytest.mark.parametrize("source", list(NoiseSource)[1:])
def test_sources_are_independent(source):
    a = IndexedNoise(1, NoiseSource.TRACER).normal(0, 20_000)
    b = IndexedNoise(1, source).normal(0, 20_000)
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.03
    assert not np.intersect1d(a, b).size


def test_blocks_do_not_repeat():
    numbers = IndexedNoise(1, NoiseSource.TRACER).normal(0, 100_000)
    assert len(np.unique(numbers)) > 99_990


def test_seed_changes_everything():
    a, b = (IndexedNoise(seed, NoiseSource.TRACER).normal(0, 1000) for seed in (1, 2))
    assert not np.intersect1d(a, b).size
