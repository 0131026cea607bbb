"""What every format is reduced to: a list that describes the frames, and a function that reads one of them."""

import os
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.checks import each_of, number
from rgbd_planes._core.text import counted, shown
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.camera.frame import Frame
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.sequences.frame_steps import FloatUnit, Masked, Step, after, masks_of, swapped_bytes
from rgbd_planes.sequences.images import read_depth


@dataclass(frozen=True)
class FrameEntry:
    """A frame that has not been read yet: a `Frame` with a location instead of its depth."""

    name: str
    timestamp: float
    camera: Camera
    location: Any
    pose: NDArray[np.float64] | None = field(default=None, compare=False)


class FrameSequence(Sequence[Frame]):
    """The depth frames of a recording: ``len``, an index, a slice, a loop.

    An index reads one frame; a slice reads none and is a sequence again. It can be pickled: it only holds where the
    frames are.

    Parameters
    ----------
    entries : iterable of FrameEntry
    read : callable
        Takes an entry's location, returns its (H, W) depth as stored; a function of a module.

    Raises
    ------
    TypeError
        An entry is not a `FrameEntry`, its name not a string, its timestamp not a number, its camera not a `Camera`, or
        `read` not a function.
    """

    _steps: tuple[Step, ...] = ()
    _calibration = ""  # where a camera comes from that the files do not state

    def __init__(self, entries: Iterable[FrameEntry], read: Callable[[Any], NDArray[Any]]) -> None:
        self.entries: tuple[FrameEntry, ...] = tuple(each_of(entries))
        self._read = read
        for entry in self.entries:
            if not isinstance(entry, FrameEntry):
                raise TypeError(f"expected entries as FrameEntry(...), got {type(entry).__name__}")
            if not isinstance(entry.name, str):
                raise TypeError(f"expected the name of a FrameEntry as a string, got {entry.name!r}")
            number("the timestamp of a FrameEntry", entry.timestamp, finite=False)
        if not callable(read):
            raise TypeError(f"expected read as a function of a location, got {type(read).__name__}")
        for camera in {id(entry.camera): entry.camera for entry in self.entries}.values():
            check_camera(camera)

    def __len__(self) -> int:
        return len(self.entries)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> "FrameSequence": ...
    def __getitem__(self, index: int | slice) -> "Frame | FrameSequence":
        if isinstance(index, slice):
            part = copy(self)  # whose entries are checked already: a batch takes many parts
            part.entries = self.entries[index]
            return part
        try:
            entry = self.entries[index]
        except TypeError:
            raise TypeError(f"expected the number of a frame, or a slice, got {index!r}") from None
        except IndexError:
            raise IndexError(f"expected the number of one of {len(self)} frames, got {index}") from None
        frame = Frame(self._read(entry.location), entry.camera, entry.timestamp, entry.name, entry.pose)
        for step in self._steps:
            frame = after(step, frame)
        return frame

    def __iter__(self) -> Iterator[Frame]:
        # Sequence's own takes an IndexError of the reader for the end.
        return (self[i] for i in range(len(self)))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the frames."""
        return tuple(entry.name for entry in self.entries)

    @property
    def timestamps(self) -> NDArray[np.float64]:
        """(F,) float64, s: times of the frames, NaN where the recording states none."""
        return np.array([entry.timestamp for entry in self.entries], np.float64)

    @property
    def camera(self) -> Camera:
        """The camera of the first frame; in most data sets that of all frames.

        Raises
        ------
        IndexError
            There is no frame.
        """
        if not self.entries:
            raise IndexError("expected at least one frame, got none: no camera is known")
        return self.entries[0].camera

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The different cameras, in the order in which they first occur."""
        objects = {id(entry.camera): entry.camera for entry in self.entries}  # few: faster than comparing all of them
        return tuple(dict.fromkeys(objects.values()))

    def with_noise(self, noise: NoiseModel | None) -> "FrameSequence":
        """The same frames, whose cameras have a noise model (`rgbd_planes.noise`)."""
        return self.with_cameras({camera: camera.with_noise(noise) for camera in self.cameras})

    def with_cameras(self, cameras: Mapping[Camera, Camera]) -> "FrameSequence":
        """The same frames, with another camera for each of the sequence's own."""
        made = copy(self)
        made.entries = tuple(replace(e, camera=cameras[e.camera]) for e in self.entries)
        return made

    def map(self, function: Callable[[Frame], Frame | ArrayLike]) -> "FrameSequence":
        """The same frames, each as a function makes it of what was read.

        Parameters
        ----------
        function : callable
            Takes a `Frame`; returns one, or its new depth, (H, W). A function of a module can be used by the processes
            of a batch, and a batch can be resumed with it.

        Returns
        -------
        FrameSequence

        Examples
        --------
        A sensor that is mounted upside down:

        >>> upright = sequence.map(lambda frame: frame.rotated(180))
        """
        if not callable(function):
            raise TypeError(f"expected a function of a Frame, got {type(function).__name__}")
        made = copy(self)
        made._steps = (*self._steps, function)
        return made

    def masked(self, folder: str | os.PathLike[str], threshold: float = 1.0) -> "FrameSequence":
        """The same frames without the pixels in which a mask, or an image of confidence, is below a threshold.

        Parameters
        ----------
        folder : folder
            With an image for each frame, of the frame's name, or with the numbers of its name.
        threshold : float
            What a pixel needs at least: 1 of masks that are 0 where depth is wrong, 2 of a confidence of 0, 1 and 2.

        Returns
        -------
        FrameSequence

        Raises
        ------
        NotADirectoryError, ValueError
            It is no folder, or has no image for a frame. A mask of another size is an error when its frame is read.
        """
        least = number("threshold", threshold)
        return self.map(Masked(masks_of(self.names, existing_folder(folder)), least))

    def with_float_scale(self, float_scale: float) -> "FrameSequence":
        """The same frames, of which those of floats hold so many units per metre, 1000 for millimetres, not metres."""
        return self.map(FloatUnit(float_scale))

    def with_swapped_bytes(self) -> "FrameSequence":
        """The same frames, with the two bytes of their integers in the other order."""
        return self.map(swapped_bytes)

    def __repr__(self) -> str:
        if not self.entries:
            return "<FrameSequence: no frames>"
        cameras = len(self.cameras)
        size = f"{cameras} cameras" if cameras > 1 else f"{self.camera.width} x {self.camera.height} pixels"
        frames = counted(len(self), "frame")
        by = f", {self._calibration}" if self._calibration else ""
        first, last = shown(self.entries[0].name), shown(self.entries[-1].name)
        return f"<FrameSequence: {frames}, {size}, {first} to {last}{by}>"


