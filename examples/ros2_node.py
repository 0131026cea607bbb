"""A ROS 2 node that finds planes.

``python examples/ros2_node.py --ros-args -r depth:=/camera/depth/image_rect_raw -r camera_info:=/camera/depth/info``

Subscribes to ``depth`` (sensor_msgs/Image, 16UC1 or 32FC1) and to the ``camera_info`` that belongs to it. Publishes
``labels``, an image with the id of each pixel's plane (32SC1, 0 for none). Shows the planes in rerun: the parameter
``show`` is window, browser, none or a file PLANES.rrd. With ``rectified:=false`` the image has its lens distortion.
"""

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

import rgbd_planes as rp

DTYPES = {"16UC1": "u2", "32FC1": "f4"}


class Planes(Node):
    def __init__(self) -> None:
        super().__init__("planes")
        show = self.declare_parameter("show", "window").value
        self.rectified = self.declare_parameter("rectified", True).value
        self.view = None if show == "none" else rp.LiveView(show)
        self.camera, self.tracker = None, rp.PlaneTracker()
        self.publisher = self.create_publisher(Image, "labels", 10)
        self.create_subscription(CameraInfo, "camera_info", self.on_info, qos_profile_sensor_data)
        self.create_subscription(Image, "depth", self.on_depth, qos_profile_sensor_data)

    def on_info(self, info: CameraInfo) -> None:
        if self.camera is None:
            self.camera = rp.Camera.from_ros(info, rectified=self.rectified, depth_scale=1000.0)
            rp.warmup(self.camera, segment=True)  # compiles, once for an installation

    def on_depth(self, message: Image) -> None:
        if self.camera is None:  # no CameraInfo yet
            return
        depth = depth_of(message)
        tracked = self.tracker.follow(rp.segment(depth, self.camera))
        height, width = tracked.labels.shape
        labels = Image(header=message.header, height=height, width=width, encoding="32SC1", step=4 * width)
        labels.data = tracked.labels.astype("<i4").tobytes()
        self.publisher.publish(labels)
        if self.view is not None:
            stamp = message.header.stamp
            self.view.show(depth, self.camera, tracked, timestamp=stamp.sec + 1e-9 * stamp.nanosec)


def depth_of(message: Image) -> np.ndarray:
    """The image's pixels: 16UC1 in millimetres, 32FC1 in metres."""
    if message.encoding not in DTYPES:
        raise ValueError(f"expected a depth image, 16UC1 or 32FC1, got {message.encoding}")
    dtype = np.dtype((">" if message.is_bigendian else "<") + DTYPES[message.encoding])
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    return rows[:, : message.width * dtype.itemsize].copy().view(dtype)


def main() -> None:
    rclpy.init()
    node = Planes()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        if node.view is not None:
            node.view.close()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
