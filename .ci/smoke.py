"""What must work of an installed wheel, with nothing but its own dependencies; run outside the checkout."""

import importlib
import pkgutil
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

start = time.perf_counter()
import rgbd_planes as rp  # noqa: E402

seconds = time.perf_counter() - start
heavy = {"numba", "matplotlib", "pandas", "dask", "distributed", "pyarrow", "rosbags", "rerun", "open3d", "scipy"}
assert not heavy & set(sys.modules), heavy & set(sys.modules)
assert seconds < 0.5, f"import took {seconds:.2f} s"
assert Path(rp.__file__).is_relative_to(sys.prefix), f"not the installed one: {rp.__file__}"
assert version("rgbd-planes") == rp.__version__

for module in pkgutil.walk_packages(rp.__path__, "rgbd_planes."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
for name in rp.__all__:
    getattr(rp, name)
optional = heavy - {"numba", "matplotlib", "scipy"}
assert not optional & set(sys.modules), f"imported before use: {optional & set(sys.modules)}"

camera = rp.presets.kinect_v1()
rendering = rp.scenes.room().render(camera)
tiles = rp.fit_tiles(rendering.measure(seed=1), camera)
assert tiles.fitted.all(), tiles

out = Path(sys.argv[1])
command = [str(Path(sys.executable).with_name("rgbd-planes"))]
subprocess.run([*command, "demo", "--out", out], check=True)
fitted = subprocess.run(
    [*command, "fit", out / "demo_depth.png", "--camera", out / "demo_camera.json", "--out", out / "planes.npz"],
    check=True, capture_output=True, text=True,
)  # fmt: skip
assert "1200 tiles" in fitted.stdout, fitted.stdout
assert rp.TilePlanes.load(out / "planes.npz").shape == (30, 40)

# Without an extra, its command says what to install.
batch = subprocess.run([*command, "batch", out, "--out", out / "table"], capture_output=True, text=True)
assert batch.returncode == 2, batch
assert 'pip install "rgbd-planes[batch]"' in batch.stderr, batch.stderr
print("the wheel works")
