"""The planes that a tracker knows, where they are, and which of them a frame shows again."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats, Indices
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.rays import ray_tables
from rgbd_planes.kernels.motion.squares import find_places, label_squares
from rgbd_planes.segmentation.camera_motion import Motion, camera_motion
from rgbd_planes.segmentation.result import Segmentation
from rgbd_planes.uncertainty.planes import angle_and_offset

SHARED = 0.25  # share of the smaller one's pixels that a plane and its earlier self must have in common
TURNED = 20.0  # degrees between them, at most
MOVED = 0.15  # at most, difference of their distances from the camera, or of 1/Z where they were seen, as a share of it
NEARER = 1.03  # times 1/Z of a plane, at least, is that of what covers it
LONG = 60  # frames after which a plane is not better known than before
# Where less than this share of what is known and in sight is seen again, it is another scene, or something covers most
# of it: known planes stay where they are then, and only what has hardly turned or moved is the same.
FAMILIAR, HARDLY_TURNED, HARDLY_MOVED = 0.3, 3.0, 0.03

# The camera's motion is found from so many planes, and again, with what is seen then, as often as this at most. Of each
# plane about so many points are kept.
LARGEST, ROUNDS, POINTS = 15, 3, 100


class Points(NamedTuple):
    """Points of planes, plane by plane.

    Attributes
    ----------
    xyz : (P, 3) float64
        In the camera's frame.
    of : (P,) intp
        The plane of each.
    squares : (P,) float64
        Squares of 2x2 pixels that each stands for.
    unseen : (P,) intp
        Frames since it was seen, if its plane is in sight.
    """

    xyz: Floats = np.zeros((0, 3))
    of: Indices = np.zeros(0, np.intp)
    squares: Floats = np.zeros(0)
    unseen: Indices = np.zeros(0, np.intp)

    def some(self, chosen: Indices) -> Points:
        """Return those points."""
        return Points(self.xyz[chosen], self.of[chosen], self.squares[chosen], self.unseen[chosen])

    def renumbered(self, place: NDArray[Any]) -> Points:
        """Return the points with other numbers for their planes."""
        return self._replace(of=place[self.of])


def thin(counts: Indices) -> tuple[Indices, Floats]:
    """Which to keep of so many of each plane, plane by plane, and how many each of these stands for.

    One of each run of pixels that follow one another, picked at random. Every n-th pixel, row by row, would lie in a
    few columns only where n and the width of a plane have a common divisor, and at the same places of its rim in each
    frame. The same counts give the same.
    """
    numbers = -(-counts // np.maximum(counts // POINTS, 1))
    shares = np.repeat(counts / np.maximum(numbers, 1), numbers)
    first, place = (np.repeat(np.cumsum(each) - each, numbers) for each in (counts, numbers))
    # In double precision a place and what chance adds might round up to the next.
    chance = np.random.default_rng(counts @ counts).random(len(place), np.float32)
    return first + ((np.arange(len(place)) - place + chance) * shares).astype(np.intp), shares


class KnownPlanes(NamedTuple):
    """Planes in the order of their ids, (K, 4), the frames in which each was seen and those since, and their points."""

    ids: NDArray[np.int32] = np.zeros(0, np.int32)
    planes: Floats = np.zeros((0, 4))
    seen: Indices = np.zeros(0, np.intp)
    missed: Indices = np.zeros(0, np.intp)
    points: Points = Points()

    def moved(self, motion: Motion) -> KnownPlanes:
        """Return them as the camera sees them when it has moved."""
        points = self.points._replace(xyz=motion.move_points(self.points.xyz))
        return self._replace(planes=motion.move_planes(self.planes), points=points)

    def largest(self) -> KnownPlanes:
        """Return the LARGEST, of those that were seen lately rather than of others."""
        squares = np.bincount(self.points.of, self.points.squares, len(self.ids)) / (1.0 + self.missed)
        chosen = np.sort(np.argsort(-squares, kind="stable")[:LARGEST])
        place = np.full(len(self.ids), -1)
        place[chosen] = np.arange(len(chosen))
        points = self.points.some(np.flatnonzero(place[self.points.of] >= 0)).renumbered(place)
        return KnownPlanes(self.ids[chosen], self.planes[chosen], self.seen[chosen], self.missed[chosen], points)


class View(NamedTuple):
    """A frame by squares of 2x2 pixels: (R, C) labels, how many have each; tanθx and tanθy of their first pixels."""

    found: Segmentation
    labels: Indices
    sizes: Indices
    tan_x: Floats
    tan_y: Floats

    @classmethod
    def of(cls, found: Segmentation) -> View:
        """Return a segmentation by squares, labelled as their first pixel that has a label: others may be missing."""
        height, width = found.labels.shape
        labels, sizes = np.empty((-(-height // 2), -(-width // 2)), np.intp), np.empty(len(found) + 1, np.intp)
        label_squares(found.labels, labels, sizes)
        return cls(found, labels, sizes, *(tangent[::2, ::2] for tangent in ray_tables(found.camera)))

    def squares_of(self, xyz: Floats) -> tuple[Indices, Indices, NDArray[np.bool_]]:
        """Row and column of the square in which each point is seen, and whether it is in the image."""
        camera = self.found.camera
        if camera.is_distorted:  # what none of the image's rays comes near takes a lens long
            some = _is_near_rays(camera._lens, xyz)
            pixels = np.full((len(xyz), 2), np.nan)
            pixels[some] = camera.project(xyz[some])
        else:
            pixels = camera.project(xyz)
        column, row = np.rint(0.5 * pixels).T
        inside = (row >= 0) & (row < self.labels.shape[0]) & (column >= 0) & (column < self.labels.shape[1])
        return np.where(inside, row, 0).astype(np.intp), np.where(inside, column, 0).astype(np.intp), inside

    def inverse_depth(self, label: Indices, row: Indices, column: Indices) -> Floats:
        """1/Z of the plane with each label where a square is; infinite for label 0."""
        a = np.vstack([[0.0, 0.0, np.inf], self.found.alpha])[label]
        return np.asarray(a[:, 0] * self.tan_x[row, column] + a[:, 1] * self.tan_y[row, column] + a[:, 2])

    def points(self) -> Points:
        """Points of the planes, which count from 0."""
        labels = self.labels.ravel()
        chosen, shares = thin(self.sizes[1:])
        passed = np.cumsum(self.sizes) - self.sizes - self.sizes[0]
        places = np.empty(len(chosen), np.intp)
        find_places(labels, chosen, np.searchsorted(chosen, passed), passed, places)
        row, column = np.divmod(places, self.labels.shape[1])
        label = labels[places]
        q = self.inverse_depth(label, row, column)
        rays = np.column_stack([self.tan_x[row, column], self.tan_y[row, column], np.ones(len(row))])
        with np.errstate(divide="ignore"):
            points = Points(rays / q[:, None], label - 1, shares, np.zeros(len(label), np.intp))
        return points.some(np.flatnonzero(q > 0.0))


@lru_cache(maxsize=8)
def _bounds(camera: Camera) -> tuple[tuple[float, float], ...]:
    """Least and largest tanθx and tanθy of an image's rays, and a little beyond."""
    ends = [(float(np.nanmin(tangent)), float(np.nanmax(tangent))) for tangent in ray_tables(camera)]
    return tuple((low - 0.05 * (high - low), high + 0.05 * (high - low)) for low, high in ends)


