import math

import numpy as np
import pytest
import torch
import torchhd
from hypothesis import given
from hypothesis import strategies as st

from sfol.errors import UsageError
from vsr.hypervectors import hrr


def symbols(count: int, dimension: int, seed: int) -> torch.Tensor:
    """Random symbols in float64, so that laws hold to rounding."""
    return hrr.random_symbols(count, dimension, np.random.default_rng(seed)).double()


DIMENSIONS = st.integers(1, 65)
SEEDS = st.integers(0, 2**32)


def close(first, second, tolerance=1e-9):
    return torch.allclose(first, second, rtol=0, atol=tolerance)


@given(DIMENSIONS, SEEDS)
def test_binding_is_circular_convolution(dimension, seed):
    x, y = symbols(2, dimension, seed)
    literal = [
        sum(x[k] * y[(j - k) % dimension] for k in range(dimension)) for j in range(dimension)
    ]
    assert close(hrr.bind(x, y), torch.stack(literal))


@given(DIMENSIONS, SEEDS)
def test_binding_commutes_associates_and_distributes(dimension, seed):
    x, y, z = symbols(3, dimension, seed)
    assert close(hrr.bind(x, y), hrr.bind(y, x))
    assert close(hrr.bind(hrr.bind(x, y), z), hrr.bind(x, hrr.bind(y, z)))
    assert close(hrr.bind(x, y + z), hrr.bind(x, y) + hrr.bind(x, z))


@given(DIMENSIONS, SEEDS)
def test_identity_leaves_every_vector(dimension, seed):
    (x,) = symbols(1, dimension, seed)
    assert close(hrr.bind(hrr.identity(dimension).double(), x), x)


@given(DIMENSIONS, SEEDS)
def test_unitary_vectors_keep_norms_and_are_undone_exactly(dimension, seed):
    x, y = symbols(2, dimension, seed)
    u = hrr.unitary(x)
    assert close(u.norm(), torch.tensor(1.0, dtype=torch.float64))
    assert close(hrr.bind(u, y).norm(), y.norm())
    assert close(hrr.bind(hrr.bind(u, y), hrr.inverse(u)), y)
    assert close(hrr.inverse(u), hrr.exact_inverse(u))
    assert close(hrr.unitary(u), u)


@given(DIMENSIONS, SEEDS)
def test_the_involution_reverses_indices_and_is_its_own_inverse(dimension, seed):
    (x,) = symbols(1, dimension, seed)
    literal = torch.stack([x[-j % dimension] for j in range(dimension)])
    assert close(hrr.inverse(x), literal)
    assert close(hrr.inverse(hrr.inverse(x)), x)


@given(SEEDS)
def test_inverses_of_gaussian_symbols(seed):
    x, y = symbols(2, 2048, seed)
    bound = hrr.bind(x, y)
    recovered = hrr.bind(bound, hrr.inverse(x))
    assert hrr.similarity(recovered, y) > 0.6  # about 1/√2
    assert hrr.similarity(recovered, x).abs() < 0.2
    assert close(hrr.bind(bound, hrr.exact_inverse(x)), y, 1e-6)


@pytest.mark.parametrize("dimension", [128, 512, 2048, 8192])
def test_what_unbinding_recovers_stands_out_as_the_root_of_the_dimension(dimension):
    """Plate 1995: x* ⊗ x ⊗ y has the cosine 1/√2 with y, and N(0, 1/D) with anything else."""
    count = 400
    x, y, others = (symbols(count, dimension, seed) for seed in (1, 2, 3))
    recovered = hrr.bind(hrr.bind(x, y), hrr.inverse(x))
    right = hrr.similarity(recovered, y)
    wrong = hrr.similarity(recovered, others)
    assert right.mean().item() == pytest.approx(math.sqrt(1 / 2), abs=2 / math.sqrt(dimension))
    assert wrong.mean().abs() < 4 / math.sqrt(count * dimension)
    stands_out = right.mean() / wrong.std()
    assert stands_out.item() == pytest.approx(math.sqrt(dimension / 2), rel=0.2)


