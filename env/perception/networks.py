"""The trained networks of the street: where their weights are, and whether they fit its camera."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from env.perception.weights_folder import WHERE_FROM, weights_folder
from env.world.camera import RENDERERS
from sfol.errors import UsageError, missing_extra
from vsr.grounding import Camera

try:
    from vsr.networks.autoencoder import FeatureEncoder
    from vsr.networks.inference import Precision
    from vsr.networks.runtime import RuntimeName
    from vsr.networks.unet import UNetSegmenter
    from vsr.networks.weights import read_card
except ImportError as error:
    raise missing_extra(
        str(error.name), "the networks of the street need it", extra="aeb", python="3.11"
    ) from error

# One pixel in seventy differs between the two, by a few grey values, and the networks do as well on
# frames of either: docs/explanation/networks.md has the figures.
_ALIKE = frozenset(RENDERERS.values())
_DEFAULT = RENDERERS["street"]


def load_segmenter(
    folder: Path | None = None,
    *,
    camera: Camera | None = None,
    renderer: str = _DEFAULT,
    precision: Precision = "auto",
    runtime: RuntimeName = "auto",
) -> UNetSegmenter:
    """Return the trained UNet; the streets of one process share it.

    Args:
        folder: where the weights are; else the environment variable ``AEB_WEIGHTS`` says it, else
            they are looked for in ``env/weights`` of a checkout.
        camera: the lens of the frames to come, checked against that of the training frames.
        renderer: what draws the frames to come, by the name that cards give it, checked likewise;
            the street's two renderers are as good as the same.
        precision: arithmetic; ``auto`` takes the fastest that the hardware has.
        runtime: what runs the network; ``openvino`` is the fastest on a processor, and an extra.

    Raises:
        UsageError: there are no weights, they can't be read, or they are for other frames.
        MissingExtraError: the runtime is not installed.
    """
    file = _weights("segmenter", folder, camera, renderer)
    return _segmenter(file, file.stat().st_mtime_ns, precision, runtime)


def load_autoencoder(
    folder: Path | None = None,
    *,
    camera: Camera | None = None,
    renderer: str = _DEFAULT,
    precision: Precision = "auto",
    runtime: RuntimeName = "auto",
) -> FeatureEncoder:
    """Return the encoder of the trained autoencoder; see `load_segmenter`."""
    file = _weights("autoencoder", folder, camera, renderer)
    return FeatureEncoder.load(file, precision, runtime=runtime)


@lru_cache(maxsize=1)
def _segmenter(
    file: Path, modified: int, precision: Precision, runtime: RuntimeName
) -> UNetSegmenter:
    del modified  # a file that has changed since is another one
    return UNetSegmenter.load(file, precision, runtime=runtime)


def weights_file(network: str, folder: Path | None = None) -> Path:
    """Return the file of a network's weights.

    Args:
        network: ``segmenter`` or ``autoencoder``.
        folder: where the weights are; see `load_segmenter`.

    Raises:
        UsageError: there is none.
    """
    file = (folder or weights_folder()) / f"{network}.safetensors"
    if not file.is_file():
        raise UsageError(
            f"there are no weights '{file}'",
            name=str(file),
            suggestion=f"{WHERE_FROM}; aeb networks {network} --help says how to train them",
        )
    return file


def _weights(network: str, folder: Path | None, camera: Camera | None, renderer: str) -> Path:
    file = weights_file(network, folder)
    trained_on = read_card(file).trained_on
    if trained_on.renderer != renderer and not {trained_on.renderer, renderer} <= _ALIKE:
        raise UsageError(
            f"the {network} knows frames of {trained_on.renderer}, not of {renderer}",
            name=renderer,
            suggestion=f"render with {trained_on.renderer}, or train with frames of {renderer}",
        )
    for name, value in (camera.model_dump() if camera else {}).items():
        known = trained_on.camera.get(name)
        if value != known:
            said = "of its own" if known is None else f"{known:g}"
            raise UsageError(
                f"the {network} knows frames of a camera with {name} {said}, not {value:g}",
                name=name,
                suggestion="train it with frames of the other camera: aeb frames --help",
            )
    return file
