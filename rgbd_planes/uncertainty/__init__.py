"""What noise does to a plane, and what follows: comparing, moving and fusing planes. Uses `camera` and below."""

from rgbd_planes.uncertainty.planes import PlaneAlignment as PlaneAlignment
from rgbd_planes.uncertainty.planes import align_planes as align_planes
from rgbd_planes.uncertainty.planes import angle_between as angle_between
from rgbd_planes.uncertainty.planes import fuse_planes as fuse_planes
from rgbd_planes.uncertainty.planes import point_distance as point_distance
from rgbd_planes.uncertainty.planes import same_plane as same_plane
from rgbd_planes.uncertainty.planes import transform_planes as transform_planes
