"""Pictures of one moment of an episode: what perception saw, and what its descriptor holds."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

import sfol
from env.demo.episode import Step
from env.perception.pipeline import ScenePipeline
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.decoding import MOST_ENTITIES, Decoder
from vsr.hypervectors.descriptor import SceneDescriptor
from vsr.pictures import draw_decoded, draw_scene
from vsr.segmentation import Frame

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def moment_pictures(step: Step, kb: sfol.KnowledgeBase) -> tuple[tuple[str, bytes], ...]:
    """Return pictures of a step, each with its caption, as PNG files.

    Args:
        step: a recorded step.
        kb: the knowledge base that it was driven under.
    """
    pipeline, codebook = ScenePipeline(kb), Codebook()
    # The recorded classes go through perception once more: masks of entities are not kept.
    frame = Frame(step.frame, step.classes, np.full(step.classes.shape, -1, np.int32))
    (scene,) = pipeline.perceive([frame])
    layout = SceneDescriptor(codebook, pipeline.grounding).layout(scene.entities, scene.classes)
    seen = draw_scene(step.frame, scene.classes, scene.entities, layout.attention, scene.facts)
    most = min(max(len(layout.names), 1), MOST_ENTITIES)
    decoded = Decoder(codebook).decode(step.descriptor, most=most)
    read = draw_decoded(decoded, title="read from the descriptor")
    return (
        ("Classes and entities in the frame, what the features attend to, the facts", _png(seen)),
        (
            f"What can be read back from the scene's one vector of {codebook.dimension} numbers: "
            f"{len(decoded)} of {len(layout.names)} entities",
            _png(read),
        ),
    )


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=90)
    return buffer.getvalue()
