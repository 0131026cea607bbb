"""The planes of a row of windows from their sums.

Least squares of q on m (the paper's eq. 15) over the valid pixels of each window.
"""

import math

import numpy as np

from .._jit.kernel import kernel
from ..moments.sliding_window import PITCH
from ..solvers.methods import COLLINEAR

# 1/Z of the plane at the pixel, over its mean in the window: below, rounding may decide whether it is in front at all.
IN_FRONT = 1e-9


@kernel(reduction=True, arrays=False)
def normals_row(all_sums, valid, needed, focal, tan_x, tan_y, normals):
    """Normals of a row of windows from their sums, for a camera without lens distortion.

    Only the direction of α matters, so the normal equations are solved up to the factor n·det(MᵀM): one division and
    one square root per pixel.

    Parameters
    ----------
    all_sums
        Σq, Σqx, Σqy; Σ1, Σx, Σxx, Σy, Σxy, Σyy. tanθx is x / fx and tanθy y / fy, up to a constant.
    valid, needed : (N,) float32
        Whether the middle pixel is valid, 1 or 0, and how many valid pixels a window needs.
    focal : (fx, fy)
    tan_x, tan_y : (N,) float64 and float
        tanθx of the middle pixels, and tanθy of the row.
    normals : (3 N,) float32, written
    """
    sums, valid_sums = all_sums
    fx, fy = focal
    for i in range(needed.shape[0]):
        n = np.float64(valid_sums[i])
        x = np.float64(valid_sums[PITCH + i])
        y = np.float64(valid_sums[3 * PITCH + i])
        c_xx = n * valid_sums[2 * PITCH + i] - x * x
        c_xy = n * valid_sums[4 * PITCH + i] - x * y
        c_yy = n * valid_sums[5 * PITCH + i] - y * y
        q = sums[i]
        c_xq = n * sums[PITCH + i] - x * q
        c_yq = n * sums[2 * PITCH + i] - y * q
        determinant = c_xx * c_yy - c_xy * c_xy
        slope_x = c_yy * c_xq - c_xy * c_yq
        slope_y = c_xx * c_yq - c_xy * c_xq
        mean = determinant * q
        centre = mean - slope_x * x - slope_y * y
        a = fx * (n * slope_x)
        b = fy * (n * slope_y)
        c = centre - a * tan_x[i] - b * tan_y
        enough = (valid_sums[i] >= needed[i]) & (valid[i] > np.float32(0.0))
        there = enough & (determinant > 0.0) & (centre > IN_FRONT * abs(mean))
        inverse_norm = -1.0 / np.sqrt(a * a + b * b + c * c)  # NumPy's: in plain Python 1.0 / 0.0 is an error
        inverse_norm = inverse_norm if there else math.nan
        normals[3 * i] = a * inverse_norm
        normals[3 * i + 1] = b * inverse_norm
        normals[3 * i + 2] = c * inverse_norm