def _is_near_rays(camera: Camera, xyz: Floats) -> NDArray[np.bool_]:
    """Whether points may be in the image: those that are not may be counted, too."""
    x, y, z = xyz.T
    is_near = z > 0.0
    for along, (low, high) in zip((x, y), _bounds(camera), strict=True):
        is_near &= (along >= low * z) & (along <= high * z)
    return np.asarray(is_near)


class Matches(NamedTuple):
    """Pairs of a known plane and one in sight that are the same.

    Attributes
    ----------
    before, now : (M,) intp
        The planes, counted from 0.
    shared : (M,) float64
        The squares that they share.
    share : float
        Of all squares where points of known planes are in sight, and some plane is seen.
    """

    before: Indices
    now: Indices
    shared: Floats
    share: float


def recognise(known: KnownPlanes, view: View, motion: Motion | None = None) -> tuple[KnownPlanes, Matches]:
    """The known planes as the camera sees them now, and which of them are in sight; planes tell a motion not given."""
    moved = known.moved(motion_since(known, view) if motion is None else motion)
    matches = same_planes(moved, view, close=HARDLY_MOVED)
    if motion is None:
        # Few planes, or such as noise bends, tell a motion that may be none: what is seen again says which.
        still = same_planes(known, view, close=HARDLY_MOVED)
        if still.share > matches.share:
            moved, matches = known, still
    if matches.share >= FAMILIAR:
        return moved, matches
    stayed = known if motion is None else moved
    return stayed, same_planes(stayed, view, HARDLY_TURNED, HARDLY_MOVED, HARDLY_MOVED)


def motion_since(known: KnownPlanes, view: View) -> Motion:
    """How the camera has moved since it saw the planes that are known, from the largest of those in sight again."""
    largest, motion = known.largest(), Motion()
    for _ in range(ROUNDS):
        before, now, shared, _ = same_planes(largest.moved(motion), view)
        if not len(before):
            break
        last, motion = motion, camera_motion(largest.planes[before], view.found.planes[now], shared)
        if motion.is_near(last):
            break
    return motion


