"""The camera: where its pixels look, through a lens or a pinhole, and how its depth is to be read."""

from __future__ import annotations

import functools
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import check_bool, check_choice, check_whole, number, numbers, real_array
from rgbd_planes._core.files import naming, write_beside
from rgbd_planes._core.lazy_property import kept
from rgbd_planes._core.text import counted, percent
from rgbd_planes._core.user_warnings import collected_warnings, warn_caller
from rgbd_planes.camera.calibrations import files, formats, systems
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.intrinsics_warnings import warn_of_intrinsics
from rgbd_planes.camera.lenses import distortion
from rgbd_planes.camera.lenses.ray_table import RayTable, filled, tables_of
from rgbd_planes.noise.model import NoiseModel, check_not_a_maker

Tables = tuple[Floats, Floats, NDArray[np.bool_] | None]


class OfDepth(TypedDict, total=False):
    """What other systems' calibrations don't say: parameters of `Camera`."""

    depth_scale: float | None
    disparity: tuple[float, float] | None
    depth_range: tuple[float, float] | None
    invalid_values: Sequence[float]
    noise: NoiseModel | None


_PIXELS = "whole number of pixels"
_SQUEEZED = 0.02  # share by which the two scales of a resized image may differ, besides rounding
_SELDOM = "noise", "rays", "is_part"  # keys of a camera's file that most lack
FLIPS = ("horizontal", "vertical")
_SHORTEST = 1e-2  # pixels: of nearer to 0 a single one would see nearly everything, and sums have no digits
_LARGEST = 1e8  # pixels: far beyond any camera; with tangents of larger numbers sums lose all digits


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with lens distortion, or a fisheye, and the contract of its depth frames.

    Axes x right, y down, z forward; pixel centres at integers.

    Parameters
    ----------
    width, height : int
        Size of a frame in pixels.
    fx, fy : float
        Focal lengths in pixels, not zero; `fy` (or `fx`) may be negative.
    cx, cy : float
        Principal point in pixels; may lie outside an image that is part of another, which `cropped` makes a camera of.
    distortion : sequence of 0, 4, 5 or 8 floats
        k1 k2 p1 p2 [k3 [k4 k5 k6]], OpenCV's order. Those left out are zero; of 0, 5 and 8 as many are kept as are
        needed. For a fisheye lens k1 k2 k3 k4.
    distortion_model : {"brown_conrady", "inverse_brown_conrady", "fisheye"}
        What the coefficients do: OpenCV's model maps the ray to the image, RealSense's inverse (five coefficients) maps
        the image to the ray. The fisheye is that of `cv2.fisheye`, ROS's equidistant and Kannala-Brandt: it bends rays
        even if all coefficients are zero. Pixels that see 85 degrees from the optical axis or more, as in the corners
        of a circular image, are missing in every frame. So are pixels beyond a fold of any other lens.
    depth_scale : float, optional
        Raw units per metre of integer frames (1000: millimetres).
    disparity : (scale, offset), optional
        For disparity images: 1/Z = scale * raw + offset, in 1/m. Either this or `depth_scale`, not both.
    depth_range : (nearest, farthest), optional
        Depths in metres that are measurements, both limits included, rounded as the values of a frame of floats are;
        infinity for no farthest.
    invalid_values : sequence of float
        Raw values that mean "no measurement", besides 0, negative, NaN and infinite depths.
    noise : NoiseModel, optional
        The sensor's noise, from `rgbd_planes.noise` or `rgbd_planes.estimate_noise`.
    rays : RayTable, optional
        The ray of each pixel, instead of a lens: `Camera.from_rays` makes such cameras. The focal lengths and the
        principal point are then those of a pinhole that is like it near the axis.
    is_part : bool
        Whether the images are parts of larger ones, as `cropped` says: their principal point may lie anywhere.

    Raises
    ------
    TypeError, ValueError
        For an invalid value, saying what was expected and what came.

    Warns
    -----
    UserWarning
        The intrinsics are most likely in other units or order, or of another image size. The image reaches farther
        than 75 degrees from the optical axis, and the lens is no fisheye. Or the principal point is farther from the
        middle than 12 % of the image's side. Or fx is 1.5 times fy, or the other way round.
    UserWarning
        When rays are first asked for: the lens model folds in the corners, whose pixels are missing in every frame.

    Notes
    -----
    The tables hold tanθx = (x + δx - cx) / fx and tanθy = (y + δy - cy) / fy of the paper's eq. 10 (Papadakis and
    Willis 2017), δ being the correction of the lens distortion.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Sequence[float] = ()  # kept as a tuple
    distortion_model: str = "brown_conrady"
    depth_scale: float | None = None
    disparity: tuple[float, float] | None = None
    depth_range: tuple[float, float] | None = None
    invalid_values: Sequence[float] = ()  # kept as a tuple
    noise: NoiseModel | None = None
    rays: RayTable | None = None
    is_part: bool = field(default=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            self._set(name, check_whole(name, getattr(self, name), 1, _PIXELS, bits=31))
        for name in ("fx", "fy", "cx", "cy"):
            self._set(name, number(name, getattr(self, name)))
        for name, least in (("fx", _SHORTEST), ("fy", _SHORTEST), ("cx", 0.0), ("cy", 0.0)):
            value = getattr(self, name)
            if least and value == 0:
                raise ValueError(f"expected {name} in pixels, not 0, got {value!r}")
            if not least <= abs(value) <= _LARGEST:
                raise ValueError(f"expected {name} in pixels, {least:g} to {_LARGEST:g} or minus that, got {value!r}")
        coefficients = numbers("distortion", self.distortion)
        self._set("distortion", distortion.checked(coefficients, self.distortion_model))
        self._set("is_part", check_bool("is_part", self.is_part))
        self._check_rays()
        invalid = numbers("invalid_values", self.invalid_values, finite=False)
        # The others are never measurements; NaN would make a camera differ from its own copy.
        self._set("invalid_values", tuple(value for value in invalid if math.isfinite(value)))
        check_not_a_maker(self.noise)
        if self.noise is not None and not isinstance(self.noise, NoiseModel):
            raise TypeError(f"expected noise as a NoiseModel or None, got {type(self.noise).__name__}")
        self._check_depth()
        if self.rays is None and not self.is_part:
            warn_of_intrinsics(self)

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _check_rays(self) -> None:
        if self.rays is None:
            return
        if not isinstance(self.rays, RayTable):
            raise TypeError(
                f"expected rays as a RayTable, which Camera.from_rays makes, got {type(self.rays).__name__}"
            )
        if self.distortion or self.distortion_model != "brown_conrady":
            raise ValueError("expected rays or a lens distortion, got both")
        if self.rays.shape != self.shape:
            raise ValueError(f"expected rays of shape (height, width) = {self.shape}, got {self.rays.shape}")

    def _check_depth(self) -> None:
        if self.depth_scale is not None:
            self._set("depth_scale", number("depth_scale", self.depth_scale))
            if not self.depth_scale > 0:
                raise ValueError(f"expected depth_scale > 0 (raw units per metre), got {self.depth_scale!r}")
            if self.depth_scale < 1:
                raise ValueError(
                    "expected depth_scale in raw units per metre, 1000 for millimetres, got "
                    f"{self.depth_scale!r}: if these are metres per unit, {1 / self.depth_scale:g} is meant"
                )
        if self.disparity is not None:
            if self.depth_scale is not None:
                raise ValueError(
                    f"expected depth_scale or disparity, got both: depth_scale={self.depth_scale!r}, "
                    f"disparity={self.disparity!r}; dataclasses.replace keeps what is not given: "
                    "replace(camera, depth_scale=None, disparity=...)"
                )
            pair = numbers("disparity", self.disparity)
            if len(pair) != 2 or pair[0] == 0:
                raise ValueError(f"expected disparity as (scale, offset), scale not 0, got {self.disparity!r}")
            self._set("disparity", pair)
        if self.depth_range is not None:
            pair = numbers("depth_range", self.depth_range, finite=False)
            if len(pair) != 2 or not 0 <= pair[0] < pair[1]:
                raise ValueError(
                    f"expected depth_range as (nearest, farthest) in metres, 0 <= nearest < farthest, "
                    f"got {self.depth_range!r}"
                )
            self._set("depth_range", pair)

    def __getstate__(self) -> dict[str, Any]:
        # Without the tables: they are quickly made again, and a copy of them would come back writable.
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def _with(self, **changes: Any) -> Self:
        """A copy with changes; of doubtful intrinsics whoever stated them has been warned."""
        with collected_warnings([]):
            made = replace(self, **changes)
        if self.__dict__.get("_has_told_of_folds"):
            made.__dict__["_has_told_of_folds"] = True
        return made

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of a frame."""
        return self.height, self.width

    @property
    def is_distorted(self) -> bool:
        """Whether the lens bends anything; if not, tan_x depends on the column only, and tan_y on the row only."""
        return bool(self.distortion) or self.rays is not None

    @property
    def tan_x_columns(self) -> Floats:
        """(W,) float64: (x - cx) / fx of each column. It is tan_x itself unless the camera `is_distorted`."""
        return _read_only((np.arange(float(self.width)) - self.cx) / self.fx)

    @property
    def tan_y_rows(self) -> Floats:
        """(H,) float64: (y - cy) / fy of each row. It is tan_y itself unless the camera `is_distorted`."""
        return _read_only((np.arange(float(self.height)) - self.cy) / self.fy)

    @property
    def _rays(self) -> tuple[Floats, Floats]:
        """tanθx and tanθy, (1, W) and (H, 1), or both (H, W) where the camera `is_distorted`."""
        if self.is_distorted:
            return self.tan_x, self.tan_y
        return self.tan_x_columns[None], self.tan_y_rows[:, None]

    @property
    def tan_x(self) -> Floats:
        """(H, W) float64, C-contiguous, read-only: tanθx of each pixel's ray (tan_x, tan_y, 1).

        A pixel without a ray has that of the nearest pixel with one. A fisheye's has one at the border of its view.

        Raises
        ------
        ValueError
            The distortion cannot be inverted in half of the image or more; for a fisheye, in nearly all of it.
        """
        return self._tables[0]

    @property
    def tan_y(self) -> Floats:
        """(H, W) float64, C-contiguous, read-only: tanθy of each pixel's ray (tan_x, tan_y, 1)."""
        return self._tables[1]

    @property
    def _without_ray(self) -> NDArray[np.bool_] | None:
        """(H, W) bool: the pixels that have no ray; None where all have."""
        # Asked of every frame: an ordinary camera may never need its tables.
        return self._tables[2] if self.is_distorted else None

    @property
    @kept
    def _lens(self) -> Self:
        """The camera without its depth: what depends on the lens alone is kept for all cameras that have it."""
        lens = self._with(
            depth_scale=None, disparity=None, depth_range=None, invalid_values=(), noise=None, is_part=False
        )
        lens.__dict__["_has_told_of_folds"] = True  # the camera itself does
        return lens

    @property
    @kept
    def _tables(self) -> Tables:
        if self.rays is not None:
            return tables_of(self.rays)
        if self.is_distorted:
            tables = _through_lens(self._lens)
            if tables[2] is not None and self.distortion_model != "fisheye":
                self._warn_of_folds(int(np.count_nonzero(tables[2])))
            return tables
        image_x, image_y = self._flat_tables
        return _read_only(image_x), _read_only(image_y), None

    def _warn_of_folds(self, count: int) -> None:
        if self.__dict__.setdefault("_has_told_of_folds", False):
            return
        self.__dict__["_has_told_of_folds"] = True
        share = percent(count / (self.width * self.height))
        warn_caller(
            f"{counted(count, 'pixel')} of {self.width} x {self.height} ({share}) have no single ray, most likely in "
            f"the corners, and are missing in every frame: the lens model folds there; distortion="
            f"{list(self.distortion)} ({self.distortion_model}). Is their order k1 k2 p1 p2 k3, and are fx and fy "
            "those of images of this size?"
        )

    @property
    def _flat_tables(self) -> tuple[Floats, Floats]:
        """`tan_x` and `tan_y` as they were if the lens bent nothing."""
        image_x = np.tile(self.tan_x_columns, (self.height, 1))
        return image_x, np.repeat(self.tan_y_rows[:, None], self.width, axis=1)

    def points(self, depth: ArrayLike) -> Floats:
        """Reconstruct the point cloud of a depth frame: X = Z tanθx, Y = Z tanθy, Z (the paper's eq. 11).

        Parameters
        ----------
        depth : (H, W) array_like
            The frame: floats in metres, or integers in the camera's ``depth_scale``; disparities of a camera that has
            ``disparity``.

        Returns
        -------
        (H, W, 3) ndarray of float64
            X, Y, Z in metres in the camera's frame, NaN where the depth is missing.

        Raises
        ------
        TypeError, ValueError
            The frame is not an array of the camera's size, or holds integers without a unit.
        """
        z = as_depth_frame(depth, self).metres
        return np.stack([z * self.tan_x, z * self.tan_y, z], axis=-1)

    def project(self, points: ArrayLike) -> Floats:
        """Project points into the image.

        Parameters
        ----------
        points : (..., 3) array_like of float
            X, Y, Z in metres in the camera's frame.

        Returns
        -------
        (..., 2) ndarray of float64
            Column x and row y in pixels. A point behind the camera is NaN, as is one whose ray the distortion gives no
            image. So are points that are not finite, or whose image is not. With given rays, all is NaN outside the
            image.

        Raises
        ------
        TypeError, ValueError
            The points are masked, not numbers, or of another shape.
        """
        array = real_array("points", points)
        if array.ndim == 0 or array.shape[-1] != 3:
            raise ValueError(f"expected points of shape (..., 3), got {array.shape}")
        coordinates = np.moveaxis(array, -1, 0)
        z = np.where(coordinates[2] > 0, coordinates[2], np.nan)
        with np.errstate(over="ignore", invalid="ignore"):  # very near the camera's plane, and at infinity
            x, y = coordinates[0] / z, coordinates[1] / z
            if self.rays is not None:
                x, y = self.rays.image_of(x, y)
            else:
                if self.is_distorted:
                    x, y = distortion.image_of_rays(x, y, self.distortion, self.distortion_model)
                x, y = x * self.fx + self.cx, y * self.fy + self.cy
        finite = np.logical_and.reduce([np.isfinite(each) for each in (*coordinates, x, y)])
        return np.stack([np.where(finite, x, np.nan), np.where(finite, y, np.nan)], axis=-1)

    def resized(self, width: int, height: int, *, stretched: bool = False) -> Self:
        """The camera of resized images, whose pixels look through the middle of those that they stand for.

        Parameters
        ----------
        width, height : int
            Size of a resized frame in pixels.
        stretched : bool
            Whether frames were squeezed or stretched to another shape on purpose: then there is no warning of it.

        Returns
        -------
        Camera
            Without a noise model: that of resized frames depends on how they were resized, and
            `rgbd_planes.estimate_noise` finds it.

        Raises
        ------
        TypeError, ValueError
            The size is no size of a camera.

        Warns
        -----
        UserWarning
            The size has another shape than the image: most likely frames were cropped to it first.

        Notes
        -----
        ``frame[::n, ::n]``, and other ways that take one pixel of many, keep the centres of these pixels: the principal
        point is (cx / n, cy / n) then. Other modes of a sensor may show another part of the scene.
        """
        x = check_whole("width", width, 1, _PIXELS) / self.width
        y = check_whole("height", height, 1, _PIXELS) / self.height
        if not check_bool("stretched", stretched) and abs(x / y - 1.0) > max(_SQUEEZED, 1.0 / min(width, height)):
            warn_caller(self._cropped_before(width, height))
        cx, cy = x * (self.cx + 0.5) - 0.5, y * (self.cy + 0.5) - 0.5
        rays = None if self.rays is None else self.rays.resized(height, width)
        changes = {"width": width, "height": height, "fx": x * self.fx, "fy": y * self.fy, "cx": cx, "cy": cy}
        return self._with(**changes, rays=rays, noise=None)

    def _cropped_before(self, width: int, height: int) -> str:
        scale = max(width / self.width, height / self.height)
        part = min(round(width / scale), self.width), min(round(height / scale), self.height)
        left, top = (self.width - part[0]) // 2, (self.height - part[1]) // 2
        return (
            f"resized({width}, {height}) of {self.width} x {self.height} changes the shape: fx and fy become "
            f"{width / self.width:.3g} and {height / self.height:.3g} times as large. If frames were cropped to it, as "
            f"by half of what is too much on each side, camera.cropped({left}, {top}, {part[0]}, {part[1]})"
            f".resized({width}, {height}) is right; if they were squeezed, resized({width}, {height}, stretched=True)"
        )

    def rotated(self, degrees: int) -> Self:
        """The camera of images turned counter-clockwise, as ``numpy.rot90(frame, degrees // 90)`` turns them.

        Axes turn with the image: x is to the right and y down in the turned one. For a sensor that is mounted upside
        down, turn its frames by 180 degrees: then y points down again.

        Parameters
        ----------
        degrees : {0, 90, 180, 270}
            270 counter-clockwise are 90 clockwise.

        Returns
        -------
        Camera
            Exact, whatever the lens. A point (X, Y, Z) becomes (Y, -X, Z) by 90 degrees, (-X, -Y, Z) by 180 and
            (-Y, X, Z) by 270.

        Raises
        ------
        TypeError, ValueError
            The angle is none of these.
        """
        quarters = quarter_turns(degrees)
        if quarters == 0:
            return self
        right, bottom = self.width - 1 - self.cx, self.height - 1 - self.cy
        cx, cy = ((self.cy, right), (right, bottom), (bottom, self.cx))[quarters - 1]
        changes: dict[str, Any] = {"cx": cx, "cy": cy}
        if quarters != 2:
            changes |= {"width": self.height, "height": self.width, "fx": self.fy, "fy": self.fx}
        if self.rays is not None:
            changes["rays"] = self.rays.turned(quarters)
        elif self.distortion and self.distortion_model != "fisheye":
            # The tangential part is 2 (p·x) x + r² p for p = (p2, p1), which turns as any vector does.
            k1, k2, p1, p2, *others = self.distortion
            tangential = ((-p2, p1), (-p1, -p2), (p2, -p1))[quarters - 1]
            changes["distortion"] = (k1, k2, *tangential, *others)
        return self._with(**changes)

    def flipped(self, direction: str) -> Self:
        """The camera of mirrored images, as ``numpy.fliplr(frame)``, or ``numpy.flipud(frame)``, makes them.

        Each pixel keeps its ray: points, planes and normals stay those of the real scene, not of its mirror image. So
        fx, or fy, becomes negative.

        Parameters
        ----------
        direction : {"horizontal", "vertical"}
            Whether left and right, or top and bottom, have changed places.

        Returns
        -------
        Camera
            Exact, whatever the lens.

        Raises
        ------
        ValueError
            The direction is neither.
        """
        check_choice("direction", direction, FLIPS)
        if direction == "horizontal":
            changes: dict[str, Any] = {"fx": -self.fx, "cx": self.width - 1 - self.cx}
        else:
            changes = {"fy": -self.fy, "cy": self.height - 1 - self.cy}
        if self.rays is not None:
            changes["rays"] = self.rays.mirrored(1 if direction == "horizontal" else 0)
        return self._with(**changes)

    def with_noise(self, noise: NoiseModel | None) -> Self:
        """The same camera with a noise model, such as `rgbd_planes.estimate_noise` returns, or without one.

        Lengths of a model, those of its ``correlation``, ``floor_length`` and ``lateral``, are in pixels. For frames of
        another resolution than those that it was estimated from, estimate it again.

        Raises
        ------
        TypeError
            It is neither a `NoiseModel` nor None.
        """
        return self._with(noise=noise)

    def cropped(self, left: int, top: int, width: int, height: int) -> Self:
        """The camera of a part of the image, ``frame[top : top + height, left : left + width]``.

        Parameters
        ----------
        left, top : int
            Column and row of its first pixel.
        width, height : int
            Its size in pixels.

        Returns
        -------
        Camera
            With the same rays and noise in each pixel.

        Raises
        ------
        TypeError, ValueError
            The part is not inside the image.
        """
        for first, size, whole, names in (
            (left, width, self.width, ("left", "width")),
            (top, height, self.height, ("top", "height")),
        ):
            if check_whole(names[0], first, 0, _PIXELS) + check_whole(names[1], size, 1, _PIXELS) > whole:
                raise ValueError(
                    f"expected a part of the image, of {names[1]} {whole}, got {names[0]} {first} and {names[1]} {size}"
                )
        inside = slice(top, top + height), slice(left, left + width)
        rays = None if self.rays is None else self.rays.part(*inside)
        changes = {"width": width, "height": height, "cx": self.cx - left, "cy": self.cy - top}
        return self._with(**changes, rays=rays, is_part=self.is_part or (width, height) != (self.width, self.height))

    def to_dict(self) -> dict[str, Any]:
        """The camera as a dict that JSON can hold, with "noise" if there is a model, and "rays" if they are given.

        Raises
        ------
        ValueError
            The noise model is a function.
        """
        made: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in _SELDOM}
        if self.is_part:
            made["is_part"] = True
        if self.rays is not None:
            made["rays"] = self.rays.to_dict()
        if self.noise is not None:
            made["noise"] = self.noise.to_dict()
        made["distortion"] = list(self.distortion)
        made["invalid_values"] = [int(v) if v.is_integer() else v for v in self.invalid_values]
        if self.disparity is not None:
            made["disparity"] = {"scale": self.disparity[0], "offset": self.disparity[1]}
        if self.depth_range is not None:
            made["depth_range"] = [depth if math.isfinite(depth) else None for depth in self.depth_range]
        return made

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Make a camera from the keys of `to_dict`: the six of the pinhole are required, the others are not.

        Raises
        ------
        TypeError, ValueError
            Naming the keys that are unknown or missing, or the invalid value.

        Warns
        -----
        UserWarning
            The intrinsics are most likely not meant as they are: `Camera` lists how.
        """
        if not isinstance(values, Mapping):
            raise TypeError(f"expected a mapping of camera keys, got {type(values).__name__}")
        known = [f.name for f in fields(cls)]
        unknown = sorted(str(k) for k in values if k not in known)
        if unknown:
            raise ValueError(
                f"expected the camera keys {', '.join(known)}, got also {', '.join(unknown)}{formats.hint(values)}"
            )
        missing = [name for name in known[:6] if name not in values]
        if missing:
            raise ValueError(f"expected the camera keys {', '.join(known[:6])}; missing: {', '.join(missing)}")
        made = dict(values)
        if isinstance(made.get("noise"), Mapping):
            made["noise"] = NoiseModel.from_dict(made["noise"])
        if isinstance(made.get("rays"), Mapping):
            made["rays"] = RayTable.from_dict(made["rays"])
        disparity = made.get("disparity")
        if isinstance(disparity, Mapping):
            if set(disparity) != {"scale", "offset"}:
                raise ValueError(
                    f"expected disparity with the keys scale, offset, got {', '.join(map(str, disparity))}"
                )
            made["disparity"] = (disparity["scale"], disparity["offset"])
        depth_range = made.get("depth_range")
        if isinstance(depth_range, Sequence) and [depth is None for depth in depth_range] == [False, True]:
            made["depth_range"] = (depth_range[0], math.inf)  # which JSON has no number for
        return cls(**made)

    @classmethod
    def load(cls, path: str | os.PathLike[str], name: str | None = None, **depth: Unpack[OfDepth]) -> Self:
        """Read a camera from a file of `save`, or from a calibration of another tool, recognised by its contents.

        Parameters
        ----------
        path : path
            - JSON with the keys of `to_dict`
            - YAML, XML or JSON of ``cv2.FileStorage``
            - YAML of ROS, Kalibr, ORB-SLAM or VINS
            - JSON of Open3D, RealSense, nerfstudio (transforms.json), Record3D or Polycam
            - COLMAP's cameras.txt, the info.txt of BundleFusion and ScanNet, ARKitScenes' .pincam
        name : str, optional
            Which camera, if the file has several: "cam1" of Kalibr, "2" of COLMAP.
        **depth
            `depth_scale`, `disparity`, `depth_range`, `invalid_values`, `noise` of the camera, which most of these
            files leave out, instead of what the file says.

        Raises
        ------
        OSError, ValueError, TypeError
            Naming the file.

        Warns
        -----
        UserWarning
            The intrinsics are most likely not meant as they are: `Camera` lists how.
        """
        values = files.read_calibration(path, name)
        with naming(path):
            return cls.from_dict({**values, **depth})

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the camera to a JSON file; the file appears whole or not at all.

        Raises
        ------
        ValueError
            The noise model is a function, or the path has the suffix of another format.
        OSError
            It cannot be written there.
        """
        with write_beside(path, ".json") as beside:
            beside.write_text(json.dumps(self.to_dict(), indent=2) + "\n", encoding="utf-8")

    @classmethod
    def from_rays(cls, tan_x: ArrayLike, tan_y: ArrayLike, **depth: Unpack[OfDepth]) -> Self:
        """Make a camera whose pixels look where two tables say: of a scanner, a mosaic, or a lens of another model.

        Parameters
        ----------
        tan_x, tan_y : (H, W) array_like of float
            X / Z and Y / Z of each pixel's ray, at least 2 x 2; NaN for a pixel without a ray, which is missing in
            every frame.
        **depth
            `depth_scale`, `disparity`, `depth_range`, `invalid_values`, `noise` of the camera.

        Returns
        -------
        Camera
            With the fx, fy, cx and cy of a pinhole that is like it near the axis. `save` keeps the tables to the bit.

        Raises
        ------
        TypeError, ValueError
            They are no tables of one shape, or hardly any ray is within 85 degrees of the axis.

        Notes
        -----
        Depth is Z, along the axis; a scanner's distances are divided by ``numpy.sqrt(1 + tan_x**2 + tan_y**2)`` first.
        Rays of 85 degrees from the axis or more, and behind, are missing. So a scan all around takes several cameras,
        each with a part of the columns and an axis of its own. Neighbouring pixels should look at neighbouring places,
        since planes are found from pixels that touch. `project` interpolates between the rays, and `resized` takes its
        rays from there.

        Examples
        --------
        A quarter of a spherical scan, azimuth and elevation in radians, (W,) and (H,):

        >>> ahead = np.abs(azimuth) < np.pi / 4
        >>> tan_x = np.broadcast_to(np.tan(azimuth[ahead]), (len(elevation), ahead.sum()))
        >>> tan_y = -np.tan(elevation)[:, None] / np.cos(azimuth[ahead])
        >>> camera = rp.Camera.from_rays(tan_x, tan_y)
        >>> depth = distances[:, ahead] / np.sqrt(1 + tan_x**2 + tan_y**2)
        """
        rays = RayTable(tan_x, tan_y)
        height, width = rays.shape
        return cls(width, height, *rays.pinhole, rays=rays, **depth)

    @classmethod
    def from_opencv(
        cls,
        camera_matrix: ArrayLike,
        distortion: ArrayLike | None,
        size: tuple[int, int],
        *,
        distortion_model: str = "brown_conrady",
        pixel_center: float = 0.0,
        **depth: Unpack[OfDepth],
    ) -> Self:
        """Make a camera from OpenCV's calibration.

        Parameters
        ----------
        camera_matrix : (3, 3) array_like
            [[fx, 0, cx], [0, fy, cy], [0, 0, 1]].
        distortion : array_like of 0, 4, 5 or 8 numbers, or None
            k1 k2 p1 p2 k3 [k4 k5 k6] of `cv2.calibrateCamera`, of any shape. From the ninth on all must be 0.
        size : (width, height)
        distortion_model : {"brown_conrady", "fisheye"}
            "fisheye" for what `cv2.fisheye.calibrate` returns.
        pixel_center : float
            Where the calibration has the centre of the first pixel: 0 in OpenCV, 0.5 in COLMAP and OpenGL.
        **depth
            `depth_scale`, `disparity`, `depth_range`, `invalid_values`, `noise` of the camera.

        Raises
        ------
        TypeError, ValueError
            The matrix has a skew or is not a camera matrix, or there are coefficients of a thin prism or of a tilted
            sensor.
        """
        made = systems.from_opencv(camera_matrix, distortion, size, distortion_model, pixel_center)
        return cls(**made, **depth)

    @classmethod
    def from_ros(cls, info: Any, *, rectified: bool | None = None, **depth: Unpack[OfDepth]) -> Self:
        """Make a camera from a ROS 1 or 2 sensor_msgs/CameraInfo, or from the content of a ROS calibration file.

        Parameters
        ----------
        info : mapping or object
            With width, height, K, D, P (or k, d, p), distortion_model, binning_x, binning_y, roi. Or, as
            camera_calibration writes them to YAML, with image_width, image_height, camera_matrix,
            distortion_coefficients, projection_matrix, distortion_model.
        rectified : bool, optional
            Whether the depth image is rectified (P, no distortion) or raw (K and D). If not given, it is raw, unless K
            is 0, as some drivers of stereo cameras leave it.
        **depth
            `depth_scale`, `disparity`, `depth_range`, `invalid_values`, `noise` of the camera.

        Raises
        ------
        TypeError, ValueError
            Something required is missing or invalid. Or the distortion model is none of plumb_bob, rational_polynomial
            and equidistant, and has coefficients other than zero. A lens whose coefficients are all zero is a pinhole,
            unless it is equidistant, which bends rays even then.

        Notes
        -----
        The region of interest, in full-resolution pixels, is cut first, then binning divides it (REP 104).
        The principal point follows ROS's own image_geometry: (cx - x_offset) / binning_x. For a camera that
        averages blocks of pixels the exact value would be (binning_x - 1) / (2 binning_x) less.
        """
        is_rectified = None if rectified is None else check_bool("rectified", rectified)
        whole, part = systems.from_ros(info, is_rectified)
        made = cls(**whole, **depth)
        is_part = (part["width"], part["height"]) != made.shape[::-1]
        return made._with(**part, is_part=is_part)

    @classmethod
    def from_open3d(cls, source: Any, **depth: Unpack[OfDepth]) -> Self:
        """Make a camera from Open3D's PinholeCameraIntrinsic or PinholeCameraParameters, or from their JSON.

        Parameters
        ----------
        source : object, path or mapping
            With width, height and intrinsic_matrix; in JSON its nine numbers are column-major.
        **depth
            `depth_scale`, `disparity`, `depth_range`, `invalid_values`, `noise` of the camera.

        Raises
        ------
        OSError, TypeError, ValueError
            The file cannot be read, or something required is missing or invalid.
        """
        if not isinstance(source, str | os.PathLike):
            return cls(**systems.from_open3d(source), **depth)
        values = files.read_json(source)
        with naming(source):
            return cls(**systems.from_open3d(values), **depth)

    @classmethod
    def from_realsense(cls, intrinsics: Any, *, depth_units: float | None = None, **depth: Unpack[OfDepth]) -> Self:
        """Make a camera from the intrinsics of a RealSense stream.

        Parameters
        ----------
        intrinsics : pyrealsense2.intrinsics or mapping
            With width, height, ppx, ppy, fx, fy, model, coeffs.
        depth_units : float, optional
            Metres per raw unit, `depth_sensor.get_depth_scale()`: 0.001, on a D405 0.0001.
        **depth
            `depth_scale` instead of `depth_units`, `disparity`, `depth_range`, `invalid_values`, `noise`.

        Raises
        ------
        TypeError, ValueError
            Something required is missing or invalid; or the model is one that `Camera` does not have, with coefficients
            other than zero.

        Notes
        -----
        Inverse Brown-Conrady is taken as librealsense's header defines it: the polynomial undistorts. (The
        deprojection in newer releases of its rsutil.h inverts the polynomial instead, as for Brown-Conrady;
        for that, change `distortion_model`.) Depth streams have all coefficients zero: that is a pinhole, unless the
        model is Kannala-Brandt, which is the fisheye of `Camera`. Modified Brown-Conrady and F-theta with coefficients
        other than zero are an error.
        """
        made = systems.from_realsense(intrinsics, depth_units)
        depth_scale = depth.pop("depth_scale", None)
        if depth_scale is not None:
            if "depth_scale" in made:
                raise ValueError("expected depth_units or depth_scale, got both")
            made["depth_scale"] = depth_scale
        return cls(**{**made, **depth})


