"""Where a street's facts come from: one class for each way to perceive, chosen by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Protocol

from env.perception.pipeline import Scene, ScenePipeline
from env.perception.truth import TruthPerception
from env.street.view import StreetView
from env.world.camera import DashCameraParameters
from env.world.world import World
from sfol import KnowledgeBase
from vsr.grounding import SegmentationGrounding

if TYPE_CHECKING:
    from vsr.networks.runtime import RuntimeName


class Perception(Protocol):
    """Makes scenes of a street; a street asks it once after every step."""

    @property
    def pipeline(self) -> ScenePipeline:
        """The knowledge base, its reward and how frames are read."""
        ...

    def reset(self, street: StreetView) -> None:
        """Forget what was seen: an episode begins."""
        ...

    def __call__(self, street: StreetView) -> Scene:
        """Return the scene as it is now."""
        ...


class SimulatorPerception:
    """Reads the renderer's own class map.

    Args:
        kb: says how it is read, and what is concluded.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self.pipeline = ScenePipeline(kb)

    def reset(self, street: StreetView) -> None:
        """Forget who had which name."""
        self._naming = self.pipeline.naming(street.control_dt)

    def __call__(self, street: StreetView) -> Scene:
        """Return the scene; this is where the frame is rendered."""
        (scene,) = self.pipeline.perceive([street.frame], self._naming)
        return scene


class UNetPerception(SimulatorPerception):
    """Reads a trained network's segmentation of the frame.

    Args:
        kb: says how it is read, and what is concluded.
        runtime: what runs the network; see `env.perception.networks.load_segmenter`.

    Raises:
        UsageError: there are no weights.
    """

    def __init__(self, kb: KnowledgeBase, runtime: RuntimeName = "auto") -> None:
        from env.perception.networks import load_segmenter  # noqa: PLC0415  (torch is slow)

        camera = kb.grounding_of("segmentation", SegmentationGrounding).camera
        self.pipeline = ScenePipeline(kb, load_segmenter(camera=camera, runtime=runtime))


class RayPerception:
    """Casts rays through the world's state, without any picture."""

    def __init__(self, kb: KnowledgeBase, world: World, lens: DashCameraParameters) -> None:
        self.pipeline = ScenePipeline(kb)
        self._truth = TruthPerception(world, lens, self.pipeline)

    def reset(self, street: StreetView) -> None:
        """Forget who had which name."""
        self._naming = self.pipeline.naming(street.control_dt)

    def __call__(self, street: StreetView) -> Scene:
        """Return the scene."""
        return self._truth.perceive(street.ego.position, street.people, self._naming)


class NoPerception:
    """Sees nothing, for those who perceive elsewhere: no facts but the background's."""

    def __init__(self, kb: KnowledgeBase) -> None:
        self.pipeline = ScenePipeline(kb)

    def reset(self, street: StreetView) -> None:
        """Forget nothing, for nothing was seen."""

    def __call__(self, street: StreetView) -> Scene:
        """Return a scene without entities."""
        return self.pipeline.scene((), self.pipeline.reward.facts())


# Name → what makes it of the rules, the world and the dash camera.
PERCEPTIONS: Mapping[str, Callable[[KnowledgeBase, World, DashCameraParameters], Perception]] = {
    "simulator": lambda kb, world, lens: SimulatorPerception(kb),
    "truth": RayPerception,
    "unet": lambda kb, world, lens: UNetPerception(kb),
    "none": lambda kb, world, lens: NoPerception(kb),
}