@kernel(reduction=True, arrays=False)
def surface_row(all_sums, wanted, needed, focal, pixel, rays, results):
    """Normal, residual variance and surface variation of a row of windows.

    C is the covariance of the rays m in the window, m̄ and q̄ are the means and s² the mean squared residual. To first
    order the points X = m/q of the fitted plane spread by tr(J C Jᵀ), J = (I - m̄αᵀ/q̄)/q̄. The measured points scatter
    about the plane by s²d²/q̄².

    Parameters
    ----------
    all_sums
        Σq, Σqx, Σqy; Σq²; Σ1, Σx, Σxx, Σy, Σxy, Σyy. tanθx is x / fx and tanθy y / fy, up to a constant.
    wanted : (N,) float32
        1, or 0 to write NaN.
    needed : (N,) float32
        Fewer valid pixels give NaN.
    focal : (fx, fy)
    pixel : x and y, (N,) float64 each
        The centre pixel in these coordinates.
    rays : tan_x, tan_y, (N,) float64 each
        Of the centre pixel.
    results : normals, variance, variation; (3 N,), (N,), (N,) float32, written
        Variance of q about the plane in 1/m²: the sum of the squared residuals of n pixels over n - 3.
    """
    sums, squares, valid_sums = all_sums
    fx, fy = focal
    x_pixel, y_pixel = pixel
    tan_x, tan_y = rays
    normals, variance, variation = results
    inverse_fx = 1.0 / fx
    inverse_fy = 1.0 / fy
    for i in range(needed.shape[0]):
        n = np.float64(valid_sums[i])
        per_pixel = 1.0 / n
        x = per_pixel * valid_sums[PITCH + i]
        y = per_pixel * valid_sums[3 * PITCH + i]
        q = per_pixel * sums[i]
        c_xx = per_pixel * valid_sums[2 * PITCH + i] - x * x
        c_xy = per_pixel * valid_sums[4 * PITCH + i] - x * y
        c_yy = per_pixel * valid_sums[5 * PITCH + i] - y * y
        c_xq = per_pixel * sums[PITCH + i] - x * q
        c_yq = per_pixel * sums[2 * PITCH + i] - y * q
        c_qq = per_pixel * squares[i] - q * q
        determinant = c_xx * c_yy - c_xy * c_xy
        trace = c_xx + c_yy
        inverse_determinant = 1.0 / determinant
        slope_x = (c_yy * c_xq - c_xy * c_yq) * inverse_determinant
        slope_y = (c_xx * c_yq - c_xy * c_xq) * inverse_determinant
        mean_square = c_qq - slope_x * c_xq - slope_y * c_yq
        mean_square = mean_square if mean_square > 0.0 else 0.0
        away_x = x - x_pixel[i]
        away_y = y - y_pixel[i]
        at_pixel = q - slope_x * away_x - slope_y * away_y
        a = fx * slope_x
        b = fy * slope_y
        c = at_pixel - a * tan_x[i] - b * tan_y[i]
        enough = (n >= needed[i]) & (wanted[i] > np.float32(0.0))
        there = enough & (determinant > COLLINEAR * trace * trace) & (at_pixel > IN_FRONT * abs(q))
        nan = 0.0 if there else math.nan
        inverse_norm = nan - 1.0 / math.sqrt(a * a + b * b + c * c)
        normals[3 * i] = a * inverse_norm
        normals[3 * i + 1] = b * inverse_norm
        normals[3 * i + 2] = c * inverse_norm
        variance[i] = nan + mean_square * n / (n - 3.0)
        # The spread of the points, times q̄².
        c_uu = c_xx * (inverse_fx * inverse_fx)
        c_uv = c_xy * (inverse_fx * inverse_fy)
        c_vv = c_yy * (inverse_fy * inverse_fy)
        u = tan_x[i] + away_x * inverse_fx
        v = tan_y[i] + away_y * inverse_fy
        z = 1.0 / q
        across = a * (u * c_uu + v * c_uv) + b * (u * c_uv + v * c_vv)
        along = a * a * c_uu + 2.0 * a * b * c_uv + b * b * c_vv
        spread = c_uu + c_vv + z * (z * (u * u + v * v + 1.0) * along - 2.0 * across)
        spread = spread if spread > 0.0 else 0.0
        off_plane = mean_square * (inverse_norm * inverse_norm)
        share = off_plane / (off_plane + spread)
        share = share if share < 1.0 else 1.0  # NaN where both are infinite
        variation[i] = nan + (share if off_plane > 0.0 else 0.0)


@kernel(arrays=False)
def needed_pixels(row, left, half, shape, needed_by_size, needed):
    """Write how many valid pixels the windows of a row, clipped at the frame, need: by the number of their pixels."""
    height, width = shape
    rows = min(row + half, height - 1) - max(row - half, 0) + 1
    for i in range(needed.shape[0]):
        column = left + i
        needed[i] = needed_by_size[rows * (min(column + half, width - 1) - max(column - half, 0) + 1)]