def same_planes(
    known: KnownPlanes, view: View, turned: float = TURNED, moved: float = MOVED, close: float = np.inf
) -> Matches:
    """Known planes that are in sight, turned by so many degrees at most, and moved by such a share: see MOVED.

    Where several might be, one that moved by less than the share ``close`` rather than by more.
    """
    from scipy.optimize import linear_sum_assignment

    found, labels = view.found, view.labels
    count = len(found) + 1
    row, column, inside = view.squares_of(known.points.xyz)
    seen = np.flatnonzero(inside & (labels[row, column] > 0))
    row, column, squares_of = row[seen], column[seen], known.points.squares[seen]
    pairs = known.points.of[seen] * count + labels[row, column]

    def sums(values: Floats | float) -> Floats:
        totals = np.bincount(pairs, values * squares_of, len(known.ids) * count)
        return np.asarray(totals.reshape(-1, count)[:, 1:])

    shared = sums(1.0)
    rows, columns = np.nonzero(shared)
    old, squares = known.planes[rows], shared[rows, columns]
    angle, offset = angle_and_offset(found.planes[columns], old)
    # For a plane seen at a slant, a small turn changes the distance a lot, and 1/Z where it is hardly; for one that
    # the camera turns away from it is the other way round.
    x, y = (sums(tangent[row, column])[rows, columns] / squares for tangent in (view.tan_x, view.tan_y))
    before, now = (a[:, 0] * x + a[:, 1] * y + a[:, 2] for a in (-old[:, :3] / old[:, 3:], found.alpha[columns]))
    change = np.abs(now - before)
    near = (np.abs(offset) <= moved * np.abs(old[:, 3])) | (change <= moved * before)
    size = np.bincount(known.points.of, known.points.squares, len(known.ids))
    smaller = np.minimum(size[rows], view.sizes[1:][columns])
    same = (squares >= SHARED * smaller) & (angle <= turned) & near
    # Planes in sight take precedence over those that were covered, and those known for long over new ones.
    weight = squares / (1.0 + known.missed[rows]) * np.sqrt(np.minimum(known.seen[rows], LONG))
    weight /= 1.0 + (change / np.maximum(close * before, 1e-12)) ** 2
    table = np.zeros(shared.shape)
    table[rows, columns] = np.where(same, weight, 0.0)
    first, second = linear_sum_assignment(table, maximize=True)
    chosen = np.flatnonzero(table[first, second] > 0.0)
    first, second = first[chosen], second[chosen]
    pair_squares = shared[first, second]
    return Matches(first, second, pair_squares, float(pair_squares.sum() / max(shared.sum(), 1.0)))


def remember(known: KnownPlanes, view: View, ids: NDArray[np.int32], memory: int) -> KnownPlanes:
    """What is known after a frame: the planes in it, whose ids are given, and for a while what is out of sight."""
    points = view.points()
    there = np.flatnonzero(np.bincount(points.of, minlength=len(ids)))
    is_lost = ~np.isin(known.ids, ids) & (known.missed < memory)
    lost = np.flatnonzero(is_lost)
    every = np.sort(np.concatenate([ids[there], known.ids[lost]]))
    # Where planes stand among all, those in the frame and those known before, and the labels of these in the frame.
    place, place_before = np.searchsorted(every, ids), np.searchsorted(every, known.ids)
    _, again, now = np.intersect1d(known.ids, ids[there], assume_unique=True, return_indices=True)
    label = np.zeros(len(known.ids), np.intp)
    label[again] = there[now] + 1
    planes, (seen, missed) = np.empty((len(every), 4)), np.zeros((2, len(every)), np.intp)
    planes[place[there]] = view.found.planes[there]
    planes[place_before[lost]] = known.planes[lost]
    for chosen_ids in (again, lost):
        seen[place_before[chosen_ids]] = known.seen[chosen_ids]
    seen[place[there]] += 1
    missed[place_before[lost]] = known.missed[lost] + 1
    old = known.points
    hidden = old.some(np.flatnonzero((label[old.of] > 0) & (old.unseen < memory)))
    hidden = hidden.some(np.flatnonzero(_is_hidden(hidden, label[hidden.of], view)))
    chosen, shares = thin(np.bincount(hidden.of, minlength=len(known.ids)))
    hidden = hidden.some(chosen)
    hidden = hidden._replace(squares=hidden.squares * shares, unseen=hidden.unseen + 1)
    out_of_sight = old.some(np.flatnonzero(is_lost[old.of]))
    parts = points.renumbered(place), hidden.renumbered(place_before), out_of_sight.renumbered(place_before)
    together = Points(*(np.concatenate(values) for values in zip(*parts, strict=True)))
    return KnownPlanes(every, planes, seen, missed, together.some(np.argsort(together.of, kind="stable")))


def _is_hidden(points: Points, label: Indices, view: View) -> NDArray[np.bool_]:
    """Which points of planes with these labels are out of sight: something is before them, or they left the image."""
    row, column, inside = view.squares_of(points.xyz)
    there = view.labels[row, column]
    is_nearer = view.inverse_depth(there, row, column) * points.xyz[:, 2] > NEARER
    return np.asarray(~inside | ((there != label) & is_nearer))
