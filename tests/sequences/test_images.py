"""Depth frames from files: every value as it was stored, and a clear error for what is not a depth frame."""

import errno
import io
import os
import re
import struct
import subprocess
import sys
import threading
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from rgbd_planes._core import files
from rgbd_planes.sequences import images


def a_frame(dtype=np.uint16, shape=(37, 53)):
    generator = np.random.default_rng(7)
    if np.dtype(dtype).kind == "f":
        return generator.random(shape).astype(dtype)
    native = np.dtype(dtype).newbyteorder("=")
    return generator.integers(0, np.iinfo(dtype).max, shape, dtype=native, endpoint=True).astype(dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("suffix", [".png", ".PNG", ".tif", ".tiff"])
def test_images_come_back_as_they_were_stored(tmp_path, dtype, suffix):
    frame = a_frame(dtype)
    path = tmp_path / f"depth{suffix}"
    Image.fromarray(frame).save(path)
    read = images.read_depth(path)
    assert read.dtype == dtype
    assert np.array_equal(read, frame)


def test_float_tiff(tmp_path):
    frame = a_frame(np.float32)
    Image.fromarray(frame).save(tmp_path / "depth.tiff")
    assert np.array_equal(images.read_depth(tmp_path / "depth.tiff"), frame)


def test_big_endian_tiff(tmp_path):
    frame = a_frame()
    Image.frombytes("I;16B", frame.shape[::-1], frame.astype(">u2").tobytes()).save(tmp_path / "depth.tif")
    read = images.read_depth(tmp_path / "depth.tif")
    assert np.array_equal(read, frame)
    assert read.max() > 255


def packed(frame, bits):
    """Rows of numbers of less than a byte, each row from a byte on."""
    ones = (frame[..., None] >> np.arange(bits)[::-1]) & 1
    return np.packbits(ones.reshape(len(frame), -1), axis=1).tobytes()


def png(frame, bits):
    """A grey PNG image of so many bits."""

    def chunk(name, content):
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    height, width = frame.shape
    rows = np.frombuffer(packed(frame, bits), np.uint8).reshape(height, -1)
    pixels = zlib.compress(np.pad(rows, ((0, 0), (1, 0))).tobytes())
    header = struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


TAGS = {"photometric": 262, "fill_order": 266, "orientation": 274}


def tiff(frame, bits=None, *, compressed=False, **others):
    """A TIFF image of any kind of numbers, also of those that Pillow does not write."""
    pixels, order = frame.tobytes() if bits is None else packed(frame, bits), "<>"[frame.dtype.str[0] == ">"]
    (height, width), kind = frame.shape, "uif".index(frame.dtype.kind) + 1
    pixels = zlib.compress(pixels) if compressed else pixels
    tags = {256: width, 257: height, 258: bits or 8 * frame.itemsize, 259: 8 if compressed else 1, 262: 1, 273: 8}
    tags |= {277: 1, 278: height, 279: len(pixels), 339: kind} | {TAGS[name]: others[name] for name in others}
    entries = b"".join(struct.pack(f"{order}HHII", tag, 4, 1, value) for tag, value in sorted(tags.items()))
    header = (b"MM\0*" if order == ">" else b"II*\0") + struct.pack(f"{order}I", 8 + len(pixels))
    return header + pixels + struct.pack(f"{order}H", len(tags)) + entries + bytes(4)


@pytest.mark.parametrize("dtype", ["<u4", "<i4", ">i4", "<i2", ">i2", "i1", "<f4", ">f4", "<u2", ">u2", "u1"])
def test_numbers_of_a_tiff_keep_their_values(tmp_path, dtype):
    frame = a_frame(dtype)
    if frame.dtype.kind == "i":
        frame[0] = -frame[0]
    (tmp_path / "depth.tif").write_bytes(tiff(frame))
    read = images.read_depth(tmp_path / "depth.tif")
    assert np.array_equal(read, frame)
    assert read.dtype.kind == frame.dtype.kind


@pytest.mark.parametrize("bits", [2, 4])
def test_numbers_of_less_than_a_byte_keep_their_values(tmp_path, bits):
    frame = a_frame(np.uint8) >> (8 - bits)  # few labels, which a program that saves room stores so
    (tmp_path / "labels.png").write_bytes(png(frame, bits))
    (tmp_path / "labels.tif").write_bytes(tiff(frame, bits))
    assert np.array_equal(images.read_depth(tmp_path / "labels.png"), frame)
    assert np.array_equal(images.read_depth(tmp_path / "labels.tif"), frame)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("bits", [2, 4, 8, 16])
def test_a_tiff_whose_zero_is_white_keeps_its_values(tmp_path, bits, compressed):
    frame = a_frame() if bits == 16 else a_frame(np.uint8) >> (8 - bits)
    stored = tiff(frame, bits if bits < 8 else None, compressed=compressed, photometric=0)
    (tmp_path / "depth.tif").write_bytes(stored)
    assert np.array_equal(images.read_depth(tmp_path / "depth.tif"), frame)


@pytest.mark.parametrize("bits", [2, 4, 8])
def test_a_tiff_with_its_bits_in_reverse_keeps_its_values(tmp_path, bits):
    frame = a_frame(np.uint8) >> (8 - bits)
    reverse = np.packbits(np.unpackbits(np.frombuffer(packed(frame, bits), np.uint8), bitorder="little"))
    stored = tiff(frame, bits, fill_order=2).replace(packed(frame, bits), reverse.tobytes())
    (tmp_path / "depth.tif").write_bytes(stored)
    assert np.array_equal(images.read_depth(tmp_path / "depth.tif"), frame)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("dtype", ["u1", "<u2", "<f4"])
def test_a_tiff_that_is_to_be_turned_is_refused(tmp_path, dtype, compressed):
    frame = a_frame(dtype)
    for orientation in range(9):
        (tmp_path / "depth.tif").write_bytes(tiff(frame, compressed=compressed, orientation=orientation))
        if orientation < 2:  # 0 says nothing
            assert np.array_equal(images.read_depth(tmp_path / "depth.tif"), frame)
            continue
        with pytest.raises(ValueError, match=rf"turned or mirrored \(Orientation {orientation}\): save it upright"):
            images.read_depth(tmp_path / "depth.tif")


@pytest.mark.parametrize("dtype", ["<i4", ">i4", "<i2", ">i2", "<f4", ">f4", "<u2", ">u2", "u1"])
def test_numbers_of_a_compressed_tiff_keep_their_values_or_are_an_error(tmp_path, dtype):
    frame = a_frame(dtype)
    (tmp_path / "depth.tif").write_bytes(tiff(frame, compressed=True))
    refused = None
    try:
        assert np.array_equal(images.read_depth(tmp_path / "depth.tif"), frame)
    except ValueError as error:
        refused = str(error)
    if refused is not None:  # which of them Pillow reads right depends on its version
        assert dtype in (">i4", ">i2", ">f4")
        kind = np.dtype(dtype).name
        assert f"big-endian {kind}, which Pillow misreads: save it little-endian" in refused


@pytest.mark.parametrize("dtype", ["<f8", ">f8", "<f2", ">f2", ">u4", "<u8", "<i8"])
def test_a_tiff_that_pillow_does_not_read_is_not_called_damaged(tmp_path, dtype):
    (tmp_path / "depth.tif").write_bytes(tiff(a_frame(dtype)))
    kind = np.dtype(dtype).name
    with pytest.raises(ValueError, match=rf"depth\.tif: a TIFF image of {kind}, .*save float32 or uint16, or NPY"):
        images.read_depth(tmp_path / "depth.tif")


@pytest.mark.parametrize("largest", [200, 255, 256, 2047, 10000, 65535])
@pytest.mark.parametrize("plain", [False, True])
def test_pgm_is_not_stretched_to_its_largest_value(tmp_path, largest, plain):
    frame = (a_frame().astype(int) % (largest + 1)).astype(np.uint16)
    header = f"P{2 if plain else 5}\n# made by a test\n{frame.shape[1]} {frame.shape[0]}\n# 1/1000 m\n{largest}\n"
    stored = frame.astype("u1" if largest < 256 else ">u2").tobytes()
    if plain:
        stored = "\n".join(" ".join(map(str, row)) for row in frame).encode()
    (tmp_path / "depth.pgm").write_bytes(header.encode() + stored)
    read = images.read_depth(tmp_path / "depth.pgm")
    assert read.dtype == (np.uint8 if largest < 256 else np.uint16)
    assert np.array_equal(read, frame)


@pytest.mark.parametrize("largest", [255, 65535])
@pytest.mark.parametrize("first", [ord("\n"), 7])
def test_pgm_headers_of_windows(tmp_path, largest, first):
    frame = np.full((2, 3), first, "u1" if largest < 256 else "<u2")
    if largest > 255:
        frame = frame << 8  # so that the first byte is that one
    pixels = frame.astype(frame.dtype.newbyteorder(">")).tobytes()
    for end in ("\r\n", "\r", "\n"):
        header = end.join(["P5", "3 2", str(largest), ""])
        (tmp_path / "depth.pgm").write_bytes(header.encode() + pixels)
        assert np.array_equal(images.read_depth(tmp_path / "depth.pgm"), frame)


def pfm(frame, order="<", end="\n"):
    height, width = frame.shape
    header = end.join(["Pf", f"{width} {height}", f"{'-' if order == '<' else ''}0.003922", ""])
    return header.encode() + frame[::-1].astype(f"{order}f4").tobytes()


@pytest.mark.parametrize("end", ["\n", "\r\n", " "])
@pytest.mark.parametrize("order", ["<", ">"])
def test_pfm(tmp_path, order, end):
    frame = a_frame(np.float32)
    frame[3, 4:6] = np.inf, np.nan
    (tmp_path / "disparity.pfm").write_bytes(pfm(frame, order, end))
    read = images.read_depth(tmp_path / "disparity.pfm")
    assert read.dtype == np.float32
    assert read.dtype.isnative
    assert np.array_equal(read, frame, equal_nan=True)
    (tmp_path / "disparity.pfm").write_bytes(pfm(frame, order).replace(b"Pf", b"PF", 1))
    with pytest.raises(ValueError, match="colour image"):
        images.read_depth(tmp_path / "disparity.pfm")


def test_pfm_is_as_pillow_has_it(tmp_path):
    pytest.importorskip("PIL", "10.3")
    (tmp_path / "disparity.pfm").write_bytes(pfm(a_frame(np.float32)))
    with Image.open(tmp_path / "disparity.pfm") as image:
        assert np.array_equal(images.read_depth(tmp_path / "disparity.pfm"), np.array(image))


@pytest.mark.parametrize("index", [np.s_[..., None], np.s_[None], np.s_[None, None], np.s_[None, ..., None]])
def test_the_axis_of_the_one_channel_is_left_out(tmp_path, index):
    frame = a_frame(np.float32)
    np.save(tmp_path / "depth.npy", frame[index])
    np.savez(tmp_path / "depth.npz", frame[index])
    for name in ("depth.npy", "depth.npz"):
        read = images.read_depth(tmp_path / name)
        assert read.dtype == frame.dtype
        assert np.array_equal(read, frame)


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.float32, np.float64])
def test_arrays_come_back_as_they_were_stored(tmp_path, dtype):
    frame = a_frame(dtype)
    np.save(tmp_path / "depth.npy", frame)
    np.savez(tmp_path / "plain.npz", frame)
    np.savez_compressed(tmp_path / "named.npz", depth=frame)
    for name in ("depth.npy", "plain.npz", "named.npz"):
        read = images.read_depth(tmp_path / name)
        assert read.dtype == dtype
        assert np.array_equal(read, frame)


