"""From frames and their scenes to VSR vectors: what a policy of the paper is given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from env.perception.pipeline import Scene, ScenePipeline
from sfol.errors import UsageError
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.descriptor import SceneDescriptor
from vsr.hypervectors.fusion import Fusion
from vsr.hypervectors.methods import Method
from vsr.segmentation import Frame


class Encoder(Protocol):
    """Whatever makes feature maps of frames."""

    def encode(self, frames: Sequence[Frame]) -> Tensor:
        """Return float32 (B, 512, 7, 7)."""
        ...


class Describer:
    """Describes scenes as vectors, each entity weighted as the knowledge base says.

    Args:
        pipeline: whose scenes are described; its knowledge base gives the entity weights.
        fusion: of SSI and SF, a method or one with switches.
        encoder: makes the feature maps that SF looks at; not needed by the fusion ``ssi``.
        codebook: the symbols; a trained policy needs those that it was trained with.

    Raises:
        UsageError: the fusion needs an encoder and there is none.

    Source: paper, section "Vector Semantic Representation".
    """

    def __init__(
        self,
        pipeline: ScenePipeline,
        fusion: Fusion | Method = "add",
        encoder: Encoder | None = None,
        codebook: Codebook | None = None,
    ) -> None:
        self._reward = pipeline.reward
        self._descriptor = SceneDescriptor(codebook or Codebook(), pipeline.grounding, fusion)
        self._encoder = encoder if self._descriptor.fusion.uses_features else None
        if self._descriptor.fusion.uses_features and encoder is None:
            raise UsageError(
                f"the fusion '{self._descriptor.fusion.method}' needs an encoder",
                name="encoder",
                suggestion="env.perception.networks.load_autoencoder(), or the fusion 'ssi'",
            )

    @property
    def dimension(self) -> int:
        """D, the length of a vector."""
        return self._descriptor.codebook.dimension

    def __call__(self, frames: Sequence[Frame], scenes: Sequence[Scene]) -> NDArray[np.float32]:
        """Return VSR = Σ w_i E_i of each frame; the networks run once for all of them.

        Args:
            frames: B frames.
            scenes: what perception made of each.

        Returns:
            float32 (B, D).

        Raises:
            UsageError: a scene comes from no picture.
        """
        with torch.inference_mode():
            layouts = [self._descriptor.layout(scene.entities, scene.classes) for scene in scenes]
            features = self._encoder.encode(frames) if self._encoder else None
            weights = [self._weights(s, y.names) for s, y in zip(scenes, layouts, strict=True)]
            vectors: NDArray[np.float32] = self._descriptor.vsr(layouts, weights, features).numpy()
        return vectors

    def _weights(self, scene: Scene, names: Sequence[str]) -> list[float]:
        weights = self._reward.entity_weights(scene.conclusions, names)
        return [weights[name] for name in names]
