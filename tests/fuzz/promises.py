"""What the documentation promises of a result, whatever went in."""

import numpy as np

import rgbd_planes as rp

OK, TOO_FEW, DEGENERATE, ROUGH = 0, 1, 2, 3
# What rounding may leave of an eigenvalue that is 0, as a share of the largest.
ROUNDING = 1e-6


class BrokenPromiseError(AssertionError):
    """A result that is not what the documentation says."""


def promise(holds, what):
    if not bool(np.all(holds)):
        raise BrokenPromiseError(what)


def planes(found, alpha=None):
    """Unit normals, positive distances, -n / d."""
    promise(np.isfinite(found), "planes are finite")
    promise(np.abs(np.linalg.norm(found[:, :3], axis=1) - 1.0) < 1e-9, "normals have length 1")
    promise(found[:, 3] > 0.0, "d is positive")
    if alpha is not None:
        promise(np.abs(alpha * found[:, 3:] + found[:, :3]) < 1e-9, "alpha is -n / d")


def covariances(matrices, what):
    """Finite, symmetric, positive semi-definite up to rounding: each unit by its own scale."""
    promise(np.isfinite(matrices), f"{what} are finite")
    variances = np.diagonal(matrices, axis1=-2, axis2=-1)
    promise(variances >= 0.0, f"variances of {what} are not negative")
    promise(matrices == np.swapaxes(matrices, -1, -2), f"{what} are symmetric")
    deviation = np.sqrt(variances)
    if matrices.shape[-1] == 4:  # a normal of length 1 has no variance along itself
        deviation[..., :3] = np.sqrt(variances[..., :3].sum(axis=-1, keepdims=True))
    deviation = np.where(deviation > 0.0, deviation, 1.0)
    with np.errstate(all="ignore"):
        correlation = matrices / deviation[..., :, None] / deviation[..., None, :]
    correlation = correlation[np.isfinite(correlation).all(axis=(-2, -1))]
    if len(correlation):
        promise(np.linalg.eigvalsh(correlation) > -ROUNDING * 10, f"{what} are positive semi-definite")


def fits(result):
    """Of a `PlaneFits`: status, planes, residuals and, with a noise model, statistics."""
    status = result.status.ravel()
    fitted = np.isin(status, (OK, ROUGH))
    found, alpha = result.planes.reshape(-1, 4), result.alpha.reshape(-1, 3)
    rmse, metric = result.rmse.ravel(), result.rmse_metric.ravel()
    promise(status <= ROUGH, "a known status")
    planes(found[fitted], alpha[fitted])
    promise(np.isnan(found[~fitted]), "no plane where the status says so")
    promise(np.isfinite(rmse[fitted]) & (rmse[fitted] >= 0.0), "rmse is finite")
    promise(np.isfinite(metric[fitted]) & (metric[fitted] >= 0.0), "rmse_metric is finite")
    promise(result.valid_count.ravel()[fitted] >= 3, "a plane has three pixels")
    if result.camera.noise is not None:
        p_value = result.p_value.ravel()
        promise((p_value[fitted] >= 0.0) & (p_value[fitted] <= 1.0), "p-values are from 0 to 1")
        promise(np.isnan(p_value[~fitted]), "no p-value without a plane")
        covariances(result.alpha_covariance.reshape(-1, 3, 3)[fitted], "covariances of alpha")
        covariances(result.plane_covariance.reshape(-1, 4, 4)[fitted], "covariances of planes")
        promise(np.isfinite(result.angle_std.ravel()[fitted]), "angle_std is finite")
        promise(np.isfinite(result.offset_std.ravel()[fitted]), "offset_std is finite")


def segments(found, shape):
    """Of a `Segmentation`."""
    labels = found.labels
    promise(labels.shape == shape, "a label for each pixel")
    promise((labels >= 0) & (labels <= len(found)), "labels of planes that there are")
    promise(np.bincount(labels.ravel(), minlength=len(found) + 1)[1:] == found.sizes, "sizes count the pixels")
    planes(found.planes, found.alpha)
    promise(np.isfinite(found.rmse) & (found.rmse >= 0.0), "rmse is finite")
    covariances(found.alpha_covariance, "covariances of alpha")
    covariances(found.plane_covariance, "covariances of planes")


def normals(found, curved=None):
    """Unit vectors or NaN; curvature where there is a normal."""
    known = ~np.isnan(found).any(axis=-1)
    promise(np.abs(np.linalg.norm(found[known], axis=-1) - 1.0) < 1e-5, "normals have length 1")
    if curved is not None:
        promise(np.isnan(curved) == ~known, "a curvature where there is a normal")
        promise(np.isfinite(curved[known]), "curvatures are finite")


def refused(error):
    """Whether an error is one that the documentation names, in words that can be printed."""
    return isinstance(error, (ValueError, TypeError)) and bool(str(error)) and str(error).isprintable()


def same(one, other, what):
    promise(np.array_equal(one, other, equal_nan=True), what)


STATUSES = rp.TileStatus


def primitives(result):
    """Of a `PrimitiveFits`: what each kind has and lacks, residuals and covariances."""
    kind, status = result.kind, result.status
    has_kind = kind != rp.Primitive.NONE
    curved = np.isin(kind, (rp.Primitive.SPHERE, rp.Primitive.CYLINDER))
    promise(has_kind == (status == OK), "a kind where the status is OK")
    promise((result.radius > 0.0) == curved, "a radius for what is curved")
    promise(np.isfinite(result.radius[curved]), "radii are finite")
    promise(np.isfinite(result.centre[has_kind]), "centres are finite")
    promise(np.isnan(result.centre[~has_kind]), "no centre without a kind")
    has_axis = np.isin(kind, (rp.Primitive.PLANE, rp.Primitive.CYLINDER))
    promise(np.abs(np.linalg.norm(result.axis[has_axis], axis=1) - 1.0) < 1e-9, "axes have length 1")
    fitted = np.isin(status, (OK, ROUGH))
    promise(np.isfinite(result.rmse[fitted]) & (result.rmse[fitted] >= 0.0), "rmse is finite")
    promise((result.p_value[fitted] >= 0.0) & (result.p_value[fitted] <= 1.0), "a probability")
    promise(result.valid_count[fitted] >= 6, "a primitive has six pixels")
    covariances(result.covariance[has_kind], "covariances of primitives")
