"""Fit planes to the pixels of each label of an image: masks, or a segmentation from elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.checks import check_choice, check_labels, check_max_error, check_share, label_array
from rgbd_planes._core.compile_notice import announced
from rgbd_planes._core.text import counted
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.frame_warnings import warn_of_noise
from rgbd_planes.fitting.methods import METHODS, solve_planes, valid_needed
from rgbd_planes.fitting.results import PlacedFits, allocate
from rgbd_planes.fitting.saving import Savable, Values, check_fits, check_label_image
from rgbd_planes.kernels.moments.labels import label_moments
from rgbd_planes.uncertainty.falloff import EVEN
from rgbd_planes.uncertainty.footprints import like_rectangles
from rgbd_planes.uncertainty.pixel_errors import KeepsPixels, Pixels, pixels_of_labels
from rgbd_planes.uncertainty.statistics import Assessment, check_significance


@dataclass(frozen=True, eq=False, repr=False)
class LabelPlanes(Savable, KeepsPixels, PlacedFits):
    """The planes of labels 1 to K of a frame, arrays of shape S = (K,).

    It has the p-values, covariances, `plot`, `to_table`, `save` and `load` that `TilePlanes` has.

    Attributes
    ----------
    labels : (H, W) int32
        0 for none; row i of the arrays belongs to label i + 1.
    """

    labels: npt.NDArray[np.int32]
    _pixels: Pixels

    def _cells(self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        return self.labels[rows[:, None], columns].astype(np.int64) - 1

    @property
    def _title(self) -> str:
        return counted(len(self.status), "label")

    @classmethod
    def _checked(cls, values: Values) -> Values:
        labels, count = values["labels"], len(values["status"])
        check_label_image(labels, values["camera"].shape, count)
        check_fits(values, (count,), labels.size)
        return values


def fit_labels(
    depth: npt.ArrayLike,
    camera: Camera,
    labels: npt.ArrayLike,
    method: str = "range_explicit",
    *,
    max_missing: float = 0.5,
    max_error: float | None = None,
    significance: float | None = None,
) -> LabelPlanes:
    """Fit a plane to the pixels of a mask, or of each label of a segmentation from elsewhere.

    `segment` finds the pixels of planes by itself.

    Parameters
    ----------
    depth : (H, W) array_like
        The frame: floats in metres, or integers in the camera's ``depth_scale``; disparities of a camera that has
        ``disparity``.
    camera : Camera
    labels : (H, W) array_like of int or bool
        0 for none, 1..K. Each label has a row in the result; a mask is label 1.
    method : str
        ``range_explicit``, ``range_implicit``, ``standard_explicit``, ``standard_implicit`` or ``standard_pca``:
        `fit_tiles` explains them.
    max_missing : float
        Share of missing pixels above which a label gets TOO_FEW.
    max_error : float, optional
        Labels with a larger ``rmse_metric``, in metres, get ROUGH.
    significance : float, optional
        Labels whose residual the camera's noise exceeds less often than this get ROUGH. None is 0.01; 0 is no such
        test.

    Returns
    -------
    LabelPlanes
        Arrays of shape (K, ...); a label that no pixel has gets TOO_FEW.

    Raises
    ------
    TypeError, ValueError
        An argument cannot be used: the message says what was expected and what came. Labels must be integers or a mask
        of the frame's shape, neither negative nor above the number of pixels.

    Warns
    -----
    UserWarning
        Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.
        Or the labels are an image of 0 and 255, most likely a mask, or 255 seems to mean none.

    Notes
    -----
    Each valid pixel counts. A pixel at the edge of a mask that lies on something else pulls the plane towards it.
    Covariances follow from the noise model. They say nothing about a label that is not one plane, whose p-value is
    near 0.
    """
    check_camera(camera)
    check_choice("method", method, METHODS)
    max_missing = check_share("max_missing", max_missing)
    error = check_max_error(max_error)
    check_significance(significance, camera)
    numbers = check_labels_of(labels, camera)
    frame = as_depth_frame(depth, camera)
    warn_of_noise(frame, camera.noise)

    count = int(numbers.max())
    arrays = allocate((), (count,))
    footprint = np.empty((count, 5), np.int64)
    moments, reference = np.empty((count, 10)), np.empty((count, 3))
    with announced(("labels", method, frame.raw.dtype)):
        label_moments(frame.values, camera._rays, method.startswith("standard"), numbers, footprint, moments, reference)
        arrays["_moments"][:], arrays["_reference"][:] = moments.T, reference.T
        solve_planes(method, arrays, valid_needed(footprint[:, 0], max_missing), error, 0, count)
        pixels = pixels_of_labels(frame, camera, numbers, method, footprint, arrays)
        sizes = like_rectangles(footprint)  # and no growth: the sums include it
        assessment = Assessment(camera, method, significance, sizes, footprint, EVEN)
        assessment.of(arrays, pixels.error_sums, pixels.shared)(0, count)
    return LabelPlanes(camera=camera, method=method, labels=numbers, _pixels=pixels, **arrays)


def check_labels_of(labels: npt.ArrayLike, camera: Camera) -> npt.NDArray[np.int32]:
    """Return the labels as a contiguous (H, W) int32 array of its own."""
    array = label_array("labels", labels)
    if array.shape != camera.shape:
        several = array.ndim == 3 and array.shape[1:] == camera.shape
        hint = ": (masks * np.arange(1, len(masks) + 1)[:, None, None]).max(axis=0) makes labels of masks"
        raise ValueError(
            f"labels must have the shape of the frame, {camera.shape}, got {array.shape}{hint if several else ''}"
        )
    check_labels(array, array.size)
    if array.dtype == np.uint8 and array.max() == 255:
        most = np.max(array, initial=0, where=array < 255)
        if most == 0:
            warn_caller("the only label is 255: is it a mask? mask > 0 is one label, and not the last of 255")
        elif most < 254:
            warn_caller(
                f"labels are 0 to {most}, and 255: if that is none, and 0 a label, as OpenCV has them, "
                "labels + np.uint8(1) has 0 for none"
            )
    return np.array(array, np.int32, order="C")
