"""The report of ``aeb demo``: one self-contained page that ties camera, rules and reward together.

The page needs no network and no other file. Its HTML, style and script are
``report_template.html``; this module turns episodes into the JSON that the script reads.
"""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from env.demo.episode import Episode, SeenEntity, Step
from sfol.writing import replacing
from vsr.classes import COLOURS, SemanticClass
from vsr.entities import ClassMap
from vsr.pictures import PALETTE

Frame = npt.NDArray[np.uint8]

# Characters of base64 for all frames together: pages beyond some 12 MB open slowly, and facts
# and curves take their part of that.
FRAME_BUDGET = 9_000_000
QUALITIES = (88, 80, 70, 55, 40, 25, 10)

_PLACEHOLDER = "__REPORT_DATA__"
_OTHER_COLOUR = (153, 153, 153)


@dataclass(frozen=True)
class Focus:
    """The moment at which the page opens, and why its reward came out as it did.

    Attributes:
        episode: index into the episodes.
        step: index into that episode's steps.
        explanation: the proof tree of that moment, as plain text.
        pictures: what perception and descriptor hold of that moment: caption and PNG file.
    """

    episode: int
    step: int
    explanation: str
    pictures: tuple[tuple[str, bytes], ...] = ()


@dataclass(frozen=True)
class Provenance:
    """Where the numbers of a report come from.

    Attributes:
        knowledge_base: its name, such as ``crossing``.
        digest: its hash.
        made: how the report was made: the command, versions, the segmenter.
    """

    knowledge_base: str
    digest: str
    made: str


def write_report(
    path: Path,
    episodes: Sequence[Episode],
    groups: Mapping[str, Sequence[str]],
    focus: Focus,
    provenance: Provenance,
) -> None:
    """Write the episodes as one HTML page that needs nothing else.

    The file appears complete or not at all.

    Args:
        path: where the page goes; missing folders are made.
        episodes: at least one, each with at least one step.
        groups: the heads of each weight, in the order in which the charts stand.
        focus: the most dangerous moment.
        provenance: what the page's header says of its origin.

    Raises:
        ValueError: there is nothing to show, or ``focus`` names no step.
    """
    _check(episodes, focus)
    data = _page_data(episodes, groups, focus, provenance)
    # An escaped "<" can neither end the script element nor open a comment in it.
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    template = files("env.demo").joinpath("report_template.html").read_text(encoding="utf-8")
    with replacing(path) as part:
        part.write_text(template.replace(_PLACEHOLDER, text), encoding="utf-8")


def _check(episodes: Sequence[Episode], focus: Focus) -> None:
    if not episodes or not all(episode.steps for episode in episodes):
        raise ValueError("a report needs at least one episode, and each needs at least one step")
    if not 0 <= focus.episode < len(episodes):
        raise ValueError(f"focus names episode {focus.episode} of {len(episodes)}")
    if not 0 <= focus.step < len(episodes[focus.episode].steps):
        steps = len(episodes[focus.episode].steps)
        raise ValueError(f"focus names step {focus.step} of {steps} in episode {focus.episode}")


class _Strings:
    """Texts that recur at many steps, kept once and named by their index."""

    def __init__(self) -> None:
        self._indices: dict[str, int] = {}

    def index(self, text: str) -> int:
        return self._indices.setdefault(text, len(self._indices))

    def indices(self, texts: Iterable[str]) -> list[int]:
        return [self.index(text) for text in texts]

    def all(self) -> list[str]:
        return list(self._indices)


def _page_data(
    episodes: Sequence[Episode],
    groups: Mapping[str, Sequence[str]],
    focus: Focus,
    provenance: Provenance,
) -> dict[str, Any]:
    steps = [step for episode in episodes for step in episode.steps]
    heads = [head for group in groups.values() for head in group]
    names = {
        "weights": _names(step.weights for step in steps),
        "terms": _names(step.terms for step in steps),
        "confidences": _names([dict.fromkeys(heads), *(step.confidences for step in steps)]),
    }
    strings = _Strings()
    quality = _quality([step.frame for step in steps])
    return {
        "provenance": asdict(provenance),
        "focus": _focus_data(focus),
        "groups": {weight: list(group) for weight, group in groups.items()},
        "names": names,
        "colours": _colours(entity.kind for step in steps for entity in step.entities),
        "episodes": [_episode_data(episode, names, strings, quality) for episode in episodes],
        "strings": strings.all(),
    }


