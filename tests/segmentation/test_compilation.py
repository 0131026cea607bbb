"""The kernels of a segmentation, compiled side by side before they are called."""

from processes import printed_by

USES = """
import numba, numpy as np
from rgbd_planes import Camera, scenes, segment
from rgbd_planes.segmentation import compilation, segment as module
module.compile_for = lambda frame: None
camera = Camera(160, 120, 140.0, 140.0, 79.5, 59.5, (0.1, -0.05, 0.0, 0.0), depth_scale=1000.0)
segment(scenes.room().render(camera).measure(holes=0.1, patches=0.05), camera)
calls = compilation._calls("<u2", False) + compilation._more_calls("<u2")
for _, kernel, arguments in calls:
    if tuple(map(numba.typeof, arguments)) not in kernel.overloads and kernel.overloads:
        print(kernel.py_func.__name__)
print(len(calls))
"""


def test_kernels_are_compiled_for_the_types_that_they_are_called_with():
    """Otherwise they would be compiled twice, the second time by one process."""
    assert int(printed_by(USES)) > 20


HELP = """
from rgbd_planes.segmentation import compilation
done = []
with compilation._helping("<u2", False, False, [[20, 21], [22]], done.append):
    pass
print(sorted(done) == [20, 21, 22])
"""


def test_other_processes_compile_their_shares():
    assert printed_by(HELP).strip() == "True"


ALONE = """
import sys
from rgbd_planes.segmentation import compilation
print(compilation._processes(3), end=" ")
sys.executable = "/usr/bin/robot"
print(compilation._processes(23), end=" ")
sys.executable = None
print(compilation._processes(23))
"""


def test_no_process_is_started_for_little_or_within_another_program():
    assert printed_by(ALONE).split() == ["1", "1", "1"]
