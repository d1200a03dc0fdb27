"""python -m tests.real: its measures, its refusals, and a whole evaluation of a known room."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.tools.import_pairs import main as import_pairs
from tests.pairs_of_rooms import AMBIENT, PROJECTOR, Wall, natural_pictures, write, write_pairs
from tests.real import __main__ as evaluation
from tests.real import correction, network, surrogate
from tests.real.__main__ import main
from tests.real.measures import measured


def write_set_up(data: Path, rng: np.random.Generator, train: int, test: int) -> Path:
    """Write a data set in the layout of CompenNet, and return the folder of its only set-up."""
    set_up = data / "light1" / "pos1" / "wall"
    black = np.zeros((1, *PROJECTOR, 3), np.uint8)
    parts = {"train": natural_pictures(rng, train), "test": natural_pictures(rng, test), "ref": black}
    for part, pictures in parts.items():
        shown, seen = data / part, set_up / "cam" / "raw" / part
        for folder in (shown, seen):
            folder.mkdir(parents=True)
        for number, codes in enumerate(pictures, 1):
            write(shown / f"img_{number:04}.png", codes)
            write(seen / f"img_{number:04}.png", Wall().capture(codes, rng))
    return set_up


def test_measures_are_those_of_the_literature(rng: np.random.Generator) -> None:
    """SSIM by its formula with a window of 11x11 pixels (Wang 2004); the root of summed squares over channels."""
    a = rng.uniform(0, 1, (40, 50, 3))
    b = np.clip(a + rng.normal(0, 0.1, a.shape), 0, 1)

    def mean(picture: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.GaussianBlur(picture, (11, 11), 1.5, borderType=cv2.BORDER_REFLECT))

    ma, mb, c1, c2 = mean(a), mean(b), 0.01**2, 0.03**2
    va, vb, vab = mean(a * a) - ma * ma, mean(b * b) - mb * mb, mean(a * b) - ma * mb
    ssim = (2 * ma * mb + c1) * (2 * vab + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))
    found = measured(a[None], b[None], np.ones(a.shape[:2], bool))
    assert found.ssim == pytest.approx(ssim.mean(), abs=1e-6)
    assert found.rmse == pytest.approx(np.sqrt(((a - b) ** 2).sum(axis=-1).mean()))
    assert found.psnr == pytest.approx(-10 * np.log10(((a - b) ** 2).mean()))


def test_training_follows_the_slope_of_ssim(rng: np.random.Generator) -> None:
    """Against differences of scikit-image's SSIM map, summed."""
    a = rng.uniform(0, 1, (24, 20, 3))
    b = np.clip(a + rng.normal(0, 0.1, a.shape), 0, 1)
    slope = network.ssim_slope(a, b)
    for at in ((12, 9, 0), (10, 10, 2)):
        step = np.zeros_like(a)
        step[at] = 1e-4
        low, high = (measured((a + sign * step)[None], b[None], np.ones(a.shape[:2], bool)).ssim for sign in (-1, 1))
        # second-order differences of the loss
        assert slope[at] == pytest.approx((high - low) / 2e-4 * a.size, rel=1e-4)


def test_a_network_learns_colours_that_depend_on_the_neighbourhood(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(network, "CROPS", 50)
    pictures = rng.uniform(0, 1, (6, 40, 40, 3)).astype(np.float32)
    examples = [network.Example(network.around(each), each, cv2.blur(each, (3, 3))) for each in pictures]
    trained = network.trained(examples[:5], 5, steps=150, similarity=0.02)
    left = trained.apply(examples[5].inputs, examples[5].base) - examples[5].wanted
    assert np.std(left) < 0.3 * np.std(examples[5].base - examples[5].wanted)


def test_a_set_up_is_evaluated_in_both_directions(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (correction, surrogate):
        monkeypatch.setattr(module, "STEPS", 100)  # enough for a smooth wall
    for module in (surrogate, evaluation):
        monkeypatch.setattr(module, "SIZE", PROJECTOR[::-1])
    monkeypatch.setattr(network, "CROPS", 200)
    set_up = write_set_up(tmp_path / "data", rng, 12, 2)
    assert main([str(set_up), "--size", "128x96"]) == 0
    printed = capsys.readouterr().out
    assert "12 training pairs, 2 held out: img_0001.png=img_0001.png, img_0002.png=img_0002.png" in printed
    names = "0 levels", "model", "corrected"
    coarsest, model, corrected = (float(re.search(rf"forward, {name}: (\S+) dB", printed)[1]) for name in names)
    assert model > max(30, coarsest)  # noise of 0.2 % of white, and 12 pairs
    assert corrected > model - 0.5  # the model is nearly exact, and nothing is left to correct
    inside = [float(each) for each in re.findall(r"(?:interval|one width): (\S+) % inside", printed)]
    np.testing.assert_allclose(inside, 92, atol=6)  # 2 captures; a fit of 9 pairs predicts worse than a fit of 12 pairs
    alone, found = (float(re.search(rf"{name} \| (\S+) dB", printed)[1]) for name in ("inverse", "surrogate"))
    assert found > alone + 1


def test_import_finds_the_folders_and_the_black_photograph_of_a_set_up(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, room = tmp_path / "data", tmp_path / "room"
    set_up = write_set_up(data, rng, 10, 1)
    assert import_pairs([str(data), str(set_up), "--camera", "64x48", "-o", str(room)]) == 0
    assert "10 pairs matched by number" in capsys.readouterr().out
    ambient = calibration.read(room).calibration.ambient
    assert np.percentile(np.abs(ambient - AMBIENT), 99) < 0.007  # noise of 0.002; an estimate is off by up to 0.03


@pytest.fixture(scope="module")
def nine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with pictures and photographs of nine pairs."""
    return write_pairs(tmp_path_factory.mktemp("nine"), Wall(), np.random.default_rng(4), 9)[0].parent


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--pictures", "none", "--photographs", "photographs"], "none: no such folder; expected a folder of pictures"),
        (["--pictures", "pictures"], "name both folders, with --pictures and --photographs"),
        ([], "no cam/raw/train; name the folders with --pictures and --photographs"),
        (["--train", "4"], "4 training pairs and 1 held out, expected at least 8 and 1; change --train and --test"),
        (["--train", "9"], "9 training pairs and 0 held out, expected at least 8 and 1; change --train and --test"),
        (["--size", "90x90"], "128x96 cannot be reduced to 90x90"),
    ],
)
def test_refusals_are_one_line(nine: Path, capsys: pytest.CaptureFixture[str], words: list[str], line: str) -> None:
    named = [] if not words or words[0] == "--pictures" else ["--pictures", "pictures", "--photographs", "photographs"]
    assert main([str(nine), *named, *words]) == 2
    printed = capsys.readouterr().err
    assert line in printed
    assert printed.count("\n") == 1
