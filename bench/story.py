"""The moving picture of the README: a camera passes through a rendered room; depth, tiles, planes, and its path.

``python -m bench.pictures story`` draws it.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import rgbd_planes as rp
from bench import curved_scenes
from rgbd_planes.evaluation import scenes
from rgbd_planes.plotting.colours import label_colours, normal_colours
from rgbd_planes.plotting.segments import label_image

CAMERA = rp.Camera(320, 240, 262.5, 262.5, 159.5, 119.5, depth_scale=1000.0)
FRAMES = 16
_SIZE = 360, 270  # of a panel
_MARGIN, _CAPTION = 8, 24
_BACKGROUND, _INK = (255, 255, 255), (40, 40, 40)
_BENT = np.array([0.93, 0.55, 0.14])


def draw(path: Path) -> None:
    """Write the picture, a GIF that repeats, after a look at its end."""
    pages = [_page(*parts) for parts in _frames()]
    palette = Image.fromarray(np.concatenate([np.asarray(page) for page in pages[:: len(pages) - 1]]))
    common = palette.quantize(96, dither=Image.Dither.NONE)
    first, *rest = [page.quantize(palette=common, dither=Image.Dither.NONE) for page in pages]
    held = [160] * len(rest) + [1200]
    first.save(path, save_all=True, append_images=rest, duration=held, loop=0, optimize=True)


def _frames() -> Any:
    """Depth, tiles, followed planes, and poses so far, of each frame."""
    scene = curved_scenes.furnished()
    tracker, before, pose, poses = rp.PlaneTracker(), None, np.eye(4), []
    fitter = rp.TileFitter(CAMERA.with_noise(rp.noise.kinect_v1()), tile=8)
    generator = np.random.default_rng(1)
    for s in np.linspace(0.0, 1.0, FRAMES):
        eye = (0.75 - 0.8 * s, -1.45 - 0.1 * np.sin(3.0 * s), -0.35 + 0.35 * s)
        seen = scenes.Scene(scene.surfaces, scenes.look_at(eye, (-0.15 + 0.15 * s, -0.75, 2.6)))
        depth = seen.render(CAMERA).depth
        noisy = 1.0 / (1.0 / depth + generator.normal(0.0, rp.noise.KINECT_V1, depth.shape))
        missing = generator.random(depth.shape) < 0.02
        raw = np.where(missing | ~np.isfinite(noisy), 0, np.rint(1000.0 * noisy)).astype(np.uint16)
        tracked = tracker.follow(rp.segment(raw, CAMERA))
        if before is not None:
            pose = pose @ np.linalg.inv(_motion(before, tracked))
        before = tracked
        poses.append(pose)
        yield raw, fitter.fit(raw), tracked, np.array(poses)


def _motion(before: rp.TrackedSegmentation, now: rp.TrackedSegmentation) -> NDArray[np.float64]:
    """The camera's motion, from the large planes that both frames show."""
    _, i, j = np.intersect1d(before.ids, now.ids, return_indices=True)
    first, second = before.segmentation, now.segmentation
    large = (first.sizes[i] > 500) & (second.sizes[j] > 500)
    i, j = i[large], j[large]
    motion, _ = rp.uncertainty.align_planes(
        first.planes[i], first.plane_covariance[i], second.planes[j], second.plane_covariance[j]
    )
    return motion


def _page(
    raw: NDArray[np.uint16], tiles: rp.TilePlanes, tracked: rp.TrackedSegmentation, poses: NDArray[np.float64]
) -> Image.Image:
    """The four panels with their captions."""
    found = tracked.segmentation
    metres = np.where(raw > 0, raw / 1000.0, np.nan)
    grey = np.nan_to_num(np.clip(1.05 - 0.2 * metres, 0.0, 1.0))
    normals = np.where(tiles.fitted[..., None], tiles.planes[..., :3], np.nan)
    planes = label_image(found, raw, tracked.ids)
    planes[found.reason == rp.Reason.CURVED] = _BENT
    panels = (
        ("1  depth, with holes and noise", np.repeat(grey[..., None], 3, axis=2)),
        ("2  a plane for every tile, with its uncertainty", normal_colours(normals)),
        ("3  the planes of the scene; what is curved is orange", planes),
        ("4  their outlines in space, and the camera's path", None),
    )
    width, height = _SIZE
    size = 2 * width + 3 * _MARGIN, 2 * (height + _CAPTION) + 3 * _MARGIN
    page = Image.new("RGB", size, _BACKGROUND)
    write = ImageDraw.Draw(page)
    font = ImageFont.load_default(14)
    for number, (caption, image) in enumerate(panels):
        left = _MARGIN + (number % 2) * (width + _MARGIN)
        top = _MARGIN + (number // 2) * (height + _CAPTION + _MARGIN)
        write.text((left + 2, top + 2), caption, fill=_INK, font=font)
        if image is None:
            picture = _space(tracked, poses)
        else:
            picture = Image.fromarray(np.rint(255.0 * image).astype(np.uint8)).resize(_SIZE, Image.Resampling.NEAREST)
        page.paste(picture, (left, top + _CAPTION))
    return page


def _space(tracked: rp.TrackedSegmentation, poses: NDArray[np.float64]) -> Image.Image:
    """The outlines of the planes in the axes of the first camera, and the path, from behind and above."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    width, height = _SIZE
    figure = Figure((width / 100, height / 100), dpi=100)
    canvas: Any = FigureCanvasAgg(figure)
    axes: Any = figure.add_axes((-0.32, -0.58, 1.64, 1.88), projection="3d")
    pose, colours = poses[-1], label_colours(int(tracked.ids.max()))
    for outline in rp.plane_polygons(tracked.segmentation, tolerance=1.0):
        for rings in outline.rings():
            ring = rings[0] @ pose[:3, :3].T + pose[:3, 3]
            face = Poly3DCollection(
                [ring[:, [0, 2, 1]]], facecolor=colours[tracked.ids[outline.label - 1] - 1], alpha=0.8
            )
            face.set_edgecolor("black")
            face.set_linewidth(0.4)
            axes.add_collection3d(face)
    path = poses[:, [0, 2, 1], 3]
    axes.plot(*path.T, color="tab:orange", linewidth=2.5)
    axes.scatter(*path[-1:].T, color="black", s=16)
    axes.set(xlim=(-2.3, 1.7), ylim=(-0.3, 4.0), zlim=(1.6, -1.6))
    axes.set_box_aspect((4.0, 4.3, 3.2))
    axes.view_init(elev=32.0, azim=-104.0)
    axes.set_axis_off()
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
