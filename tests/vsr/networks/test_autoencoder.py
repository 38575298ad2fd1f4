import numpy as np
import pytest
import torch

from sfol.errors import UsageError
from vsr.networks.autoencoder import Autoencoder, FeatureEncoder
from vsr.segmentation import Frame
from vsr.training.autoencoder import psnr, reconstruction_loss


@pytest.fixture(scope="module")
def autoencoder() -> Autoencoder:
    torch.manual_seed(0)
    return Autoencoder().eval()


def frames(count: int) -> list[Frame]:
    rng = np.random.default_rng(0)
    blank = np.zeros((224, 224), np.uint8)
    return [
        Frame(rng.integers(0, 256, (224, 224), dtype=np.uint8), blank, blank.astype(np.int32))
        for _ in range(count)
    ]


def test_a_frame_becomes_a_feature_map(autoencoder):
    features = FeatureEncoder(autoencoder, "float32").encode(frames(2))
    assert features.shape == (2, 512, 7, 7)
    assert features.dtype == torch.float32
    assert torch.isfinite(features).all()


def test_a_frame_is_encoded_alike_alone_and_in_a_batch(autoencoder):
    encoder = FeatureEncoder(autoencoder, "float32")
    both = frames(2)
    assert torch.allclose(encoder.encode(both)[1], encoder.encode(both[1:])[0], atol=1e-4)


def test_no_frames_are_an_error(autoencoder):
    with pytest.raises(UsageError, match="at least one frame"):
        FeatureEncoder(autoencoder, "float32").encode([])


def test_what_is_drawn_has_the_size_of_the_picture(autoencoder):
    with torch.inference_mode():
        assert autoencoder(torch.zeros(1, 1, 64, 96)).shape == (1, 1, 64, 96)


def test_psnr_is_that_of_the_textbook():
    pictures = torch.zeros(1, 1, 8, 8)
    # a tenth of the whole range from -1 to 1 is 20 dB below the peak
    assert psnr(pictures + 0.2, pictures).item() == pytest.approx(20.0, abs=1e-4)


def test_the_loss_is_zero_for_the_picture_itself_and_counts_edges():
    picture = torch.zeros(1, 1, 8, 8)
    lighter, striped = picture + 0.1, picture.clone()
    striped[..., ::2], striped[..., 1::2] = 0.1, -0.1
    assert reconstruction_loss(picture, picture) == 0.0
    assert reconstruction_loss(striped, picture) > 2.0 * reconstruction_loss(lighter, picture)
