"""Cameras of common sensors and data sets.

Each is one published calibration or nominal value, named in its docstring. Lenses differ from device to
device, by about 1 % of the focal length and some pixels of the principal point: a calibration of your own is better.
"""

from rgbd_planes.camera.camera import Camera


def primesense() -> Camera:
    """PrimeSense, Asus Xtion and Kinect v1 depth as OpenNI gives it: registered to colour, millimetres.

    Source: the TUM RGB-D benchmark's page on intrinsic calibration (f 525, centre 319.5, 239.5, for all
    OpenNI depth); the same as Open3D's PrimeSenseDefault.
    """
    return Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_scale=1000.0)


def kinect_v1() -> Camera:
    """Kinect v1 depth as its driver gives it: factory calibration, registered to colour, millimetres.

    Source: as `primesense`.
    """
    return primesense()


def kinect_v1_infrared() -> Camera:
    """Kinect v1 depth in the geometry of its own infrared camera, lens distortion included, millimetres.

    Source: the depth camera of the NYU Depth v2 toolbox, camera_params.m (Silberman et al. 2012); one device.
    """
    return Camera(
        640,
        480,
        fx=582.62448167737955,
        fy=582.69103270988637,
        cx=313.04475870804731,
        cy=238.44389626620386,
        distortion=(
            -0.099897236553084481,
            0.39065324602765344,
            0.0019290592870229277,
            -0.0019422022475975055,
            -0.51031725053400578,
        ),
        depth_scale=1000.0,
    )


def kinect_v1_disparity() -> Camera:
    """Kinect v1's raw 11-bit disparity, in the geometry of its infrared camera.

    In metres, Z = 351.3 / (1092.5 - raw). Source: the NYU Depth v2 toolbox, camera_params.m (Silberman et al.
    2012); one device. 2047 means missing.
    """
    infrared = kinect_v1_infrared()
    return Camera(
        infrared.width,
        infrared.height,
        infrared.fx,
        infrared.fy,
        infrared.cx,
        infrared.cy,
        infrared.distortion,
        disparity=(-1.0 / 351.3, 1092.5 / 351.3),
        invalid_values=(2047,),
    )


def kinect_v2() -> Camera:
    """Kinect v2 depth, 512x424, lens distortion included, millimetres.

    Source: the infrared camera's parameters in CameraParams.pde of CodingTrain/website-archive (Processing's
    Kinect v2 point cloud example), read from one device.
    """
    return Camera(
        512,
        424,
        365.456,
        365.456,
        254.878,
        205.395,
        distortion=(0.0905474, -0.26819, 0.0, 0.0, 0.0950862),
        depth_scale=1000.0,
    )


def azure_kinect_nfov() -> Camera:
    """Azure Kinect depth, narrow field of view, unbinned, 640x576, lens distortion included, millimetres.

    Source: the calibration inside tests/assets/recording.mkv of etiennedub/pyk4a, cropped to the mode as the
    SDK does; one device.
    """
    return Camera(
        640,
        576,
        fx=504.6076354980469,
        fy=504.7325134277344,
        cx=332.78106689453125,
        cy=348.8297119140625,
        distortion=(
            0.5479397773742676,
            -0.020971370860934258,
            2.0557534298859537e-05,
            -7.210415787994862e-05,
            -0.002652231603860855,
            0.8896790742874146,
            0.08613020926713943,
            -0.013910384848713875,
        ),
        depth_scale=1000.0,
    )


def realsense_d435(width: int = 1280, height: int = 720) -> Camera:
    """RealSense D435, D435i and D455 depth in a 16:9 mode, nominal, millimetres.

    Parameters
    ----------
    width, height : int
        1280x720, 848x480 or 640x360.

    Raises
    ------
    ValueError
        The mode is none of these.

    Notes
    -----
    Source: the D400 datasheet's imager, focal length 1.93 mm and pixels of 3 µm at 1280 columns: 643.3
    pixels. Devices are about 1 % off (638.0 on one: librealsense's GitHub issue 3314);
    `Camera.from_realsense` takes the device's own. The depth stream is rectified: no distortion.
    """
    if (width, height) not in ((1280, 720), (848, 480), (640, 360)):
        raise ValueError(
            f"expected a mode of 1280x720, 848x480 or 640x360, got {width}x{height}: "
            "Camera.from_realsense takes what the device says of any"
        )
    focal_length = 1.93 / 0.003 * width / 1280
    return Camera(width, height, focal_length, focal_length, (width - 1) / 2, (height - 1) / 2, depth_scale=1000.0)


def tum_freiburg1() -> Camera:
    """TUM RGB-D sequences freiburg1: the colour camera, to which depth is registered; 5000 per metre.

    Source: Examples/RGB-D/TUM1.yaml of raulmur/ORB_SLAM2, after Sturm et al. 2012.
    """
    return Camera(
        640,
        480,
        fx=517.306408,
        fy=516.469215,
        cx=318.643040,
        cy=255.313989,
        distortion=(0.262383, -0.953104, -0.005358, 0.002628, 1.163314),
        depth_scale=5000.0,
    )


def tum_freiburg2() -> Camera:
    """TUM RGB-D sequences freiburg2: the colour camera, to which depth is registered; 5000 per metre.

    Source: Examples/RGB-D/TUM2.yaml of raulmur/ORB_SLAM2, after Sturm et al. 2012; its depth factor of 5208,
    a correction of its own, is not used here.
    """
    return Camera(
        640,
        480,
        fx=520.908620,
        fy=521.007327,
        cx=325.141442,
        cy=249.701764,
        distortion=(0.231222, -0.784899, -0.003257, -0.000105, 0.917205),
        depth_scale=5000.0,
    )


def tum_freiburg3() -> Camera:
    """TUM RGB-D sequences freiburg3, already undistorted; 5000 units per metre.

    Source: Examples/RGB-D/TUM3.yaml of raulmur/ORB_SLAM2, after Sturm et al. 2012.
    """
    return Camera(640, 480, 535.4, 539.2, 320.1, 247.6, depth_scale=5000.0)


def icl_nuim() -> Camera:
    """ICL-NUIM's rendered rooms in the PNG form of the TUM benchmark: fy is negative; 5000 units per metre.

    Source: Handa et al. 2014; data/configs/ICL_living_room.K of prime-slam/deplex.
    """
    return Camera(640, 480, 481.2, -480.0, 319.5, 239.5, depth_scale=5000.0)


def seven_scenes() -> Camera:
    """Microsoft 7-Scenes (Kinect v1), millimetres; 0 and 65535 mean missing.

    Source: data/camera-intrinsics.txt of andyzeng/tsdf-fusion-python; Shotton et al. 2013.
    """
    return Camera(640, 480, 585.0, 585.0, 320.0, 240.0, depth_scale=1000.0, invalid_values=(65535,))


def scannet() -> Camera:
    """ScanNet (Structure sensor), millimetres.

    Source: the intrinsic_depth.txt that most of its scenes share (Dai et al. 2017); a scene's own is better.
    """
    return Camera(640, 480, 577.870605, 577.870605, 319.5, 239.5, depth_scale=1000.0)
