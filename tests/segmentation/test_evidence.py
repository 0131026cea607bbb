"""Evidence: the kernels against plain NumPy, and what is left out."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import rgbd_planes as rp
from rgbd_planes import Camera, Reason, Segmentation, segment
from rgbd_planes.evaluation import scenes
from rgbd_planes.kernels.segmentation.evidence.evidence import renumber_labels, weigh_planes
from rgbd_planes.kernels.segmentation.model.records import Rules, plain
from rgbd_planes.segmentation.workspace import rays_of

CAMERA = Camera(width=160, height=120, fx=130.0, fy=128.0, cx=79.0, cy=61.0, depth_scale=1000.0)
DISTORTED = Camera(
    width=160, height=120, fx=130.0, fy=128.0, cx=79.0, cy=61.0, depth_scale=1000.0,
    distortion=(0.05, -0.02, 0.001, 0.0, 0.0),
)  # fmt: skip


def smooth(shape, pixels, seed):
    """Errors of standard deviation 1, correlated over so many pixels."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    noise = gaussian_filter(noise, pixels) if pixels else noise
    return noise / noise.std()


def labelled(camera, holes, pixels, seed):
    """Inverse depths of four planes and a frame of none around them, and their labels."""
    rng = np.random.default_rng(seed)
    label = np.zeros(camera.shape, np.int32)
    label[10:60, 5:80], label[10:60, 80:150], label[60:100, 30:34], label[70:77, 60:69] = 1, 2, 3, 4
    planes = np.array([[0.1, 0.05, 0.5], [-0.1, 0.02, 0.6], [0.0, 0.0, 0.8], [0.3, 0.0, 0.4], [0.0, 0.1, 0.45]])
    a, b, c = planes[label - 1].transpose(2, 0, 1)
    q = a * camera.tan_x + b * camera.tan_y + c + 2e-3 * smooth(camera.shape, pixels, seed)
    missing = rng.random(camera.shape) < holes
    q[missing], label[missing] = 0.0, 0
    return q.astype(np.float32), label


def fitted(q, label, camera):
    """α and the moments of each label."""
    alpha, moments = [], []
    for k in range(1, label.max() + 1):
        own = label == k
        u, v, w = camera.tan_x[own], camera.tan_y[own], q[own].astype(float)
        rays = np.column_stack([u, v, np.ones(len(u))])
        alpha.append(np.linalg.lstsq(rays, w, rcond=None)[0])
        sums = (u, v, w, u * u, u * v, u * w, v * v, v * w, w * w)
        moments.append([len(u), *(x.sum() for x in sums)])
    return np.array(alpha), np.array(moments)


def expected(q, label, camera, alpha):
    """The evidence for each label, by its definition."""
    q, count = q.astype(float), len(alpha)
    rays = np.stack([camera.tan_x, camera.tan_y, np.ones(camera.shape)], axis=-1)
    sizes, shares, flat, least, own_rss = np.empty((5, count))
    for k in range(count):
        own = label == k + 1
        residual = q - rays @ alpha[k]
        seen = own & (np.arange(len(own)) % 8 < 2)[:, None]
        across = (residual[:, 1:] - residual[:, :-1])[seen[:, 1:] & seen[:, :-1]]
        down = (residual[1:] - residual[:-1])[seen[1:] & seen[:-1]]
        own_rss[k], sizes[k] = (residual[own] ** 2).sum(), own.sum()
        flat[k] = (4e-4 * q[own].mean()) ** 2
        shares[k] = 0.5 * np.mean(np.concatenate([across, down]) ** 2) + flat[k]
        shares[k] /= np.mean(residual[seen] ** 2) + flat[k]
        others, rim = set(), []
        for y, x in np.argwhere(own):
            for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                if 0 <= y + dy < len(own) and 0 <= x + dx < own.shape[1] and own[y + dy, x + dx]:
                    continue
                if (y if dx else x) % 2:  # every second row and column is looked along
                    continue
                for step in range(1, 5):
                    r, c = y + step * dy, x + step * dx
                    if 0 <= r < len(own) and 0 <= c < own.shape[1] and not own[r, c] and q[r, c] > 0.0:
                        rim.append((r, c))
                        others |= {label[r, c]} - {0}
        rows, columns = np.array(rim).T
        planes = [alpha[other - 1] for other in others]
        planes.append(np.linalg.lstsq(rays[rows, columns], q[rows, columns], rcond=None)[0])
        least[k] = min(((q[own] - rays[own] @ plane) ** 2).sum() for plane in planes)
    shares = np.log(np.clip(shares, 1e-3, 0.999))
    order = np.argsort(shares)
    frame = shares[order][np.searchsorted(np.cumsum(sizes[order]), 0.5 * sizes.sum())]
    share = np.exp((sizes * shares + 1000.0 * frame) / (sizes + 1000.0))
    samples = sizes / np.maximum(-np.pi / np.log(1.0 - share), 1.0)
    return 0.5 * samples * np.log(np.clip((least + sizes * flat) / (own_rss + sizes * flat), 1.0, 1e4))