def _names(mappings: Iterable[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(name for mapping in mappings for name in mapping))


def _colours(kinds: Iterable[str]) -> dict[str, str]:
    colours = {}
    for kind in dict.fromkeys(kinds):
        tag = SemanticClass.__members__.get(kind.upper())
        red, green, blue = COLOURS.get(tag, _OTHER_COLOUR) if tag else _OTHER_COLOUR
        colours[kind] = f"#{red:02x}{green:02x}{blue:02x}"
    return colours


def _episode_data(
    episode: Episode, names: Mapping[str, Sequence[str]], strings: _Strings, quality: int
) -> dict[str, Any]:
    steps = episode.steps
    signals = ("time", "position", "speed", "action", "distance", "ttc", "reward")
    height, width = steps[0].frame.shape
    return {
        "driver": episode.driver,
        "traffic": episode.traffic,
        "occlusion": episode.occlusion,
        "behaviour": episode.behaviour,
        "seed": int(episode.seed),
        "dt": episode.control_dt,
        "ending": episode.ending,
        "summary": _summary(episode, names["terms"]),
        "signals": {name: [_number(getattr(step, name)) for step in steps] for name in signals},
        # A head whose rules were all removed is in no step: nothing concluded, so 0.
        **{
            kind: {name: [_number(getattr(s, kind).get(name, 0.0)) for s in steps] for name in some}
            for kind, some in names.items()
        },
        "moments": [_moment_data(step, strings) for step in steps],
        "size": [width, height],
        "frames": [_encode(step.frame, quality) for step in steps],
        "classes": [_encode_classes(step.classes) for step in steps],
    }


def _focus_data(focus: Focus) -> dict[str, Any]:
    pictures = [(caption, base64.b64encode(png).decode("ascii")) for caption, png in focus.pictures]
    return {**asdict(focus), "pictures": pictures}


def _summary(episode: Episode, terms: Sequence[str]) -> dict[str, Any]:
    """The numbers of the episode table; a term's share is of the reward's absolute size."""
    steps = episode.steps
    sizes = {term: sum(abs(step.terms.get(term, 0.0)) for step in steps) for term in terms}
    total = sum(sizes.values())
    return {
        "duration": _number(len(steps) * episode.control_dt),
        "top_speed": _number(max(max(step.speed, step.speed_next) for step in steps)),
        "ttc": _least(step.ttc for step in steps),
        "distance": _least(step.distance for step in steps),
        "return": _number(sum(step.reward for step in steps)),
        "terms": {t: _number(sum(step.terms.get(t, 0.0) for step in steps)) for t in terms},
        "shares": {term: _number(size / total if total else 0.0) for term, size in sizes.items()},
    }


def _moment_data(step: Step, strings: _Strings) -> dict[str, Any]:
    return {
        "entities": [_entity_data(entity, strings) for entity in step.entities],
        "facts": strings.indices(step.facts.splitlines()),
    }


def _entity_data(entity: SeenEntity, strings: _Strings) -> dict[str, Any]:
    return {
        "name": entity.name,
        "kind": entity.kind,
        "confidence": _number(entity.confidence),
        "box": [int(edge) for edge in entity.box],
        "weight": _number(entity.weight),
        "facts": strings.indices(entity.facts),
    }


def _number(value: float) -> float | None:
    """Five significant digits are more than a chart shows; JSON has no infinity and no NaN."""
    return float(f"{value:.5g}") if math.isfinite(value) else None


def _least(values: Iterable[float]) -> float | None:
    return _number(min(filter(math.isfinite, values), default=math.inf))


def _encode(frame: Frame, quality: int) -> str:
    buffer = io.BytesIO()
    Image.fromarray(frame).save(buffer, "WEBP", quality=quality, method=2)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def _encode_classes(classes: ClassMap) -> str:
    """A class map in its colours; a picture of few colours is small without any loss."""
    picture = Image.fromarray(classes, "P")
    picture.putpalette(PALETTE.tobytes())
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def _quality(frames: Sequence[Frame]) -> int:
    """The best quality at which a sample of the frames says that all keep to the budget."""
    sample = frames[:: max(1, len(frames) // 24)]
    allowed = FRAME_BUDGET * len(sample) / len(frames)
    for quality in QUALITIES:
        if sum(len(_encode(frame, quality)) for frame in sample) <= allowed:
            return quality
    return QUALITIES[-1]
