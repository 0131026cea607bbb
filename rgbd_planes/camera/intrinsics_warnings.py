"""Warn of intrinsics that are possible, but most likely in other units, in another order, or of another image size."""

from __future__ import annotations

import math
from typing import Protocol

from rgbd_planes._core.user_warnings import warn_caller

_FARTHEST_BUT_FISHEYE = 75.0  # degrees from the optical axis; only fisheye lenses see farther
_OFF_CENTRE = 0.12  # of the image's side: those of sensors are up to 11 % off, as an Azure Kinect's narrow mode is
_FEW_PIXELS = 2.0  # in a small image these are a large share
_CENTRED = 0.03  # of the image's side: what would be a centre if numbers had another order
_ASPECT = 1.5  # of a pixel; range scanners and old video have up to 1.46
_BINNED = 1.9, 2.1  # where every other line is left out, or two are averaged, in one direction only
_SMALL = 100  # pixels: images with a shorter side are parts of others, or tests; only what is plainly doubled counts
_SCALES = 0.25, 0.5, 2.0, 4.0
_NEVERTHELESS = (
    "Camera.resized makes the camera of resized images, and Camera.cropped that of a part of them, without this warning"
)


class Intrinsics(Protocol):
    """A camera, as far as warnings of its intrinsics need it."""

    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...
    @property
    def distortion_model(self) -> str: ...


def warn_of_intrinsics(camera: Intrinsics) -> None:
    """Warn once of intrinsics that are most likely wrong, with the likeliest reason."""
    message = _too_wide(camera) or _wrong_order(camera) or _outside(camera) or _off_centre(camera) or _oblong(camera)
    if message:
        warn_caller(message)


def _sides(camera: Intrinsics) -> tuple[tuple[int, float, float, tuple[str, str, str]], ...]:
    return (
        (camera.width, camera.fx, camera.cx, ("fx", "cx", "width")),
        (camera.height, camera.fy, camera.cy, ("fy", "cy", "height")),
    )


def _too_wide(camera: Intrinsics) -> str:
    # A fisheye does see that far; if it sees hardly anything of the image, that is an error.
    farthest = 180.0 if camera.distortion_model == "fisheye" else _FARTHEST_BUT_FISHEYE
    for size, focal, centre, names in _sides(camera):
        angle = math.degrees(math.atan(max(abs(centre), abs(size - 1 - centre)) / abs(focal)))
        if angle > farthest:
            return (
                f"with {names[0]} = {focal:g} and {names[1]} = {centre:g}, an image of {names[2]} {size} reaches "
                f"{angle:.0f} degrees from the optical axis: are they in pixels, and of this image size?"
            )
    return ""


def _wrong_order(camera: Intrinsics) -> str:
    """The principal point is off the centre, and another order of the four numbers would put it there."""
    near = max(abs(camera.fx), abs(camera.cx)) < _ASPECT * min(abs(camera.fx), abs(camera.cx))
    if near and _is_off(camera.cx, camera.width, _OFF_CENTRE) and not _is_off(camera.fy, camera.width, _CENTRED):
        return (
            f"fy = {camera.fy:g} is the middle of an image of width {camera.width}, and cx = {camera.cx:g} is near "
            f"fx = {camera.fx:g}: are these in the order fx, cx, fy, cy? Camera takes fx, fy, cx, cy"
        )
    if not (_is_off(camera.cx, camera.width, _CENTRED) and _is_off(camera.cy, camera.height, _CENTRED)):
        return ""
    if min(camera.width, camera.height) < _SMALL:
        return ""
    if not (_is_off(camera.cy, camera.width, _CENTRED) or _is_off(camera.cx, camera.height, _CENTRED)):
        return (
            f"cx = {camera.cx:g} is near the middle of the image's height {camera.height}, and cy = {camera.cy:g} near "
            f"that of its width {camera.width}: are they swapped, or the intrinsics of an image turned by 90 degrees?"
        )
    return ""


def _outside(camera: Intrinsics) -> str:
    for size, _, centre, names in _sides(camera):
        if not -1.0 < centre < size:
            return (
                f"{names[1]} = {centre:g} lies outside an image of {names[2]} {size}: are these the intrinsics of "
                f"another image size? {_NEVERTHELESS}"
            )
    return ""


def _off_centre(camera: Intrinsics) -> str:
    if min(camera.width, camera.height) < _SMALL and not _is_scaled(camera):
        return ""
    for size, _, centre, names in _sides(camera):
        if _is_off(centre, size, _OFF_CENTRE):
            share = abs(centre - 0.5 * (size - 1)) / size
            return (
                f"{names[1]} = {centre:g} is {share:.0%} of the {names[2]} off the middle of an image of "
                f"{camera.width} x {camera.height}; that of sensors is within 11 %: are these the intrinsics of "
                f"another image size? That of {_size_of(camera)} has its middle there. {_NEVERTHELESS}"
            )
    return ""


def _is_scaled(camera: Intrinsics) -> bool:
    """Whether the principal point is the middle of an image that is twice, or four times, as large, or as small."""
    x, y = ((2.0 * centre + 1.0) / size for size, _, centre, _ in _sides(camera))
    return any(max(abs(x - scale), abs(y - scale)) < _CENTRED * scale for scale in _SCALES)


def _oblong(camera: Intrinsics) -> str:
    longer, shorter = max(abs(camera.fx), abs(camera.fy)), min(abs(camera.fx), abs(camera.fy))
    if longer <= _ASPECT * shorter or _BINNED[0] < longer / shorter < _BINNED[1]:
        return ""
    return (
        f"fx = {camera.fx:g} and fy = {camera.fy:g} differ by {longer / shorter:.2f} times, and pixels are nearly "
        "square: were the images cropped before they were resized? camera.cropped(...).resized(...) does both in turn"
    )


def _is_off(centre: float, size: int, share: float) -> bool:
    return abs(centre - 0.5 * (size - 1)) > max(share * size, _FEW_PIXELS)


def _size_of(camera: Intrinsics) -> str:
    """The image size whose middle is the principal point, in words."""
    return f"{2.0 * camera.cx + 1.0:.0f} x {2.0 * camera.cy + 1.0:.0f}"
