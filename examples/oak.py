"""Planes of a Luxonis OAK with stereo cameras, live: ``python examples/oak.py``.

Needs ``pip install "depthai>=3" "rgbd-planes[viewer]"``. Ctrl-C ends it.
"""

import argparse

import depthai as dai

import rgbd_planes as rp


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, nargs=2, default=(640, 400), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--camera", metavar="JSON", help="a camera with its noise, as rgbd-planes noise writes it")
    parser.add_argument("--show", default="window", metavar="WHERE", help="window, browser, or a file PLANES.rrd")
    options = parser.parse_args(arguments)

    with dai.Pipeline() as pipeline:
        stereo = pipeline.create(dai.node.StereoDepth).build(True, size=tuple(options.size))
        stereo.setSubpixel(True)  # whole pixels of disparity would make steps of every slanted plane
        queue = stereo.depth.createOutputQueue(maxSize=1, blocking=False)  # the newest frame, not the oldest
        pipeline.start()
        try:
            camera, tracker = None, rp.PlaneTracker()
            with rp.LiveView(options.show) as view:
                while pipeline.isRunning():
                    frame = queue.get()
                    depth = frame.getFrame()  # (H, W) uint16, millimetres
                    if camera is None:
                        given = rp.Camera.load(options.camera) if options.camera else None
                        camera = given or camera_of(frame, depth.shape)
                        rp.warmup(camera, dtypes="uint16", segment=True)  # compiles, once for an installation
                    found = tracker.follow(rp.segment(depth, camera))
                    view.show(depth, camera, found, timestamp=frame.getTimestamp().total_seconds())
        except KeyboardInterrupt:
            pass


def camera_of(frame: dai.ImgFrame, shape: tuple[int, int]) -> rp.Camera:
    """Intrinsics of the image as it comes: StereoDepth has rectified it, so no distortion is left."""
    matrix = frame.getTransformation().getIntrinsicMatrix()
    height, width = shape
    return rp.Camera.from_opencv(matrix, None, (width, height), depth_scale=1000.0)


if __name__ == "__main__":
    main()
