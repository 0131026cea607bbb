"""Pictures of the stages of the segmentation, which ``python -m bench.pictures`` draws."""

import contextlib
import functools
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from bench import curved_scenes
from rgbd_planes import Camera, Reason, Segmentation
from rgbd_planes.kernels.segmentation.model.records import BLOCK
from rgbd_planes.plotting.colours import MISSING, NO_PLANE, label_colours
from rgbd_planes.segmentation import regions, segment

Labels = NDArray[np.int32]
FAINT = 0.35


def stages(depth: NDArray[Any], camera: Camera) -> tuple[dict[str, Labels], Segmentation]:
    """Segment a frame, and say of which square, region, part or plane each pixel is after each stage: 0 for none."""
    found: dict[str, Labels] = {}

    def of_pixels(blocks: Labels) -> Labels:
        pixels = np.kron(blocks + 1, np.ones((BLOCK, BLOCK), np.int32))
        return np.asarray(pixels[: camera.height, : camera.width])

    def of_runs(runs: tuple[NDArray[np.int32], ...], count: int) -> Labels:
        _, rows, starts, stops, owners, *_ = runs
        pixels = np.zeros(camera.shape, np.int32)
        for row, start, stop, region in zip(rows[:count], starts[:count], stops[:count], owners[:count], strict=True):
            pixels[row, start:stop] = region + 1
        return pixels

    def watched(module: Any, name: str, seen: Callable[..., tuple[str, Labels]]) -> AbstractContextManager[Any]:
        kernel = getattr(module, name)

        def call(*arguments: Any) -> Any:
            result = kernel(*arguments)
            stage, labels = seen(result, *arguments)
            found.setdefault(stage, labels.copy())
            return result

        return mock.patch.object(module, name, call)

    turns = iter(("grown", "merged"))
    with contextlib.ExitStack() as patches:
        for patch in (
            watched(regions, "join_blocks", lambda _, view, block, *__: ("squares", of_pixels(block))),
            watched(regions, "renumber_regions", lambda _, block, *__: (next(turns, "later"), of_pixels(block))),
            watched(segment, "connect", lambda counts, _, __, runs: ("assigned", of_runs(runs, counts[0]))),
        ):
            patches.enter_context(patch)
        result = segment.segment(depth, camera)
    found["found"] = result.labels
    return found, result


def painted(labels: Labels, measured: NDArray[np.bool_], seed: int = 3) -> NDArray[np.float64]:
    """RGB of labels: neighbours in different colours, what has none dark, and what is missing light."""
    order = np.random.default_rng(seed).permutation(int(labels.max()))
    colours = np.vstack([[NO_PLANE], label_colours(len(order))[order]])
    return np.where(measured[..., None], colours[labels], MISSING)


@functools.cache
def _pictures() -> dict[str, NDArray[np.float64]]:
    make, (measure, camera) = curved_scenes.SCENES[0], curved_scenes.SENSORS[0]
    depth = measure(make().render(camera).depth, 7)
    found, result = stages(depth, camera)
    measured = depth > 0
    near = np.where(measured, 1.0 / np.maximum(depth, 1), 0.0)
    low, high = np.quantile(near[measured], (0.01, 0.99))
    grey = np.clip((near - low) / (high - low), 0.0, 1.0)
    pictures = {"depth": np.where(measured[..., None], grey[..., None] * np.ones(3), MISSING)}
    pictures |= {stage: painted(labels, measured) for stage, labels in found.items()}
    faint = 1.0 - FAINT * (1.0 - pictures["assigned"])
    pictures["curved"] = np.where((result.reason == Reason.CURVED)[..., None], NO_PLANE, faint)
    return pictures


STAGES = ("depth", "squares", "grown", "merged", "assigned", "curved", "found")


def draw(stage: str, folder: Path) -> None:
    """Draw a rendered frame after a stage, to ``stage_{stage}.png``."""
    image = Image.fromarray(np.rint(255.0 * _pictures()[stage]).astype(np.uint8))
    image = image.resize((400, 300), Image.Resampling.NEAREST).quantize(64)
    image.save(folder / f"stage_{stage}.png", optimize=True)