@pytest.mark.parametrize("dtype", [bool, complex, "U1", "S1", "M8[s]", "m8[s]", "V8", [("z", "f4")]])
def test_arrays_of_no_numbers_of_depth_are_refused(tmp_path, dtype):
    frame = np.zeros((3, 4), dtype)
    np.save(tmp_path / "depth.npy", frame)
    np.savez(tmp_path / "depth.npz", frame)
    for name in ("depth.npy", "depth.npz"):
        expected = f"{name}: expected a depth image of integers or floats, got dtype {frame.dtype}"
        with pytest.raises(ValueError, match=re.escape(expected)):
            images.read_depth(tmp_path / name)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, ">u2"])
def test_write_png_comes_back(tmp_path, dtype):
    frame = a_frame(dtype)
    images.write_png(tmp_path / "depth.png", frame[:, ::2])
    assert np.array_equal(images.read_depth(tmp_path / "depth.png"), frame[:, ::2])
    with pytest.raises(ValueError, match="uint8 or uint16"):
        images.write_png(tmp_path / "other.png", frame.astype(np.int32))
    with pytest.raises(ValueError, match=r"ends in \.png"):
        images.write_png(tmp_path / "other.jpg", frame)
    assert os.listdir(tmp_path) == ["depth.png"]


def test_missing_file_and_unknown_suffix(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.png: there is no such file"):
        images.read_depth(tmp_path / "gone.png")
    for name in ("depth.jpg", "depth"):
        (tmp_path / name).touch()
        with pytest.raises(ValueError, match=r"must be one of \.png, \.tif.*numpy\.save"):
            images.read_depth(tmp_path / name)
    for folder in (tmp_path, tmp_path / "folder.png"):
        folder.mkdir(exist_ok=True)
        with pytest.raises(ValueError, match="got a folder"):
            images.read_depth(folder)
    with pytest.raises(ValueError, match="got a device"):
        images.read_depth(os.devnull)


def encoded(suffix):
    frame, buffer = a_frame(), io.BytesIO()
    if suffix == ".pgm":
        return f"P5 {frame.shape[1]} {frame.shape[0]} 65535\n".encode() + frame.astype(">u2").tobytes()
    if suffix == ".pfm":
        return pfm(frame)
    if suffix == ".npy":
        np.save(buffer, frame)
    elif suffix == ".npz":
        np.savez_compressed(buffer, depth=frame)
    else:
        Image.fromarray(frame).save(buffer, {".png": "PNG", ".tif": "TIFF"}[suffix])
    return buffer.getvalue()


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm", ".pfm", ".npy", ".npz"])
@pytest.mark.filterwarnings("ignore:Corrupt EXIF data")  # what Pillow says on top
@pytest.mark.parametrize("share", [0.0, 0.002, 0.01, 0.1, 0.5, 0.9])
def test_a_truncated_file_is_an_error_that_names_it(tmp_path, suffix, share):
    whole = encoded(suffix)
    (tmp_path / f"depth{suffix}").write_bytes(whole)
    assert np.array_equal(images.read_depth(tmp_path / f"depth{suffix}"), a_frame())
    (tmp_path / f"depth{suffix}").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match=rf"depth\{suffix}: "):
        images.read_depth(tmp_path / f"depth{suffix}")


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm", ".pfm", ".npy", ".npz"])
@pytest.mark.filterwarnings("ignore")  # what libraries say on top
def test_a_file_with_some_bytes_wrong_is_read_or_an_error_that_names_it(tmp_path, suffix):
    path, whole, rng = tmp_path / f"depth{suffix}", encoded(suffix), np.random.default_rng(0)
    for _ in range(200):
        wrong = bytearray(whole)
        for place in rng.integers(0, min(len(whole), 200), 4):
            wrong[place] = rng.integers(256)
        path.write_bytes(wrong)
        said = str(path)
        try:
            images.read_depth(path)
        except ValueError as error:
            said = str(error)
        assert str(path) in said


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm", ".pfm", ".npy", ".npz"])
def test_a_file_of_another_format(tmp_path, suffix):
    Image.fromarray(a_frame(np.uint8)).save(tmp_path / "image.jpg")
    (tmp_path / f"depth{suffix}").write_bytes((tmp_path / "image.jpg").read_bytes())
    with pytest.raises(ValueError, match=rf"depth\{suffix}: "):
        images.read_depth(tmp_path / f"depth{suffix}")


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "LA", "P", "1"])
def test_colour_and_palette_images_are_no_depth(tmp_path, mode):
    Image.new(mode, (8, 6)).save(tmp_path / "colour.png")
    with pytest.raises(ValueError, match="colour") as error:
        images.read_depth(tmp_path / "colour.png")
    assert ("PIL.Image.open(path)" in str(error.value)) == (mode == "P")


