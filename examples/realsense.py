"""Planes of a RealSense, live: ``python examples/realsense.py``.

Needs ``pip install pyrealsense2 "rgbd-planes[viewer]"``. Ctrl-C ends it.
"""

import argparse

import numpy as np
import pyrealsense2 as rs

import rgbd_planes as rp


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, nargs=2, default=(848, 480), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--camera", metavar="JSON", help="a camera with its noise, as rgbd-planes noise writes it")
    parser.add_argument("--show", default="window", metavar="WHERE", help="window, browser, or a file PLANES.rrd")
    options = parser.parse_args(arguments)

    config = rs.config()
    config.enable_stream(rs.stream.depth, *options.size, rs.format.z16, 30)
    pipeline = rs.pipeline()
    profile = pipeline.start(config)
    try:
        camera = rp.Camera.load(options.camera) if options.camera else camera_of(profile)
        rp.warmup(camera, dtypes="uint16", segment=True)  # compiles, once for an installation
        tracker = rp.PlaneTracker()
        with rp.LiveView(options.show) as view:
            while True:
                frame = pipeline.wait_for_frames().get_depth_frame()
                if not frame:
                    continue
                depth = np.array(frame.get_data())  # a copy: the driver takes its memory back
                found = tracker.follow(rp.segment(depth, camera))
                view.show(depth, camera, found, timestamp=1e-3 * frame.get_timestamp())
    except KeyboardInterrupt:
        pass
    finally:
        pipeline.stop()


def camera_of(profile: rs.pipeline_profile) -> rp.Camera:
    """Intrinsics and unit of the depth stream, as the device states them."""
    intrinsics = profile.get_stream(rs.stream.depth).as_video_stream_profile().get_intrinsics()
    units = profile.get_device().first_depth_sensor().get_depth_scale()
    return rp.Camera.from_realsense(intrinsics, depth_units=units)


if __name__ == "__main__":
    main()
