"""Holographic reduced representations: symbols as vectors, structures as their products and sums.

A symbol is a vector x of D real numbers, drawn from N(0, 1/D). Circular convolution ⊗ binds two
vectors into one that resembles neither; addition ⊕ bundles vectors into one that resembles each.
Convolution is a product in the frequency domain, where a vector of D numbers has D // 2 + 1.

All functions take real floating-point tensors whose last dimension is D and broadcast over the
dimensions before it. They work on any device and pass gradients.

Source: T. A. Plate, "Holographic Reduced Representations", IEEE Transactions on Neural Networks
6(3), 1995.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from sfol.errors import UsageError


def spectrum(vector: Tensor) -> Tensor:
    """Return the Fourier transform of real vectors: (…, D) → complex (…, D // 2 + 1).

    Raises:
        UsageError: they are no real vectors.
    """
    _check_real(vector)
    if not vector.numel():  # the transforms refuse empty batches
        return vector[..., : vector.shape[-1] // 2 + 1] + 0j
    spectra: Tensor = torch.fft.rfft(vector)
    return spectra


def from_spectrum(spectra: Tensor, dimension: int) -> Tensor:
    """Return the real vectors of a spectrum: complex (…, D // 2 + 1) → (…, D)."""
    if not spectra.numel():
        return spectra.real.new_zeros((*spectra.shape[:-1], dimension))
    vector: Tensor = torch.fft.irfft(spectra, n=dimension)
    return vector


def bind(first: Tensor, second: Tensor) -> Tensor:
    """Bind two vectors by circular convolution: z_j = Σ_k x_k y_{(j−k) mod D}.

    Args:
        first: x, (…, D).
        second: y, (…, D).

    Returns:
        x ⊗ y, (…, D).

    Raises:
        UsageError: the vectors differ in length, or are not real, or their batches do not go
            together.

    Source: Plate 1995.
    """
    _check_real(first, second)
    if first.shape[-1] != second.shape[-1]:
        raise UsageError(
            f"vectors of {first.shape[-1]} and {second.shape[-1]} numbers cannot be bound",
            name="second",
        )
    _check_together(first.shape[:-1], second.shape[:-1])
    return from_spectrum(spectrum(first) * spectrum(second), first.shape[-1])


def bundle(vectors: Tensor, weights: Tensor | None = None) -> Tensor:
    """Bundle k vectors by addition: Σ_i w_i x_i.

    Args:
        vectors: x_i, (…, k, D); the sum of none is zero.
        weights: w_i, (…, k); None for ones.

    Returns:
        The bundle, (…, D).

    Raises:
        UsageError: there are not as many weights as vectors.

    Source: Plate 1995; with weights, the paper's equation for VSR.
    """
    _check_real(vectors)
    if vectors.ndim < 2:
        raise UsageError(f"vectors of shape {tuple(vectors.shape)}", name="vectors")
    if weights is None:
        return vectors.sum(dim=-2)
    if not weights.ndim or weights.shape[-1] != vectors.shape[-2]:
        raise UsageError(
            f"weights of shape {tuple(weights.shape)} for vectors of shape {tuple(vectors.shape)}",
            name="weights",
            suggestion="one for each vector",
        )
    _check_together(weights.shape[:-1], vectors.shape[:-2])
    return (weights.unsqueeze(-1) * vectors).sum(dim=-2)


def inverse(vector: Tensor) -> Tensor:
    """Return the approximate inverse, the involution x*_j = x_{−j mod D}.

    Binding with it undoes binding with x up to noise, and exactly so if x is `unitary`.

    Args:
        vector: x, (…, D).

    Source: Plate 1995.
    """
    return vector.flip(-1).roll(1, dims=-1)


def exact_inverse(vector: Tensor) -> Tensor:
    """Return the inverse x⁻¹, whose spectrum is the reciprocal of x's.

    It amplifies noise wherever x's spectrum is small; where that is zero, there is no inverse and
    the component becomes zero.

    Args:
        vector: x, (…, D).

    Source: Plate 1995.
    """
    spectra = spectrum(vector)
    power = spectra.real**2 + spectra.imag**2
    reciprocal = torch.where(power > 0, spectra.conj() / power, torch.zeros_like(spectra))
    return from_spectrum(reciprocal, vector.shape[-1])


def unitary(vector: Tensor) -> Tensor:
    """Return the nearest unitary vector: the same phases, every spectral magnitude one.

    Its norm is one, and binding with it keeps norms.

    Args:
        vector: x, (…, D). A component without magnitude gets phase zero.

    Source: Plate 1995.
    """
    spectra = spectrum(vector)
    magnitude = spectra.abs()
    phases = torch.where(magnitude > 0, spectra / magnitude, torch.ones_like(spectra))
    return from_spectrum(phases, vector.shape[-1])


def similarity(first: Tensor, second: Tensor) -> Tensor:
    """Return the cosine of the angle between vectors; 0 where one of them is zero.

    Args:
        first: x, (…, D).
        second: y, (…, D).

    Returns:
        x·y / (‖x‖ ‖y‖), (…).

    Raises:
        UsageError: the vectors differ in length, or their batches do not go together.
    """
    _check_real(first, second)
    if first.shape[-1] != second.shape[-1]:
        raise UsageError(
            f"vectors of shapes {tuple(first.shape)} and {tuple(second.shape)}", name="second"
        )
    _check_together(first.shape[:-1], second.shape[:-1])
    norms = first.norm(dim=-1) * second.norm(dim=-1)
    products = (first * second).sum(dim=-1)
    return torch.where(norms > 0, products / norms, torch.zeros_like(products))


def identity(dimension: int) -> Tensor:
    """Return the vector (1, 0, …, 0), float32 (D,), which leaves every vector as it is if bound."""
    vector = torch.zeros(dimension)
    vector[0] = 1.0
    return vector


def random_symbols(count: int, dimension: int, generator: np.random.Generator) -> Tensor:
    """Draw symbols with components from N(0, 1/D), so that their norms are about one.

    Args:
        count: how many.
        dimension: D.
        generator: numpy's, whose numbers do not depend on the machine; drawn in float64.

    Returns:
        float32 (count, D).

    Source: Plate 1995.
    """
    numbers = generator.standard_normal((count, dimension)) / np.sqrt(dimension)
    return torch.from_numpy(numbers.astype(np.float32))


def _check_real(*vectors: Tensor) -> None:
    for vector in vectors:
        if not vector.is_floating_point() or not vector.ndim or not vector.shape[-1]:
            raise UsageError(
                f"vectors of shape {tuple(vector.shape)} and type {vector.dtype}",
                name="vector",
                suggestion="floats of shape (…, D)",
            )


def _check_together(first: torch.Size, second: torch.Size) -> None:
    """Refuse batches of which one can't be repeated to fit the other."""
    for one, other in zip(reversed(first), reversed(second), strict=False):
        if one != other and 1 not in (one, other):
            raise UsageError(
                f"batches of shapes {tuple(first)} and {tuple(second)} do not go together",
                name="second",
            )