def test_several_images_or_arrays(tmp_path):
    pages = [Image.fromarray(a_frame()) for _ in range(2)]
    pages[0].save(tmp_path / "pages.tif", save_all=True, append_images=pages[1:])
    with pytest.raises(ValueError, match="2 images"):
        images.read_depth(tmp_path / "pages.tif")
    np.savez(tmp_path / "two.npz", depth=a_frame(), confidence=a_frame())
    with pytest.raises(ValueError, match="got 2: depth, confidence"):
        images.read_depth(tmp_path / "two.npz")
    np.savez(tmp_path / "none.npz")
    with pytest.raises(ValueError, match="got 0"):
        images.read_depth(tmp_path / "none.npz")
    with zipfile.ZipFile(tmp_path / "text.npz", "w") as archive:
        archive.writestr("readme.txt", "x")
    with pytest.raises(ValueError, match=r"expected an NPZ file with one array, got readme\.txt, which is none"):
        images.read_depth(tmp_path / "text.npz")
    np.save(tmp_path / "colour.npy", np.zeros((4, 5, 3)))
    with pytest.raises(ValueError, match=r"\(4, 5, 3\)"):
        images.read_depth(tmp_path / "colour.npy")
    np.save(tmp_path / "empty.npy", np.zeros((0, 5)))
    with pytest.raises(ValueError, match=r"\(0, 5\)"):
        images.read_depth(tmp_path / "empty.npy")
    (tmp_path / "negative.pgm").write_bytes(b"P2 2 1 255\n3 -4\n")
    with pytest.raises(ValueError, match="numbers from 0 to 255"):
        images.read_depth(tmp_path / "negative.pgm")
    for kind, name in (("P5", "digits.pgm"), ("Pf", "digits.pfm")):
        (tmp_path / name).write_text(f"{kind} {'9' * 5000} 3 65535\nabc")
        with pytest.raises(ValueError, match=rf"{name}: not a P[GF]M image.*, or damaged"):
            images.read_depth(tmp_path / name)
    (tmp_path / "deep.pgm").write_bytes(b"P5 2 1 70000\n" + bytes(8))
    with pytest.raises(ValueError, match="got 70000"):
        images.read_depth(tmp_path / "deep.pgm")


