"""Every code block of the documentation runs, in the order of its page."""

import ast
import contextlib
import importlib
import importlib.util
import io
import json
import re
import shlex
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from bags import messages, type_store, write_bag

import rgbd_planes as rp
from bench.pictures import OTHERS, PICTURES, code_of
from bench.plots import PLOTS
from rgbd_planes.camera import presets
from rgbd_planes.cli import main as cli
from rgbd_planes.evaluation import scenes
from rgbd_planes.sequences import images

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OPTIONAL = {
    "import pandas": "pandas",
    "import yaml": "yaml",
    "rgbd-planes batch": "pyarrow",
    "fit_sequence": "pyarrow",
    "rosbag(": "rosbags",
    "plane_polygons": "shapely",
    "LiveView": "rerun",
}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The files that the pages speak of."""
    root = tmp_path_factory.mktemp("docs")
    camera = presets.primesense()
    depth = scenes.room().render(camera).measure(holes=0.05, patches=0.03, seed=1)
    images.write_png(root / "depth.png", depth)
    images.write_png(root / "demo_depth.png", depth)
    camera.save(root / "camera.json")
    pinhole = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    info = {"width": camera.width, "height": camera.height, "K": pinhole, "D": [0.0] * 5}
    (root / "camera_info.yaml").write_text(json.dumps(info))  # JSON is YAML
    (root / "frames").mkdir()
    images.write_png(root / "frames" / "1.png", depth)
    sequence = root / "rgbd_dataset_freiburg1_xyz"
    (sequence / "depth").mkdir(parents=True)
    freiburg = scenes.room().render(presets.tum_freiburg1())
    for i in range(4):
        images.write_png(sequence / "depth" / f"{i}.png", freiburg.measure(holes=0.05, seed=i))
    (sequence / "depth.txt").write_text("".join(f"{130.5 + i} depth/{i}.png\n" for i in range(4)))
    with contextlib.suppress(ModuleNotFoundError):
        import rosbags  # noqa: F401

        made, info = messages(type_store(root / "recording.bag")[0], [depth])
        topics = {"/camera/depth/image_raw": [(1, made[0])], "/camera/depth/camera_info": [(1, info)]}
        write_bag(root / "recording.bag", topics)
    return root


def blocks(page):
    return BLOCK.findall(page.read_text(encoding="utf-8"))


def test_the_readme_prints_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = dict(blocks(ROOT / "README.md"))
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(compile(page["python"], "README.md", "exec"), {"__name__": "__main__"})
    printed, said = (re.split(r"(\d+)", text.strip()) for text in (out.getvalue(), page["text"]))
    assert printed[::2] == said[::2]
    # Processors round differently: a tile more or less may be rough.
    np.testing.assert_allclose(np.array(printed[1::2], int), np.array(said[1::2], int), atol=3)
    assert (tmp_path / "planes.png").stat().st_size > 10_000


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p)], ids=lambda page: page.stem)
def test_the_code_blocks_run(page, files, monkeypatch):
    monkeypatch.chdir(files)
    text = page.read_text(encoding="utf-8")
    for words, library in OPTIONAL.items():
        if words in text:
            pytest.importorskip(library)
    namespace = {"__name__": "__main__"}
    for language, code in blocks(page):
        assert language in ("python", "bash", "text", "yaml"), f"a block of {language} is not run"
        if language == "python":
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile(code, str(page), "exec"), namespace)
        elif language == "bash":
            for line in code.splitlines():
                program, *arguments = shlex.split(line)
                assert program == "rgbd-planes"
                assert cli.main(arguments) == 0
        elif language == "yaml":
            assert isinstance(pytest.importorskip("yaml").safe_load(code), dict)


def printed(page, number, files, monkeypatch):
    """What the blocks of a page print as far as the given one."""
    monkeypatch.chdir(files)
    out, namespace = io.StringIO(), {}
    with contextlib.redirect_stdout(out):
        for language, code in blocks(ROOT / "docs" / page)[:number]:
            if language == "python":
                exec(code, namespace)
    return out.getvalue()


def test_what_the_page_on_calibration_says_comes_out(files, monkeypatch):
    lines = printed("howto/calibration.md", 5, files, monkeypatch).splitlines()
    assert "is it a colour image?" in lines[0]
    assert "is it transposed, or are the camera's width and height swapped?" in lines[1]
    number = r"([\d.]+)"
    right, wrong = (re.search(rf"at {number} degrees, largest residual {number}", line).groups() for line in lines[2:4])
    assert float(right[0]) == pytest.approx(90.0, abs=0.1)
    assert abs(float(wrong[0]) - 90.0) > 3.0
    assert float(right[1]) < 1e-4
    assert float(wrong[1]) < 1e-4
    exact, bent = (float(re.search(rf"up to {number} mm", line)[1]) for line in lines[4:6])
    assert exact < 0.005
    assert 0.5 < bent < 1.0
    bulge, depth = ([float(value) for value in re.findall(number, line)] for line in lines[6:8])
    assert bulge == pytest.approx([110.0, 0.1, 19.5], abs=0.5)
    assert depth == [0.0, 0.0, 0.0]


def test_what_the_page_on_bent_floors_says_comes_out(files, monkeypatch):
    text = printed("howto/bent-floors.md", 3, files, monkeypatch)
    assert float(re.search(r"two maps: ([\d.]+)", text)[1]) > 0.85
    flat = [float(value) for value in re.findall(r"flat to ([\d.]+) mm", text)]
    tilt = [float(value) for value in re.findall(r"up to ([\d.]+) degrees", text)]
    assert flat[1] < 0.35 * flat[0]
    assert tilt[1] < 0.45 * tilt[0]


def test_what_the_page_on_depth_formats_says_comes_out(files, monkeypatch):
    monkeypatch.chdir(files)
    out, page = io.StringIO(), {}
    with contextlib.redirect_stdout(out):
        for _, code in blocks(ROOT / "docs/howto/depth-formats.md"):
            exec(code, page)
    camera, depth = page["camera"], page["depth"]
    across = np.degrees(np.arctan(camera.tan_x[0, [0, -1]]) + np.array([-1.0, 1.0]) * 0.5 / camera.fx)
    assert across == pytest.approx([-45.0, 45.0], abs=0.1)
    codes = np.arange(65536, dtype=np.uint16)  # of millimetres
    assert np.array_equal(page["of_sun_rgbd"]((codes << 3) | (codes >> 13)), codes)
    colours = np.rint(depth.astype(float) / 1000.0 * (2**24 - 1)).astype("<u4").view(np.uint8).reshape(480, 640, 4)
    np.testing.assert_allclose(page["of_carla"](colours), depth, atol=1e-4)
    np.testing.assert_allclose(page["of_carla"](colours[..., [2, 1, 0, 3]][..., 2::-1]), depth, atol=1e-4)
    fx = camera.fx
    np.testing.assert_allclose(page["middlebury"].points(0.193 * fx / depth - 31.0)[..., 2], depth, rtol=1e-5)
    kitti = np.rint(256.0 * 0.54 * fx / depth).astype(np.uint16)
    np.testing.assert_allclose(page["kitti"].points(kitti)[..., 2], depth, rtol=1e-4)
    assert float(re.search(r"([\d.]+) ?% of the pixels", out.getvalue())[1]) > 99.0


def test_what_the_page_on_methods_says_comes_out(files, monkeypatch):
    ours, explicit, pca = (
        float(value) for value in re.findall(r"([\d.]+) degrees", printed("howto/methods.md", 1, files, monkeypatch))
    )
    assert pca > 2 * ours
    assert explicit > 2 * ours


def test_what_the_page_on_noise_says_comes_out(files, monkeypatch):
    lines = printed("howto/noise.md", 4, files, monkeypatch).splitlines()
    for line, true in zip(lines[-2:], (1500.0, 14.885), strict=True):
        value, deviation = (float(number) for number in re.findall(r"\d+\.\d+", line))
        assert 0.0 < deviation < 0.01 * true
        assert abs(value - true) < 3.0 * deviation


def test_what_the_page_on_normals_says_comes_out(files, monkeypatch):
    text = printed("howto/normals.md", 3, files, monkeypatch)
    rows = re.findall(r"(\d+) (True|False) +half within ([\d.]+) degrees, 90 % within ([\d.]+)", text)
    half = {(int(window), avoids): float(degrees) for window, avoids, degrees, _ in rows}
    most = {(int(window), avoids): float(degrees) for window, avoids, _, degrees in rows}
    assert half[15, "False"] < 0.4 * half[7, "False"]
    assert most[15, "False"] > most[7, "False"]
    assert most[15, "True"] < 0.4 * most[7, "True"] < 0.4 * most[7, "False"]
    text = printed("howto/normals.md", 4, files, monkeypatch)
    assert abs(float(re.search(r"moved by ([\d.]+) mm", text)[1]) - 50.0) < 0.5


def pictures(text):
    """The files of the pictures that a page shows."""
    return {Path(path).name for path in re.findall(r"!\[[^]]*\]\(\S*?(images/\w+\.\w+)\)", text)}


def test_every_picture_is_shown_and_something_draws_it():
    shown = {page: pictures(page.read_text(encoding="utf-8")) for page in [*PAGES, ROOT / "README.md"]}
    drawn = {f"{name}.png" for name in (*PICTURES, *PLOTS, "roofline")} | {file for file, _ in OTHERS.values()}
    assert set().union(*shown.values()) == {path.name for path in (ROOT / "docs/images").iterdir()} == drawn
    for name, (page, _) in PICTURES.items():
        assert code_of(name)
        assert f"{name}.png" in shown[ROOT / page] | shown[ROOT / "docs/tutorial.md"]


@pytest.mark.parametrize("page", [p for p in PAGES if p.stem != "reference"], ids=lambda page: page.stem)
def test_a_page_begins_with_a_picture(page):
    """Or has one after the first code; so the first screen shows what the page is about."""
    lines = page.read_text(encoding="utf-8").splitlines()
    assert pictures("\n".join(lines[:26])), f"expected a picture near the top of {page.name}"


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


def test_every_status_reason_method_and_column_is_explained():
    red = (ROOT / "docs/howto/red-tiles.md").read_text()
    assert all(f"`{status.name}`" in red for status in rp.TileStatus)
    segments = (ROOT / "docs/howto/segments.md").read_text()
    assert all(f"`{reason.name}`" in segments for reason in rp.Reason)
    shown = (ROOT / "docs/howto/methods.md").read_text()
    from rgbd_planes.fitting.methods import METHODS

    assert all(f"| `{method}`" in shown for method in METHODS)
    batch = (ROOT / "docs/howto/batch.md").read_text()
    rows = rp.fit_tiles(np.ones((4, 4)), rp.Camera(4, 4, 4.0, 4.0, 1.5, 1.5), tile=2).to_table()
    assert all(name in batch for name in rows)


@pytest.fixture
def equations(monkeypatch):
    """What replaces equations when the site is built; here by their text in angle brackets."""
    converter = ModuleType("latex2mathml.converter")
    converter.convert = lambda equation, display: f"<{equation}>"
    monkeypatch.setitem(sys.modules, "latex2mathml", ModuleType("latex2mathml"))
    monkeypatch.setitem(sys.modules, "latex2mathml.converter", converter)
    spec = importlib.util.spec_from_file_location("equations", ROOT / "docs/equations.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.on_page_markdown


def test_equations_go_on_in_the_next_line_and_end_with_the_paragraph(equations):
    assert equations("of $a +\nb$, and $c$") == "of <span><a +\nb></span>, and <span><c></span>"
    assert equations("$$a\n\nb$$ `$HOME`\n```bash\n$ ls\n```\n") == "<a\n\nb> `$HOME`\n```bash\n$ ls\n```\n"
    for text in ("it costs 5 $", "$a +\n\nb$", "$a$ and $b"):
        with pytest.raises(ValueError, match=r"one alone: '.*\$"):
            equations(text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_dollar_signs_of_every_page_pair_up(page, equations):
    equations(page.read_text(encoding="utf-8"))


def test_every_public_name_is_in_the_reference():
    reference = (ROOT / "docs/reference.md").read_text()
    entries = set(re.findall(r"^::: rgbd_planes\.([\w.]+)$", reference, re.MULTILINE))
    functions = {f"sequences.{name}" for name in rp.sequences.FORMATS}
    shown = entries | {".".join(entry.split(".")[::2]) for entry in entries if entry.startswith("sequences.")}
    shown |= {name for name, module in rp._MODULES.items() if module in entries}
    assert set(rp.__all__) - {"__version__", "sequences"} | functions <= shown
    assert {entry for entry in entries if "." not in entry} <= set(rp.__all__)


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_what_notebooks_take_from_the_library_is_there(path):
    # They run elsewhere, which takes minutes; a name that is gone shows at once.
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = ast.parse("\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"))
    names = {}
    for node in ast.walk(code):
        if isinstance(node, ast.Import):
            names |= {a.asname: importlib.import_module(a.name) for a in node.names if a.name == "rgbd_planes"}
        elif isinstance(node, ast.ImportFrom) and str(node.module).startswith("rgbd_planes"):
            module = importlib.import_module(node.module)
            names |= {a.asname or a.name: getattr(module, a.name) for a in node.names}
    chains = [ast.unparse(node).split(".") for node in ast.walk(code) if isinstance(node, ast.Attribute)]
    chains = [chain for chain in chains if chain[0] in names and all(part.isidentifier() for part in chain)]
    assert chains
    for first, *rest in chains:
        value = names[first]
        for name in rest:
            if not isinstance(value, ModuleType | type):
                break
            value = getattr(value, name)
