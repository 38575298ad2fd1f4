import subprocess
import sys

import numpy as np
import pytest

from sfol.errors import UsageError
from vsr.classes import CLASS_COUNT
from vsr.segmentation import Frame, Segmenter, SimulatorSegmenter


def frame(classes: np.ndarray) -> Frame:
    return Frame(
        gray=np.zeros(classes.shape, np.uint8),
        classes=classes,
        instances=np.full(classes.shape, -1, np.int32),
    )


def test_the_simulators_map_is_one_hot():
    rng = np.random.default_rng(0)
    maps = rng.integers(0, CLASS_COUNT, (3, 8, 16), dtype=np.uint8)
    segmenter: Segmenter = SimulatorSegmenter()
    probabilities = segmenter([frame(classes) for classes in maps])
    assert probabilities.shape == (3, CLASS_COUNT, 8, 16)
    assert probabilities.dtype == np.float32
    assert np.array_equal(probabilities.argmax(axis=1), maps)
    assert np.array_equal(probabilities.sum(axis=1), np.ones((3, 8, 16)))


def test_no_frames_are_an_error():
    with pytest.raises(UsageError, match="at least one frame"):
        SimulatorSegmenter()([])


@pytest.mark.parametrize("module", ["vsr", "vsr.grounding", "vsr.classes", "vsr.segmentation"])
def test_light_modules_load_neither_torch_nor_scipy(module):
    code = f"import sys, {module}; assert not {{'torch', 'scipy'}} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