def image_sequence(
    files: Iterable[Path],
    camera: Camera,
    root: Path,
    timestamps: Iterable[float] | None = None,
    poses: Iterable[NDArray[np.float64] | None] | None = None,
    *,
    calibration: str = "",
) -> FrameSequence:
    """A sequence of image files of one camera, named by their paths, below `root` if they are there.

    ``calibration`` says in the sequence's repr where the camera comes from, if the files do not state it.
    """
    paths = list(files)
    times = [float("nan")] * len(paths) if timestamps is None else timestamps
    known = [None] * len(paths) if poses is None else poses
    entries = [
        FrameEntry(_name(path, root), time, camera, path, pose)
        for path, time, pose in zip(paths, times, known, strict=True)
    ]
    sequence = FrameSequence(entries, read_depth)
    sequence._calibration = calibration
    return sequence


def _name(path: Path, root: Path) -> str:
    name = (path.relative_to(root) if path.is_relative_to(root) else path).as_posix()
    # A table holds Unicode, and a name on disk may be bytes that are none, as from a system of another encoding.
    return name.encode(errors="backslashreplace").decode()


def check_sequence(sequence: Any) -> None:
    """Refuse all but a sequence that has frames."""
    if not isinstance(sequence, FrameSequence):
        raise TypeError(f"expected a FrameSequence, which open_sequence makes, got {type(sequence).__name__}")
    if len(sequence) == 0:
        raise ValueError("expected a sequence with frames, got none")


def kept_open() -> threading.local:
    """A place for what each thread keeps open; empty in a forked child, which would share a file's position."""
    place = threading.local()
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=lambda: place.__dict__.clear())
    return place


def numbered(paths: Iterable[Path]) -> list[Path]:
    """Paths in the order of the numbers in their names, 9.png before 10.png, without hidden ones.

    macOS leaves a ._9.png beside each 9.png on disks of other systems: it is no image.
    """
    return sorted(
        (path for path in paths if not path.name.startswith(".")),
        key=lambda path: [
            (1, int(part), part) if part.isdecimal() else (0, 0, part) for part in re.split(r"(\d+)", path.name)
        ],
    )


def existing_folder(path: Any) -> Path:
    """The absolute path, if it is a folder: frames are read later, perhaps by other processes."""
    folder = Path(path).absolute()
    if not folder.is_dir():
        raise NotADirectoryError(f"{shown(path)}: expected a folder")
    if not os.access(folder, os.R_OK | os.X_OK):
        raise PermissionError(f"{shown(path)}: permission denied")
    return folder


def some(paths: list[Path], expected: str, root: Path) -> list[Path]:
    """The paths, if there are any."""
    if not paths:
        raise ValueError(f"{shown(root)}: expected {expected}, found none")
    return paths
