"""Two thousand inputs by chance, the same every time; ``python -m tests.fuzz --inputs N --seed S`` tries others."""

from collections import Counter

import numpy as np
import pytest

import rgbd_planes as rp
from fuzz import __main__, calls, formats
from fuzz.run import chosen, run

INPUTS = 2000


@pytest.mark.parametrize("part", range(4))
def test_whatever_goes_in_what_is_promised_comes_out(part):
    counts = Counter()
    for seed in range(part, INPUTS, 4):
        try:
            counts[run(seed)[1]] += 1
        except Exception as error:
            error.add_note(f"python -m tests.fuzz --seed {seed} --inputs 1 --kind {chosen(seed)}")
            raise
    assert counts["fitted"] > 100  # it does not refuse all
    assert counts["refused"] > 10


@pytest.mark.parametrize("name", formats.FORMATS)
def test_files_that_are_not_damaged_are_read(name, tmp_path):
    content, writer = formats.whole(name)
    formats._use(formats.FORMATS[name], writer(content)(tmp_path))


def test_each_call_has_its_share():
    names = {chosen(seed) for seed in range(20_000)}
    assert names == {*calls.CALLS, *calls.RARE, *formats.FORMATS}


@pytest.mark.parametrize("name", [*calls.CALLS, *calls.RARE])
def test_no_call_refuses_all(name):
    assert "fitted" in (run(seed, name)[1] for seed in range(50))


def test_processes_share_the_inputs(capsys):
    said = []
    for processes in ("1", "2"):
        assert __main__.main(["--kind", "camera", "--inputs", "120", "--processes", processes]) == 0
        *counts, _ = capsys.readouterr().out.splitlines()
        said.append(counts)
    assert said[0] == said[1]


@pytest.mark.parametrize("focal", [1e-5, -1e-3, 9e-3])
def test_a_camera_whose_pixel_sees_everything_is_refused(focal):
    with pytest.raises(ValueError, match=r"expected f[xy] in pixels, 0\.01 to 1e\+08 or minus that"):
        rp.Camera(32, 24, focal, focal, 16.0, 12.0)


@pytest.mark.parametrize("method", ["range_explicit", "range_implicit", "standard_explicit", "standard_pca"])
@pytest.mark.filterwarnings("ignore::UserWarning")  # such depths, and noise that is large beside their 1/Z, are doubted
@pytest.mark.parametrize("metres", [1e-35, 1e35])
def test_planes_that_no_camera_sees_are_degenerate(method, metres):
    camera = rp.Camera(32, 24, 28.0, 28.0, 16.0, 12.0, noise=rp.noise.kinect_v1())
    found = rp.fit_tiles(np.full((24, 32), metres), camera, 8, method)
    assert (found.status == rp.TileStatus.DEGENERATE).all()
    assert np.isnan(found.planes).all()


@pytest.mark.parametrize("metres", [1e-40, 1e40])
def test_depths_that_float32_does_not_hold_are_missing(metres):
    found = rp.fit_tiles(np.full((24, 32), metres), rp.Camera(32, 24, 28.0, 28.0, 16.0, 12.0), 8)
    assert (found.status == rp.TileStatus.TOO_FEW).all()
    assert not found.valid_count.any()