@pytest.mark.parametrize("suffix", [".png", ".tif", ".npy", ".npz"])
def test_an_image_that_asks_for_too_much_memory_is_damaged_unless_memory_is_short(tmp_path, monkeypatch, suffix):
    def fail(*arguments, **options):
        raise MemoryError("Unable to allocate 76.3 MiB")

    path = tmp_path / f"depth{suffix}"
    path.write_bytes(encoded(suffix))
    monkeypatch.setattr(np.lib.format, "read_array", fail)
    monkeypatch.setattr(Image, "open", fail)
    with pytest.raises(ValueError, match=rf"depth\{suffix}: damaged .* \(Unable to allocate 76.3 MiB\)"):
        images.read_depth(path)
    monkeypatch.setattr(files, "_MORE_THAN_A_FRAME", 2**62)  # as if nothing were free
    with pytest.raises(MemoryError):
        images.read_depth(path)


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_an_array_larger_than_its_file_is_damaged_and_not_short_of_memory(tmp_path, suffix):
    path, header = tmp_path / f"depth{suffix}", io.BytesIO()
    about = {"descr": "<u2", "fortran_order": False, "shape": (160_000_000, 12_000_000)}
    np.lib.format.write_array_header_1_0(header, about)
    if suffix == ".npy":
        path.write_bytes(header.getvalue())
    else:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("depth.npy", header.getvalue())
    with pytest.raises(ValueError, match=r"depth\.np[yz]: damaged .*128 bytes for an array of shape \(160000000, "):
        images.read_depth(path)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_a_png_with_more_pixels_than_its_bytes_can_hold_is_damaged(tmp_path):
    """Pillow would make a gigabyte of one of 190 bytes."""
    stream = io.BytesIO()
    Image.new("I;16", (8, 6)).save(stream, format="PNG")
    content = bytearray(stream.getvalue())
    content[16:24] = struct.pack(">II", 8, 4_000_000)
    content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
    (tmp_path / "depth.png").write_bytes(content)
    with pytest.raises(ValueError, match=r"depth\.png: damaged .* \(\d+ bytes for 8 x 4000000 pixels\)"):
        images.read_depth(tmp_path / "depth.png")
    Image.new("1", (20_000, 1_600)).save(tmp_path / "empty.png", compress_level=9)  # as small as there is
    with pytest.raises(ValueError, match="got a black-and-white image"):
        images.read_depth(tmp_path / "empty.png")


