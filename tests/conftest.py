"""What all tests share."""

import os

import numpy as np
import pytest
from hypothesis import settings

from bench import real_data

# The same examples every time: what passes here passes elsewhere.
# ``pytest --hypothesis-profile=others`` looks for others. No test depends on how long something takes.
settings.register_profile("same", derandomize=True, database=None, deadline=None)
settings.register_profile("others", deadline=None)
settings.load_profile("same")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config):
    """With ``-n auto`` few processes: nearly all time goes into compiling, and more compile the same."""
    return min(os.cpu_count() or 1, 4)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keep a file's tests in one process: they need the same kernels."""
    from xdist.scheduler import LoadFileScheduling

    return LoadFileScheduling(config, log) if config.getoption("dist") == "load" else None


def pytest_configure(config):
    """One of several processes compiles a kernel, and the others load it."""
    if hasattr(config, "workerinput"):
        import compiled_once

        compiled_once.share(config.workerinput["testrunuid"])


# What ``pytest -m quick`` runs: something of each folder, without simulations and without the largest kernels.
QUICK = (
    "camera/test_camera", "camera/test_depth", "cli/test_progress", "core/test_checks",
    "docs/test_layout", "docs/test_packaging", "evaluation/test_metrics", "fitting/test_labels", "fitting/test_windows",
    "kernels/test_marked", "noise/test_noise_models", "segmentation/test_segmentation_result", "sequences/test_images",
    "uncertainty/test_comparing_planes",
)  # fmt: skip


def pytest_collection_modifyitems(items):
    """Mark the tests of the quick files."""
    for item in items:
        if "/".join(item.path.with_suffix("").parts[-2:]) in QUICK:
            item.add_marker(pytest.mark.quick)


@pytest.fixture
def rng():
    """A generator that starts the same in every test."""
    return np.random.default_rng(20170331)


@pytest.fixture(scope="module")
def room():
    """The furnished room as `segment_frames.CAMERA` sees it, and its depth with 5 % of the pixels missing."""
    from segment_frames import CAMERA

    from rgbd_planes.evaluation import scenes

    rendering = scenes.room().render(CAMERA)
    return rendering, rendering.measure(holes=0.05, seed=3)


@pytest.fixture
def link():
    """Make a symbolic link of the first path to the second, or skip the test where that may not be, as on Windows."""

    def make(path, target):
        try:
            path.symlink_to(target)
        except OSError as error:
            pytest.skip(f"symbolic links cannot be made here: {error}")

    return make


def real_frames():
    """(name, depth path, camera path) of every real frame there is; empty where there are none."""
    return [
        (f"{path.parents[1].name}/{path.stem}", path, path.parents[1] / "camera.json")
        for path in sorted(real_data.FOLDER.glob("*/depth/*.png"))
    ]


def pytest_generate_tests(metafunc):
    """Run a test that takes ``real_frame`` on one frame of each real set, or skip it with the reason."""
    if "real_frame" not in metafunc.fixturenames:
        return
    first_of_set = {name.split("/")[0]: (depth, camera) for name, depth, camera in reversed(real_frames())}
    if first_of_set:
        metafunc.parametrize("real_frame", list(first_of_set.values()), ids=list(first_of_set), indirect=True)
    else:
        reason = pytest.mark.skip(reason=real_data.REASON)
        metafunc.parametrize("real_frame", [pytest.param(None, marks=reason)])


@pytest.fixture
def real_frame(request):
    """(depth, camera) of a real frame."""
    from rgbd_planes import Camera
    from rgbd_planes.sequences import images

    depth, camera = request.param
    return images.read_depth(depth), Camera.load(camera)