@pytest.mark.parametrize("count", [2, 5, 20])
def test_a_bundle_resembles_each_of_its_members_equally(count):
    members = symbols(count, 8192, seed=count)
    strangers = symbols(count, 8192, seed=100 + count)
    bundle = hrr.bundle(members)
    assert (hrr.similarity(bundle, members) - count**-0.5).abs().max() < 0.06
    assert hrr.similarity(bundle, strangers).abs().max() < 0.06


def test_what_is_bound_resembles_neither_part():
    x, y = symbols(2, 8192, seed=0)
    bound = hrr.bind(x, y)
    assert hrr.similarity(bound, x).abs() < 0.06
    assert hrr.similarity(bound, y).abs() < 0.06


def test_degenerate_spectra():
    zero, constant = torch.zeros(8), torch.ones(8)
    assert torch.equal(hrr.exact_inverse(zero), zero)
    assert close(hrr.unitary(zero), hrr.identity(8), 1e-6)
    # a constant has one component; its inverse undoes just that
    assert close(hrr.bind(constant, hrr.exact_inverse(constant)), constant / 8, 1e-6)


@given(SEEDS)
def test_agrees_with_torchhd(seed):
    ours = hrr.random_symbols(3, 2048, np.random.default_rng(seed))
    x, y, z = (torchhd.HRRTensor(vector) for vector in ours)
    chained = x.bind(y).bind(z).as_subclass(torch.Tensor)
    assert close(hrr.bind(hrr.bind(ours[0], ours[1]), ours[2]), chained, 1e-5)
    assert close(hrr.inverse(ours[0]), x.inverse().as_subclass(torch.Tensor), 1e-5)
    bundled = x.bundle(y).as_subclass(torch.Tensor)
    assert close(hrr.bundle(ours[:2]), bundled, 1e-5)


def test_batches_broadcast():
    x = symbols(6, 32, 0).reshape(2, 3, 32)
    y = symbols(3, 32, 1)
    bound = hrr.bind(x, y)
    assert bound.shape == (2, 3, 32)
    assert close(bound[1, 2], hrr.bind(x[1, 2], y[2]))
    assert hrr.similarity(x, y).shape == (2, 3)
    weights = torch.tensor([[1.0, 0.5, 0.0], [0.0, 0.0, 2.0]], dtype=torch.float64)
    bundled = hrr.bundle(x, weights)
    assert close(bundled[0], x[0, 0] + 0.5 * x[0, 1])
    assert close(bundled[1], 2 * x[1, 2])
    assert torch.equal(hrr.bundle(x[0, :0]), torch.zeros(32, dtype=torch.float64))


def test_empty_batches_stay_empty():
    none = torch.zeros(2, 0, 9)
    for result in (hrr.bind(none, none), hrr.inverse(none), hrr.exact_inverse(none)):
        assert result.shape == (2, 0, 9)
    assert hrr.bundle(none).shape == (2, 9)


def test_similarity_of_directions():
    x, y = torch.tensor([3.0, 0.0]), torch.tensor([0.0, 2.0])
    assert hrr.similarity(x, y) == 0.0
    assert hrr.similarity(x, -2 * x) == -1.0
    assert hrr.similarity(x, torch.zeros(2)) == 0.0


def test_symbols_are_nearly_orthonormal():
    vectors = hrr.random_symbols(20, 2048, np.random.default_rng(0))
    assert vectors.dtype == torch.float32
    gram = vectors @ vectors.T
    assert close(gram, torch.eye(20), 0.15)


def test_binding_passes_gradients():
    x, y = symbols(2, 6, 0)
    assert torch.autograd.gradcheck(hrr.bind, (x.requires_grad_(), y.requires_grad_()))


def test_lengths_must_agree():
    # rfft of 4 and of 5 numbers have the same length, so torch would not notice
    with pytest.raises(UsageError, match="4 and 5"):
        hrr.bind(torch.ones(4), torch.ones(5))
