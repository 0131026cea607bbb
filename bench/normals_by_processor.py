"""``python -m bench.normals_by_processor``: dense normals against OpenCV's FALS, prepared, with and without AVX-512."""

import argparse
import os
import subprocess
import sys
import time
from functools import partial

WITHOUT = {
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma,+bmi,+bmi2,+sse4.2,+popcnt,+lzcnt,+f16c",
    "OPENCV_CPU_DISABLE": "AVX512_SKX,AVX512_ICL",
}
"""Environment in which both libraries use AVX2 and no AVX-512."""


def measure(rounds: int) -> tuple[float, float]:
    """Milliseconds of one thread for a VGA frame, window 7: FALS that is given points, and ours."""
    import cv2
    import numpy as np

    import rgbd_planes as rp

    camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_scale=1000.0)
    depth = rp.scenes.room().render(camera).measure(holes=0.05, seed=1)
    matrix = np.array([[525.0, 0.0, 319.5], [0.0, 525.0, 239.5], [0.0, 0.0, 1.0]])
    cv2.setNumThreads(1)
    method = cv2.RgbdNormals_RGBD_NORMALS_METHOD_FALS
    estimator = cv2.RgbdNormals_create(480, 640, cv2.CV_32F, matrix, 7, 50.0, method)
    z = np.where(depth > 0, depth / 1000.0, np.nan)
    points = np.dstack([z * camera.tan_x, z * camera.tan_y, z, 0.0 * z]).astype(np.float32)
    theirs, ours = partial(estimator.apply, points), partial(rp.normals, depth, camera, 7, num_threads=1)
    fastest = []
    for run in (theirs, ours):  # one after the other: each finds its own data in the caches
        run()
        times = []
        for _ in range(rounds):
            start = time.thread_time()
            run()
            times.append(time.thread_time() - start)
        fastest.append(1e3 * min(times))
    return fastest[0], fastest[1]


def main(arguments: list[str] | None = None) -> int:
    """Measure in this process, and in another without AVX-512."""
    parser = argparse.ArgumentParser(prog="python -m bench.normals_by_processor", description=__doc__)
    parser.add_argument("--rounds", type=int, default=60, metavar="N", help="of which the fastest counts (60)")
    parser.add_argument("--here", action="store_true", help="only with what this processor has")
    options = parser.parse_args(arguments)
    theirs, ours = measure(options.rounds)
    name = "AVX2" if "NUMBA_CPU_NAME" in os.environ else "this processor"
    print(f"{name}: FALS {theirs:.2f} ms, ours {ours:.2f} ms, {theirs / ours:.1f} times", flush=True)
    if not options.here:
        command = [sys.executable, "-m", "bench.normals_by_processor", "--here", "--rounds", str(options.rounds)]
        return subprocess.run(command, env=os.environ | WITHOUT, check=False).returncode
    return 0


if __name__ == "__main__":
    sys.exit(main())
