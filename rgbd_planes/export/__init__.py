"""Tiles, segments and points for other tools: JSON, PLY, Open3D, ROS messages, rerun. Uses all that makes results."""

from rgbd_planes.export.exchange import json_ready as json_ready
from rgbd_planes.export.exchange import write_csv as write_csv
from rgbd_planes.export.exchange import write_normals as write_normals
from rgbd_planes.export.exchange import write_pcd as write_pcd
from rgbd_planes.export.ply import write_ply as write_ply
from rgbd_planes.export.points import points_to_open3d as points_to_open3d
from rgbd_planes.export.points import to_ros_points as to_ros_points
from rgbd_planes.export.tiles import tile_polygons as tile_polygons
from rgbd_planes.export.tiles import to_dict as to_dict
from rgbd_planes.export.tiles import to_open3d as to_open3d
from rgbd_planes.export.tiles import to_ros_planes as to_ros_planes
from rgbd_planes.export.tiles import to_ros_polygons as to_ros_polygons
from rgbd_planes.export.tiles import write_json as write_json
from rgbd_planes.export.tiles import write_tiles_ply as write_tiles_ply
from rgbd_planes.export.trajectories import to_ros_odometry as to_ros_odometry
from rgbd_planes.export.trajectories import write_trajectory as write_trajectory