@pytest.mark.parametrize("camera", [CAMERA, DISTORTED], ids=["pinhole", "lens"])
@pytest.mark.parametrize("holes", [0.0, 0.1])
@pytest.mark.parametrize("pixels", [0.0, 3.0])
def test_evidence_is_that_of_its_definition(camera, holes, pixels):
    q, label = labelled(camera, holes, pixels, 1)
    alpha, moments = fitted(q, label, camera)
    evidence = np.empty(len(alpha))
    weigh_planes(label, q, plain(rays_of(camera._lens)), alpha, moments, 4e-4, evidence)
    np.testing.assert_allclose(evidence, expected(q, label, camera, alpha), rtol=1e-6)


def test_nothing_around_a_plane_and_no_residual_leave_no_doubt():
    label = np.zeros(CAMERA.shape, np.int32)
    label[40:60, 40:60] = 1
    q = np.where(label > 0, 0.5, 0.0).astype(np.float32)
    alpha, moments = np.array([[0.0, 0.0, 0.5]]), fitted(q, label, CAMERA)[1]
    evidence = np.empty(1)
    weigh_planes(label, q, plain(rays_of(CAMERA._lens)), alpha, moments, 4e-4, evidence)
    assert evidence[0] == pytest.approx(0.5 * 400 * np.log(1e4), rel=1e-3)


def test_no_planes_are_no_evidence():
    label, q = np.zeros(CAMERA.shape, np.int32), np.zeros(CAMERA.shape, np.float32)
    weigh_planes(label, q, plain(rays_of(CAMERA._lens)), np.empty((0, 3)), np.empty((0, 10)), 4e-4, np.empty(0))


def test_labels_are_renumbered_and_the_others_get_a_reason():
    rng = np.random.default_rng(0)
    label = rng.integers(0, 4, (7, 9)).astype(np.int32)
    reason = np.where(label > 0, 0, 2).astype(np.uint8)
    number = np.array([0, 1, 0, 2], np.int32)
    new, why = label.copy(), reason.copy()
    renumber_labels(number, np.uint8(7), (new, why))
    assert (new == number[label]).all()
    assert (why == np.where(label == 2, 7, reason)).all()


def stereo_room(pixels):
    """The furnished room with a stereo camera's errors."""
    camera = Camera(width=640, height=480, fx=385.0, fy=385.0, cx=319.5, cy=239.5, depth_scale=1000.0)
    rendering = scenes.room().render(camera)
    q = 1.0 / rendering.depth + 4e-3 * smooth(camera.shape, pixels, 5)
    return np.rint(1000.0 / q).astype(np.uint16), camera, rendering


def test_planes_of_smooth_noise_are_left_out():
    depth, camera, _ = stereo_room(6.0)
    found = segment(depth, camera)
    assert (found.evidence >= Rules().evidence).all()
    assert np.count_nonzero(found.reason == Reason.NOISE) > 1000
    assert ((found.reason == Reason.PLANE) == (found.labels > 0)).all()
    assert set(np.unique(found.labels)) == set(range(len(found) + 1))
    np.testing.assert_array_equal(np.bincount(found.labels.ravel())[1:], found.sizes)


def test_independent_noise_leaves_small_faces():
    camera = Camera(width=320, height=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5, depth_scale=10000.0)
    depth = np.full(camera.shape, 2.0)
    depth[100:112, 100:116] = 1.9
    depth += 5e-3 * np.random.default_rng(3).standard_normal(camera.shape)
    found = segment(np.rint(1e4 * depth).astype(np.uint16), camera)
    assert len(found) == 2
    assert found.evidence.min() > 5.0 * Rules().evidence
    assert not (found.reason == Reason.NOISE).any()


def test_a_larger_plane_has_more_evidence():
    evidence = []
    for size in (10, 20, 40):
        depth = np.full(CAMERA.shape, 2.0)
        depth[40 : 40 + size, 40 : 40 + size] = 1.8
        depth += 4e-3 * np.random.default_rng(3).standard_normal(CAMERA.shape)
        found = segment(np.rint(1e3 * depth).astype(np.uint16), CAMERA)
        evidence.append(found.evidence[found.labels[45, 45] - 1])
    assert evidence[0] < evidence[1] < evidence[2]


def test_evidence_is_in_tables_and_files(tmp_path):
    depth, camera, _ = stereo_room(0.0)
    found = segment(depth, camera)
    np.testing.assert_array_equal(found.to_table()["evidence"], found.evidence)
    found.save(tmp_path / "found.npz")
    np.testing.assert_array_equal(Segmentation.load(tmp_path / "found.npz").evidence, found.evidence)


def test_files_of_earlier_versions_have_none(tmp_path):
    depth, camera, _ = stereo_room(0.0)
    found = segment(depth, camera)
    found.save(tmp_path / "found.npz")
    with np.load(tmp_path / "found.npz") as saved:
        np.savez(tmp_path / "earlier.npz", **{name: saved[name] for name in saved.files if name != "evidence"})
    earlier = rp.Segmentation.load(tmp_path / "earlier.npz")
    assert np.isnan(earlier.evidence).all()
    np.testing.assert_array_equal(earlier.labels, found.labels)