def test_pickled_arrays_are_not_executed(tmp_path):
    np.save(tmp_path / "depth.npy", np.array([[{"a": 1}]], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="got one of Python objects"):
        images.read_depth(tmp_path / "depth.npy")


def test_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "file.txt"
    with files.write_beside(path) as beside:
        assert beside.suffix == ".txt"
        beside.write_text("first")
        assert not path.exists()
    assert path.read_text() == "first"

    def fail():
        with files.write_beside(path) as half:
            half.write_text("sec")
            raise RuntimeError("disk on fire")

    with pytest.raises(RuntimeError, match="disk on fire"):
        fail()
    assert path.read_text() == "first"
    assert os.listdir(tmp_path) == ["file.txt"]


def test_what_cannot_be_written_is_named(tmp_path):
    """The system's error of a full disk names no file."""
    path = tmp_path / "file.txt"
    with pytest.raises(OSError, match=r"No space left on device: '.*/file\.txt'"), files.write_beside(path):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert os.listdir(tmp_path) == []


def test_what_a_library_says_of_a_full_disk_names_the_file(tmp_path):
    """NumPy's own error has no number of the system's, and said "[Errno None] None"."""
    path = tmp_path / "file.txt"
    with pytest.raises(OSError, match=r"^cannot write .*file\.txt: 9 requested and 3 written$"):  # noqa: SIM117
        with files.write_beside(path):
            raise OSError("9 requested and 3 written")
    with pytest.raises(FileNotFoundError, match=r"^0\.png: there is no such file$"), files.write_beside(path):
        raise FileNotFoundError("0.png: there is no such file")
    assert not any(tmp_path.iterdir())


def test_a_name_as_long_as_a_name_can_be_is_written(tmp_path):
    for letter in "ab":  # and names that differ only in the end are two files
        path = tmp_path / ("x" * 240 + f"{letter}.json")
        with files.write_beside(path) as beside, files.write_beside(tmp_path / ("x" * 240 + "c.json")) as other:
            assert beside != other
            beside.write_text(letter)
            other.write_text("c")
    assert [path.read_text() for path in sorted(tmp_path.iterdir())] == ["a", "b", "c"]


def test_an_error_names_the_file_and_not_the_one_beside(tmp_path):
    path = tmp_path / "planes.json"
    with pytest.raises(FileNotFoundError, match=r"'.*/planes\.json'"), files.write_beside(path) as beside:
        beside.read_text()


def test_what_may_not_be_read_is_not_said_to_be_damaged(tmp_path, monkeypatch):
    def locked(self, *arguments, **options):
        raise PermissionError(errno.EACCES, "Permission denied", str(self))

    images.write_png(tmp_path / "depth.png", a_frame())
    monkeypatch.setattr(Path, "open", locked)
    with pytest.raises(PermissionError, match=r"depth\.png"):
        images.read_depth(tmp_path / "depth.png")


def test_writing_through_a_link_keeps_the_link(tmp_path, link):
    (tmp_path / "real.txt").write_text("old")
    link(tmp_path / "link.txt", "real.txt")
    with files.write_beside(tmp_path / "link.txt") as beside:
        beside.write_text("new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real.txt").read_text() == "new"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_written_to_and_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    received = []
    reader = threading.Thread(target=lambda: received.append(pipe.read_text()))
    reader.start()
    with files.write_beside(pipe) as target:
        target.write_text("through")
    reader.join()
    assert received == ["through"]
    assert pipe.is_fifo()


@pytest.mark.skipif(not os.path.exists("/dev/stdout"), reason="this system has no /dev/stdout")
def test_the_output_is_written_to_where_it_is_a_pipe():
    write = (
        "from rgbd_planes._core import files\n"
        "with files.write_beside('/dev/stdout') as target: target.write_text('out')"
    )
    made = subprocess.run([sys.executable, "-c", write], stdout=subprocess.PIPE, check=True)
    assert made.stdout == b"out"


@pytest.mark.skipif(os.name != "posix", reason="this system has other permissions")
def test_permissions_are_kept(tmp_path):
    (tmp_path / "secret.json").write_text("old")
    (tmp_path / "secret.json").chmod(0o600)
    with files.write_beside(tmp_path / "secret.json") as beside:
        beside.write_text("new")
    assert (tmp_path / "secret.json").stat().st_mode & 0o777 == 0o600


def test_what_follows_the_last_dot_of_a_name_may_be_long(tmp_path):
    with files.write_beside(tmp_path / ("a." + "x" * 240)) as beside:
        beside.write_text("new")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["new"]


def test_places_that_cannot_be_written(tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        files.check_writable(tmp_path / "none" / "file.png")
    with pytest.raises(IsADirectoryError, match="it is a folder"):
        files.check_writable(tmp_path)
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # for root everything is writable
    with pytest.raises(PermissionError, match="permission denied"):
        files.check_writable(tmp_path / "file.png")


def test_threads_that_write_one_file_do_not_write_into_each_others(tmp_path):
    together, errors = threading.Barrier(2), []

    def write(text):
        try:
            with files.write_beside(tmp_path / "a.txt") as beside:
                together.wait(60)
                beside.write_text(text)
                together.wait(60)
                assert beside.read_text() == text
                together.wait(60)
        except BaseException as error:
            errors.append(error)
            together.abort()

    threads = [threading.Thread(target=write, args=(text,)) for text in ("one", "another")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    assert (tmp_path / "a.txt").read_text() in ("one", "another")
    assert os.listdir(tmp_path) == ["a.txt"]


def test_nonsense_that_asks_for_much_memory_is_told_from_memory_that_is_short(monkeypatch):
    """A library asks for as many bytes as the file says."""
    with (
        pytest.raises(ValueError, match=r"a\.mcap: not a bag, or damaged \(MemoryError\)"),
        files.readable("a.mcap", "a bag"),
    ):
        bytearray(2**62)
    monkeypatch.setattr(files, "_MORE_THAN_A_FRAME", 2**62)  # as if nothing were free
    with pytest.raises(MemoryError), files.readable("a.mcap", "a bag"):
        bytearray(2**62)


def test_what_a_library_says_of_a_damaged_file_is_one_line():
    with (
        pytest.raises(ValueError, match=r"^a\.bag: not a bag, or damaged \(no index at 7\)$"),
        files.readable("a.bag", "a bag"),
    ):
        raise RuntimeError("no index\n  at 7\n")


def test_a_recording_is_for_batches(tmp_path):
    (tmp_path / "a.BAG").touch()
    with pytest.raises(ValueError, match=r"a\.BAG: expected one depth image, got a recording .`rgbd-planes batch`"):
        images.read_depth(tmp_path / "a.BAG")


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("LA", r"got grey with transparency \(mode LA\): if its first channel is depth"),
        ("RGBA", r"got a colour image with transparency \(mode RGBA\)"),
        ("P", "got a palette image"),
    ],
)
def test_images_of_other_modes_are_called_what_they_are(tmp_path, mode, words):
    Image.new(mode, (8, 6)).save(tmp_path / "a.png")
    with pytest.raises(ValueError, match=words):
        images.read_depth(tmp_path / "a.png")


def test_arrays_of_objects_are_not_damaged(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{"depth": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match=r"got one of Python objects, .*: save the depth itself") as told:
        images.read_depth(tmp_path / "a.npy")
    assert "damaged" not in str(told.value)
