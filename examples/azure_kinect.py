"""Planes of an Azure Kinect, live: ``python examples/azure_kinect.py``.

Needs Microsoft's Azure Kinect SDK, and ``pip install pyk4a "rgbd-planes[viewer]"``. Ctrl-C ends it.
"""

import argparse

import pyk4a

import rgbd_planes as rp


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mode", default="NFOV_UNBINNED", help="NFOV_UNBINNED, NFOV_2X2BINNED, WFOV_2X2BINNED, ...")
    parser.add_argument("--camera", metavar="JSON", help="a camera with its noise, as rgbd-planes noise writes it")
    parser.add_argument("--show", default="window", metavar="WHERE", help="window, browser, or a file PLANES.rrd")
    options = parser.parse_args(arguments)

    config = pyk4a.Config(
        color_resolution=pyk4a.ColorResolution.OFF,
        depth_mode=pyk4a.DepthMode[options.mode],
        synchronized_images_only=False,
    )
    device = pyk4a.PyK4A(config)
    device.start()
    try:
        camera, tracker = None, rp.PlaneTracker()
        with rp.LiveView(options.show) as view:
            while True:
                capture = device.get_capture()
                depth = capture.depth
                if depth is None:
                    continue
                if camera is None:
                    given = rp.Camera.load(options.camera) if options.camera else None
                    camera = given or camera_of(device.calibration, depth.shape)
                    rp.warmup(camera, dtypes="uint16", segment=True)  # compiles, once for an installation
                found = tracker.follow(rp.segment(depth, camera))
                view.show(depth, camera, found, timestamp=1e-6 * capture.depth_timestamp_usec)
    except KeyboardInterrupt:
        pass
    finally:
        device.stop()


def camera_of(calibration: pyk4a.Calibration, shape: tuple[int, int]) -> rp.Camera:
    """The depth camera's own calibration, its lens included; its frames are in millimetres."""
    matrix = calibration.get_camera_matrix(pyk4a.CalibrationType.DEPTH)
    distortion = calibration.get_distortion_coefficients(pyk4a.CalibrationType.DEPTH)
    height, width = shape
    return rp.Camera.from_opencv(matrix, distortion, (width, height), depth_scale=1000.0)


if __name__ == "__main__":
    main()