@functools.lru_cache(maxsize=2)
def _through_lens(camera: Camera) -> Tables:
    """The tables of a camera with distortion, which take a hundred times as long as others."""
    image_x, image_y = camera._flat_tables
    x, y = distortion.rays_of_image(image_x, image_y, camera.distortion, camera.distortion_model)
    without_ray = np.isnan(x)
    if not without_ray.any():
        return _read_only(x), _read_only(y), None
    # Finite ones, for sums over all pixels, from which missing ones are then subtracted, and for corners of
    # outlines.
    if camera.distortion_model == "fisheye":
        ratio = np.hypot(x, y)[~without_ray].max() / np.hypot(image_x, image_y)[without_ray]
        x[without_ray], y[without_ray] = image_x[without_ray] * ratio, image_y[without_ray] * ratio
    else:
        x, y = filled(x, y, without_ray)
    return _read_only(x), _read_only(y), without_ray


def quarter_turns(degrees: int) -> int:
    """The number of quarter turns counter-clockwise, 0 to 3, of an angle of so many degrees.

    Raises
    ------
    TypeError, ValueError
        The angle is none of 0, 90, 180, 270.
    """
    if isinstance(degrees, bool) or not isinstance(degrees, (int, float, np.integer, np.floating)):
        raise TypeError(f"expected degrees as 0, 90, 180 or 270, got {degrees!r}")
    if degrees not in (0, 90, 180, 270):
        raise ValueError(f"expected degrees, counter-clockwise, as 0, 90, 180 or 270, got {degrees!r}")
    return int(degrees) // 90


def _read_only(array: Floats) -> Floats:
    array.flags.writeable = False
    return array


_CAMERA_FROM = (
    (str, "load reads a file"),
    (os.PathLike, "load reads a file"),
    (Mapping, "from_dict takes one"),
    (np.ndarray, "from_opencv takes a matrix"),
)


def check_camera(camera: Any) -> None:
    """Raise TypeError unless it is a `Camera`."""

    if not isinstance(camera, Camera):
        reads = next((name for kind, name in _CAMERA_FROM if isinstance(camera, kind)), None)
        reason = "" if reads is None else f": Camera.{reads}"
        if isinstance(camera, np.ndarray) and max(camera.shape, default=0) > 4:
            reason = f" of shape {camera.shape}: is it the depth? The camera comes after it"
        raise TypeError(f"expected a Camera, got {type(camera).__name__}{reason}")
