"""The models of lens distortion, and the way from image to rays and back by each."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes._core.checks import check_choice
from rgbd_planes.camera.lenses import brown_conrady, fisheye

_COUNTS = {"brown_conrady": (0, 4, 5, 8), "inverse_brown_conrady": (0, 5), "fisheye": (0, 4)}

MODELS = tuple(_COUNTS)

_LARGEST = 1e60  # products of a few coefficients are finite
_EXPECTED = "expected a lens distortion that can be inverted inside the image"
_STEPS = 32  # rows and columns of an image, at least, that are looked at before the others; every 16th of large ones
_LEAST_SEEN = 0.1  # share of a fisheye's pixels; with fewer the focal length is most likely in other units
_LEAST_UNFOLDED = 0.5  # share of an ordinary lens's pixels; with fewer the coefficients are most likely others


def checked(coefficients: tuple[float, ...], model: str) -> tuple[float, ...]:
    """Return the coefficients in a canonical form: none without distortion, equal ones for equal lenses.

    0, 5 or 8 for an ordinary lens, 4 for a fisheye, which bends rays even where all are zero.

    Raises
    ------
    ValueError
        There is no such model, or none with that many coefficients.
    """
    check_choice("distortion_model", model, MODELS)
    allowed = _COUNTS[model]
    if len(coefficients) not in allowed:
        names = "k1 k2 k3 k4" if model == "fisheye" else "k1 k2 p1 p2 k3 [k4 k5 k6]"
        raise ValueError(
            f"expected {', '.join(map(str, allowed))} distortion coefficients for {model} "
            f"({names}), got {len(coefficients)}: {coefficients}"
        )
    if max(map(abs, coefficients), default=0.0) > _LARGEST:
        raise ValueError(f"expected distortion coefficients of at most {_LARGEST:g}, got {coefficients}")
    if model == "fisheye":
        return coefficients or (0.0,) * 4
    padded = coefficients + (0.0,) * (8 - len(coefficients))
    return padded[: next(count for count in (0, 5, 8) if not any(padded[count:]))]


def rays_of_image(x: Floats, y: Floats, coefficients: Sequence[float], model: str) -> tuple[Floats, Floats]:
    """Rays (x, y, 1) of all pixels of an image.

    Parameters
    ----------
    x, y : (H, W) float64
        Normalised coordinates of the pixels, as if there were no distortion.
    coefficients : sequence of floats
        The model's coefficients, in OpenCV's order.
    model : str
        One of `MODELS`; the inverse one takes a pixel to its ray by `brown_conrady.distort`.

    Returns
    -------
    x, y : (H, W) float64
        NaN where there is no single ray: beyond a fold, or in the corners of a fisheye's circular image.

    Raises
    ------
    ValueError
        Half of the pixels or more have no ray, or several, saying where; for a fisheye, nearly all.
    """
    if model == "fisheye":
        ray_x, ray_y, one_to_one = fisheye.undistort(x, y, coefficients)
        if one_to_one.mean() >= _LEAST_SEEN:
            return ray_x, ray_y
        widest = np.degrees(fisheye.widest_angle(coefficients))
        row, column = np.argwhere(~one_to_one)[0]
        raise ValueError(
            f"{_EXPECTED}, got {np.count_nonzero(~one_to_one)} of {one_to_one.size} pixels, the first at row {row}, "
            f"column {column}, without a ray, which they have up to {widest:.4g} degrees from the optical axis; "
            f"distortion={coefficients} ({model})"
        )
    step = max(1, min(16, min(x.shape) // _STEPS))
    some = tuple(np.unique(np.append(np.arange(0, length, step), length - 1)) for length in x.shape)
    # Looking for a ray where there is none takes long: some pixels show how many have none.
    _, _, one_to_one = _single_rays(x[np.ix_(*some)], y[np.ix_(*some)], coefficients, model)
    if one_to_one.mean() <= _LEAST_UNFOLDED:
        row, column = (places[i] for places, i in zip(some, np.argwhere(~one_to_one)[0], strict=True))
        raise ValueError(
            f"{_EXPECTED}, got {1.0 - one_to_one.mean():.0%} of the pixels without a single ray, one of them at row "
            f"{row}, column {column}: the radial part folds at radius {brown_conrady.fold_radius(coefficients):.4g}; "
            f"distortion={coefficients} ({model}); is their order k1 k2 p1 p2 k3, and are fx and fy those of images of "
            "this size?"
        )
    ray_x, ray_y, one_to_one = _single_rays(x, y, coefficients, model)
    return np.where(one_to_one, ray_x, np.nan), np.where(one_to_one, ray_y, np.nan)


def _single_rays(
    x: Floats, y: Floats, coefficients: Sequence[float], model: str
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Rays of the pixels of an image, or of some of its rows and columns, and whether each has one alone."""
    if model == "inverse_brown_conrady":
        ray_x, ray_y = brown_conrady.distort(x, y, coefficients)
        one_to_one = np.isfinite(ray_x) & np.isfinite(ray_y)
        flat_x, flat_y = x, y
    else:
        ray_x, ray_y, one_to_one = brown_conrady.undistort(x, y, coefficients)
        flat_x, flat_y = ray_x, ray_y
    # The lines from the border to the optical axis sweep the whole image.
    for border in ((0, slice(None)), (-1, slice(None)), (slice(None), 0), (slice(None), -1)):
        one_to_one[border] &= brown_conrady.unfolded(flat_x[border], flat_y[border], coefficients)
    if not one_to_one.all():  # of which pixels, inside the image, is to be found out
        found = np.nonzero(one_to_one)
        one_to_one[found] &= brown_conrady.unfolded(flat_x[found], flat_y[found], coefficients)
    return ray_x, ray_y, one_to_one


def image_of_rays(x: Floats, y: Floats, coefficients: Sequence[float], model: str) -> tuple[Floats, Floats]:
    """Normalised coordinates of the places where rays (x, y, 1) meet the image; NaN where there is none.

    The inverse of `rays_of_image`, for arrays of any shape.
    """
    if model == "fisheye":
        return fisheye.distort(x, y, coefficients)
    if model == "inverse_brown_conrady":
        seen = np.isfinite(x) & np.isfinite(y)
        x, y, _ = brown_conrady.undistort(np.where(seen, x, 0.0), np.where(seen, y, 0.0), coefficients)
        return np.where(seen, x, np.nan), np.where(seen, y, np.nan)
    if any(coefficients[2:4]):  # the tangential part folds elsewhere
        beyond = ~brown_conrady.unfolded(x, y, coefficients)
    else:
        beyond = np.hypot(x, y) >= brown_conrady.fold_radius(coefficients)
    return brown_conrady.distort(np.where(beyond, np.nan, x), np.where(beyond, np.nan, y), coefficients)
