"""Shared by segmentations of one camera's frames: where its pixels look, and arrays to work in."""

import contextlib
import functools
import threading
from collections.abc import Iterator

import numpy as np

from rgbd_planes._core.arrays import aligned
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.pixel_pitch import lens_by_angle
from rgbd_planes.kernels.segmentation.assign.contested_blocks import NEIGHBOURS
from rgbd_planes.kernels.segmentation.model.pixel_noise import stretches as write_stretches
from rgbd_planes.kernels.segmentation.model.records import (
    BLOCK,
    Contacts,
    Contended,
    Owners,
    Pyramid,
    Rays,
    Runs,
    Shares,
)

LEVELS = 4  # blocks, and squares of 2, 4 and 8 blocks


@functools.lru_cache(maxsize=8)
def rays_of(camera: Camera) -> Rays:
    """Where the pixels of a camera look."""
    height, width = camera.shape
    rows, columns = _shapes(camera)[0]
    lens = lens_by_angle(camera)
    middle_y = np.minimum(np.arange(rows) * BLOCK + BLOCK // 2, height - 1)
    middle_x = np.minimum(np.arange(columns) * BLOCK + BLOCK // 2, width - 1)
    tan_x, tan_y = camera._rays
    centre_u, centre_v = tan_x[:, middle_x], tan_y[middle_y]
    if camera.is_distorted:
        centre_u, centre_v = np.ascontiguousarray(centre_u[middle_y]), np.ascontiguousarray(centre_v[:, middle_x])
    stretches = [np.ones((rows, columns))]
    if lens.size:
        write_stretches(centre_u, centre_v, lens, stretches[0])
    for high, wide in _shapes(camera)[1:]:
        stretches.append(stretches[-1].reshape(high, 2, wide, 2).mean(axis=(1, 3)))
    return Rays(
        *camera._rays,
        centre_u=centre_u,
        centre_v=centre_v,
        pitch_x=1.0 / camera.fx,
        pitch_y=1.0 / camera.fy,
        lens=lens,
        stretch=np.concatenate([level.ravel() for level in stretches]),
    )


def _shapes(camera: Camera) -> list[tuple[int, int]]:
    """Rows and columns of each level of the pyramid; those of one are twice those of the next."""
    largest = BLOCK << (LEVELS - 1)
    rows, columns = -(-camera.height // largest), -(-camera.width // largest)
    return [(rows << level, columns << level) for level in reversed(range(LEVELS))]


class Workspace:
    """Arrays to work in. New ones for every frame would cost a millisecond: the system clears them."""

    def __init__(self, camera: Camera) -> None:
        self.shape = camera.shape
        pixels = camera.height * camera.width
        shapes = np.array(_shapes(camera))
        offsets = np.concatenate([[0], np.cumsum(shapes.prod(axis=1))])
        self.blocks = _shapes(camera)[0]  # rows and columns of blocks
        blocks, squares = int(offsets[1]), int(offsets[-1])
        self.inverse_depth = aligned(camera.shape, np.float32)
        self.pyramid = Pyramid(aligned((10, squares)), aligned((squares,)), aligned((squares,)), offsets, shapes)
        self.owners = Owners(*np.empty((4, *self.blocks), np.int32))
        self.contended = Contended(
            np.empty(blocks, np.int32),
            np.empty(blocks, np.int32),
            np.empty(blocks, np.int32),
            np.empty(NEIGHBOURS * blocks, np.int32),
            np.empty((NEIGHBOURS * blocks, 3)),
        )
        self.sensor = np.empty(blocks)
        self.region, self.last_region = np.empty((2, *self.blocks), np.int32)
        self.region_moments = np.empty((blocks, 10))
        most = NEIGHBOURS * blocks  # of which hardly a tenth is ever touched
        self.shares = Shares(np.empty(most, np.int32), np.empty(most, np.int32), np.empty((most, 10)))
        self.contacts = Contacts(
            np.empty((4 * blocks + 1, 3), np.int32),
            np.empty((4 * blocks, 3)),
            np.zeros(1 << (4 * blocks).bit_length(), np.int32),
        )
        self.strays, self.edges = np.empty((2, pixels), np.int32)
        self.runs = Runs(np.empty(camera.height + 1, np.int32), *np.empty((7, pixels), np.int32))


class Workspaces(threading.local):
    """Each thread's own workspace, kept from frame to frame."""

    def __init__(self) -> None:
        self._kept: list[Workspace] = []

    @contextlib.contextmanager
    def lent(self, camera: Camera) -> Iterator[Workspace]:
        """Lent exclusively: a noise function, or a signal handler, may also segment a frame."""
        try:
            work = self._kept.pop()  # in one step, whenever a signal comes
        except IndexError:
            work = Workspace(camera)
        if work.shape != camera.shape:
            work = Workspace(camera)
        try:
            yield work
        finally:
            self._kept[:] = [work]


workspaces = Workspaces()
