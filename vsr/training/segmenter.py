"""What the segmenter learns: the class of every pixel, small pedestrians included."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from vsr.classes import CLASS_COUNT, DESCRIPTOR_CLASSES, SemanticClass
from vsr.networks.inference import default_device, to_input, training_dtype
from vsr.training.augmentation import relight
from vsr.training.frames import FrameSet
from vsr.training.loop import Metrics, batches

_WINDOW = 128  # px
_WHOLE_FRAMES_FROM = 0.8  # of the training
_AT_PEOPLE = 0.75  # of the windows


class SegmenterTask:
    """Pixel classification by cross-entropy and soft Dice.

    For most of the training a batch sees a part of the frames, which costs less: a `band` of rows,
    or, to learn people better, `windows`. Whole frames come last.

    Args:
        network: (B, 1, H, W) to (B, 28, H, W) logits.
        train: frames to learn from.
        validation: frames of other streets.
        device: where to compute.
        focus: whether parts are windows, most of them where there are people.
    """

    def __init__(
        self,
        network: nn.Module,
        train: FrameSet,
        validation: FrameSet,
        device: torch.device | None = None,
        *,
        focus: bool = False,
    ) -> None:
        self._part = windows if focus else band
        self._device = device or default_device()
        self._dtype = training_dtype(self._device)
        self.network = network.to(self._device).to(memory_format=torch.channels_last)
        self.size = len(train)
        self._train = _tensors(train)
        self._validation = _tensors(validation)

    def loss(self, indices: Tensor, rng: torch.Generator, progress: float) -> Tensor:
        """Return cross-entropy plus soft Dice of a batch."""
        gray, classes = (part[indices] for part in self._train)
        if progress < _WHOLE_FRAMES_FROM:
            gray, classes = self._part(gray, classes, rng)
        inputs = relight(to_input(gray), rng).to(self._device, memory_format=torch.channels_last)
        targets = classes.to(self._device, torch.int64)
        with self._autocast():
            logits = self.network(inputs)
        return segmentation_loss(logits.float(), targets)

    def validate(self) -> Metrics:
        """Return the IoU of each descriptor class over all frames; the score is their mean."""
        counts = torch.zeros(CLASS_COUNT, CLASS_COUNT, dtype=torch.int64)
        for part in batches(len(self._validation[0]), 16):
            gray, classes = (column[part] for column in self._validation)
            inputs = to_input(gray).to(self._device, memory_format=torch.channels_last)
            with self._autocast():
                found = self.network(inputs).argmax(dim=1).cpu()
            counts += confusion(found, classes)
        ious = intersection_over_union(counts)
        metrics = {kind.name.lower(): float(ious[kind]) for kind in DESCRIPTOR_CLASSES}
        return {"score": sum(metrics.values()) / len(metrics), **metrics}

    def _autocast(self) -> torch.autocast:
        reduced = self._dtype != torch.float32
        return torch.autocast(self._device.type, torch.bfloat16, enabled=reduced)


def segmentation_loss(logits: Tensor, targets: Tensor) -> Tensor:
    """Return cross-entropy plus one minus the mean Dice of the classes in the batch.

    Cross-entropy counts pixels, and a pedestrian has few; Dice counts classes.

    Args:
        logits: float32 (B, 28, H, W).
        targets: int64 (B, H, W).

    Source: Milletari et al., "V-Net", 2016, for the soft Dice.
    """
    log_probabilities = functional.log_softmax(logits, dim=1)
    entropy = functional.nll_loss(log_probabilities, targets)
    probabilities = log_probabilities.exp()
    own = probabilities.gather(1, targets.unsqueeze(1)).flatten()
    pixels = torch.bincount(targets.flatten(), minlength=CLASS_COUNT)
    overlap = torch.zeros(CLASS_COUNT, device=own.device).index_add(0, targets.flatten(), own)
    dice = 2.0 * overlap / (probabilities.sum(dim=(0, 2, 3)) + pixels + 1.0)
    return entropy + 1.0 - dice[pixels > 0].mean()


def confusion(found: Tensor, classes: Tensor) -> Tensor:
    """Return how often each class (row) was taken for each (column), int64 (28, 28)."""
    pairs = classes.to(torch.int64).flatten() * CLASS_COUNT + found.to(torch.int64).flatten()
    return torch.bincount(pairs, minlength=CLASS_COUNT**2).reshape(CLASS_COUNT, CLASS_COUNT)


def intersection_over_union(counts: Tensor) -> Tensor:
    """Return the IoU of every class, nan for those that neither occur nor are found.

    Args:
        counts: int64 (28, 28), from `confusion`.
    """
    both = counts.diagonal().to(torch.float64)
    return both / (counts.sum(dim=0) + counts.sum(dim=1) - both)


def band(gray: Tensor, classes: Tensor, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return 128 rows of the frames, the same of all.

    Wherever they begin, they hold the rows around the horizon, in which all that is far away lies.

    Args:
        gray: uint8 (B, H, W).
        classes: uint8 (B, H, W).
        rng: decides which rows.
    """
    top = _below(max(gray.shape[1] - _WINDOW, 0) + 1, rng)
    return gray[:, top : top + _WINDOW], classes[:, top : top + _WINDOW]


def windows(gray: Tensor, classes: Tensor, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return a window of each frame, three in four around a pixel of a pedestrian.

    Of whole frames, people are one pixel in a hundred.

    Args:
        gray: uint8 (B, H, W).
        classes: uint8 (B, H, W).
        rng: decides where.

    Returns:
        Both cut to the windows, uint8 (B, 128, 128), or less where frames are smaller.
    """
    places = [_window(labels, rng) for labels in classes]
    cut_gray = [frame[place] for frame, place in zip(gray, places, strict=True)]
    cut_classes = [labels[place] for labels, place in zip(classes, places, strict=True)]
    return torch.stack(cut_gray), torch.stack(cut_classes)


def _window(labels: Tensor, rng: torch.Generator) -> tuple[slice, slice]:
    people = (labels == SemanticClass.PEDESTRIAN).nonzero()
    if len(people) and torch.rand((), generator=rng) < _AT_PEOPLE:
        target = people[_below(len(people), rng)].tolist()
    else:
        target = [_below(size, rng) for size in labels.shape]
    row, column = (_start(at, size, rng) for at, size in zip(target, labels.shape, strict=True))
    return slice(row, row + _WINDOW), slice(column, column + _WINDOW)


def _start(target: int, size: int, rng: torch.Generator) -> int:
    """Return where a window begins that has the target anywhere in it, within the frame."""
    return min(max(target - _below(_WINDOW, rng), 0), max(size - _WINDOW, 0))


def _below(end: int, rng: torch.Generator) -> int:
    return int(torch.randint(end, (), generator=rng))


def _tensors(frames: FrameSet) -> tuple[Tensor, Tensor]:
    return torch.from_numpy(frames.gray), torch.from_numpy(frames.classes)
