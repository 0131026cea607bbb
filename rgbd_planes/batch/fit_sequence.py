"""Fit every frame of a sequence into a table of planes on disk.

The table is a folder of Parquet files. Each of them holds some of the frames and appears whole or not at all. After an
interruption the files that are there are done, and the same call does the rest. Threads share the frames, since reading
an image, fitting it and writing a table all release Python's lock. Where one machine is not enough, the workers of a
Dask cluster share them. Only the caller's process writes, so that no row is lost or doubled whatever becomes of a
worker.
"""

import concurrent.futures.thread  # noqa: F401 (pandas, which pyarrow loads, cannot once the main thread has ended)
import json
import os
import re
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, NamedTuple

import numpy as np

from rgbd_planes._core.checks import check_bool, check_num_threads, check_whole
from rgbd_planes._core.files import alone_in, check_folder_name, json_of, naming, write_beside
from rgbd_planes._core.optional_imports import needs
from rgbd_planes._core.text import counted, shown
from rgbd_planes._core.threads import num_cores
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes._core.version import __version__
from rgbd_planes.batch.fingerprint import UNKNOWN, digests, files_digest, stamps
from rgbd_planes.batch.table import Columns, read_about, write_about
from rgbd_planes.batch.worker import FitSettings, Part, fit_part
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import check_shape, check_unit
from rgbd_planes.sequences.frames import FrameSequence, check_sequence
from rgbd_planes.sequences.problems import Problem, in_words, reason_to_skip

# The size of a part: how much an interruption loses, and what each thread holds in memory.
MOST_FRAMES = 512
MOST_SEGMENTED = 64  # segmenting a frame takes tens of times as long as fitting its tiles
FEWEST_FRAMES = 4
MOST_ROWS = 600_000
# Of more threads most wait for Python, which lets one run at a time, but for decoding, fitting and writing.
MOST_THREADS, MOST_THREADS_OF_SEGMENTS = 8, 16
CONNECT_SECONDS = 30.0
PROGRESS_SECONDS = 0.2  # between two calls, while no part is done
_ABOUT = "_about.parquet"  # of no rows: some readers refuse a folder with files of another kind
_SHOWN = 3  # reasons for which frames were skipped

Task = tuple[int, int, int]  # number of the part, first frame, one after the last


@dataclass(repr=False)
class BatchReport:
    """The outcome of a batch.

    Attributes
    ----------
    out : Path
        The folder of the table.
    frames, resumed : int
        Number of frames of the sequence, and of those that an earlier call had done.
    rows : int
        Rows of the table.
    status : Counter of str
        Rows by status.
    problems : list of Problem
        Frames that could not be read or fitted; the table has no rows for them.
    seconds : Counter of str
        Time that this call spent on "read", "fit" and "write", summed over threads.
    """

    out: Path
    frames: int
    resumed: int = 0
    rows: int = 0
    status: Counter[str] = field(default_factory=Counter)
    problems: list[Problem] = field(default_factory=list)
    seconds: Counter[str] = field(default_factory=Counter)

    def add(self, part: Part) -> None:
        """Count a part."""
        self.rows += sum(part.status.values())
        self.status.update(part.status)
        self.problems.extend(part.problems)
        self.seconds.update(part.seconds)

    def __repr__(self) -> str:
        lines = in_words(self.problems)
        skipped = [f"; skipped {line}" for line in lines[:_SHOWN]] + ["; ..."] * (len(lines) > _SHOWN)
        done = f"{self.frames - len(self.problems)} of {counted(self.frames, 'frame')}"
        return f"<BatchReport: {done}, {counted(self.rows, 'row')} in {shown(self.out)}{''.join(skipped)}>"


class Progress(NamedTuple):
    """Frames that have been done since the last call.

    Attributes
    ----------
    frames : int
        Their number: threads here count them when they are fitted, though they are in the table only when their part
        is.
    problems : tuple of Problem
        Those that could not be read or fitted, of a part that is in the table.
    """

    frames: int
    problems: tuple[Problem, ...]


def fit_sequence(
    sequence: FrameSequence,
    out: str | os.PathLike[str],
    settings: FitSettings | None = None,
    *,
    num_threads: int | None = None,
    scheduler: str | None = None,
    retry: bool = False,
    progress: Callable[[Progress], object] | None = None,
) -> BatchReport:
    """Fit every frame of a sequence and write a Parquet table of the planes, one row per tile or segment.

    If `out` holds part of this very table, from a call that was interrupted, only the rest is done. The table must be
    of the same frames, read from the same places by the same function, with the same cameras and settings, and by this
    version. Where the file of a frame has changed since, the part of the table that it is in is done again. At most the
    part that each thread is at is lost: up to 512 frames, or 64 of segments. A table with a noise model that is a
    function, or of a sequence that cannot be pickled, is not resumed. A frame that cannot be read or fitted is skipped
    and reported, and tried again if its file has changed, or with `retry`. Memory does not grow with the sequence.

    Parameters
    ----------
    sequence : FrameSequence
    out : folder
        Made if need be; `pandas.read_parquet` and others read the folder as one table. Columns: frame, name, timestamp;
        row and column of a tile, label of a segment; top, left, height, width in pixels; status, valid_count; nx, ny,
        nz, d; rmse, rmse_metric. Tiles of cameras with a noise model have p_value, too. They, and segments always, have
        the covariance of the plane: cov_nx_nx, cov_nx_ny, ..., cov_d_d. With `FitSettings.curvature` tiles also have
        kappa_1, kappa_2, mean_curvature and gaussian_curvature; with a noise model p_flat, mean_curvature_std and
        gaussian_curvature_std, too. With `FitSettings.primitives` segments have kind, radius, radius_std, centre_x,
        ..., axis_z, and curved surfaces have rows, too. All floats but timestamp are in single precision. A segment's
        place is the rectangle around it, its valid_count its pixels.
    settings : FitSettings, optional
        Tiles or segments, and the arguments of `fit_tiles` or `segment`.
    num_threads : int, optional
        If not given, one for each core, up to 8, or 16 for segments: of more, most wait for Python, which lets one run
        at a time. The table is the same for any number.
    scheduler : str, optional
        Address of a Dask scheduler, tcp://host:port, instead of threads here. Its workers must see the
        sequence's files at the same paths; `out` is written here.
    retry : bool
        Whether frames that an earlier call has skipped are tried again, together with the others in the same files.
    progress : callable, optional
        Called with a `Progress` from the calling thread.

    Returns
    -------
    BatchReport

    Raises
    ------
    ModuleNotFoundError
        pyarrow, or distributed with a scheduler, is not installed.
    BlockingIOError
        Another call is writing into `out`. (Not on Windows.)
    NotADirectoryError
        `out` is a file.
    OSError
        No Dask scheduler answers, or `out` cannot be written. Or a frame cannot be read for a reason that would concern
        all frames: too many files are open, say, or a disk does not answer.
    MemoryError
        There is not enough memory to read or fit a frame.
    TypeError, ValueError
        An argument cannot be used. Or `out` holds another table, or one that cannot be told from another, or something
        else, or is named like a file of another format. Or the first frame has integers, and its camera neither
        `depth_scale` nor `disparity`.

    Warns
    -----
    UserWarning
        What `fit_tiles` or `segment` warns of. Or, without noise, that surfaces are bent when taken as depth and flat
        when taken as distances along the ray. Each warning comes once, for one of the frames concerned.
    """
    with needs("pyarrow", "batch" if scheduler is None else "dask"):
        import pyarrow.parquet  # noqa: F401 (now, not after minutes of work)
    check_sequence(sequence)
    num_threads, retry = check_num_threads(num_threads), check_bool("retry", retry)
    if progress is not None and not callable(progress):
        raise TypeError(f"expected progress as a function of a Progress, got {progress!r}")
    settings = FitSettings() if settings is None else settings
    if not isinstance(settings, FitSettings):
        raise TypeError(f"expected settings as FitSettings(...), got {settings!r}")
    settings.check(sequence.camera)
    if len({camera.noise is None for camera in sequence.cameras}) > 1:
        raise ValueError("expected a noise model in all cameras or in none, got some with and some without")
    timed = not bool(np.isnan(sequence.timestamps).any())
    has_noise = sequence.camera.noise is not None
    columns = Columns(settings.segments, has_noise, timed, settings.curvature, settings.primitives)
    folder = Path(out)
    check_folder_name(folder, "the table")
    if scheduler is None or (sequence.camera.depth_scale is None and sequence.camera.disparity is None):
        _check_frames(sequence)  # which a scheduler's workers can read, and this process may not
    with _workers(scheduler, num_threads, settings) as workers, alone_in(folder):
        size = _open_table(folder, sequence, settings, columns, workers.slots)
        tasks: list[Task] = [
            (i, start, min(start + size, len(sequence))) for i, start in enumerate(range(0, len(sequence), size))
        ]
        report = BatchReport(folder, len(sequence))
        missing = []
        for task in tasks:
            done = Part.read(_file(folder, task[0]))
            if done is None or (retry and done.problems) or _has_changed(done, sequence, task):
                missing.append(task)
                continue
            report.add(done)
            report.resumed += task[2] - task[1]
        if progress is not None and report.resumed:
            progress(Progress(report.resumed, tuple(report.problems)))
        said = set()
        with closing(workers.run(sequence, settings, columns, missing, folder)) as results:
            for frames, part in results:
                if part is not None:
                    report.add(part)
                    for kind, (name, message) in part.warnings.items():
                        if kind not in said:
                            said.add(kind)
                            warn_caller(f"{name}: {message}")
                if progress is not None:
                    progress(Progress(frames, () if part is None else part.problems))
    report.problems.sort(key=lambda problem: problem.frame)
    return report


def _has_changed(part: Part, sequence: FrameSequence, task: Task) -> bool:
    """Whether the files of its frames are others now."""
    _, start, stop = task
    return part.files != files_digest(stamps(entry.location) for entry in sequence.entries[start:stop])


def _check_frames(sequence: FrameSequence) -> None:
    """Refuse, before a table is begun, a camera whose frames these are not, or that does not say what integers are.

    No frame could be fitted. Both ends must be of another size: one alone may be a problem of its own.
    """
    for i in (0, -1):
        name = sequence.names[i]
        try:
            frame = sequence[i]
            depth = np.asarray(frame.depth)
        except Exception as error:
            reason_to_skip(error, name)  # raises what is no fault of the frame; a damaged frame is a problem for later
            return
        with naming(name):
            if depth.shape == frame.camera.shape:
                check_unit(depth.dtype, frame.camera)
                return
            if i != 0:
                check_shape(depth, depth, frame.camera)


def _open_table(folder: Path, sequence: FrameSequence, settings: FitSettings, columns: Columns, slots: int) -> int:
    """Begin a table in an empty folder, or check the one that is there; returns the number of frames of a part."""
    chosen = asdict(settings) | {"tile": np.broadcast_to(settings.tile, 2).tolist()}  # 16 is (16, 16)
    about = {"version": __version__, "frames": len(sequence), **digests(sequence), "settings": chosen}
    about = json.loads(json.dumps(about))
    file = folder / _ABOUT
    if file.is_file():
        try:
            found = json_of(read_about(file))
            size = check_whole("frames_per_part", found.pop("frames_per_part"), 1)
        except (ValueError, KeyError, AttributeError, TypeError):
            raise ValueError(f"{shown(file)}: damaged; remove {shown(folder)} to begin again") from None
        if found != about:
            different = [name for name in about if found.get(name) != about[name]]
            raise ValueError(
                f"{shown(folder)} holds the table of another sequence, camera, settings or version "
                f"({', '.join(different)} differ): remove it, or choose another folder"
            )
        unknown = [reason for name, reason in UNKNOWN.items() if about[name] is None]
        if unknown:
            raise ValueError(
                f"{shown(folder)} holds a table that cannot be told from one of another sequence or camera: "
                f"{'; '.join(unknown)}; remove it, or choose another folder"
            )
        for leftover in folder.glob(".part-*"):  # left by a process that was killed while it wrote
            leftover.unlink(missing_ok=True)
        parts = {_file(folder, number) for number in range(-(-len(sequence) // size))}
        others = sorted(p for p in folder.iterdir() if p not in parts and not p.name.startswith((".", "_")))
        if others:
            raise ValueError(
                f"{shown(others[0])}: not part of this table, but readers of the folder would take it for one: "
                "move it away"
            )
        return size
    if any(not path.name.startswith(".") for path in folder.iterdir()):
        raise ValueError(f"{shown(folder)}: expected an empty folder, or a table that was begun earlier")
    size = _frames_of_part(len(sequence), settings, sequence.camera, slots)
    with write_beside(file) as beside:
        write_about(beside, columns, json.dumps({**about, "frames_per_part": size}))
    return size


def _frames_of_part(frames: int, settings: FitSettings, camera: Camera, slots: int) -> int:
    # A few parts for each thread, so that all have work to the end; but a file takes a millisecond itself.
    most = MOST_SEGMENTED if settings.segments else MOST_FRAMES
    shared = max(frames // (4 * slots), min(FEWEST_FRAMES, -(-frames // slots)))
    size = max(1, min(most, MOST_ROWS // settings.rows_of_frame(camera), shared))
    rounds = -(-frames // (size * slots))  # in which each thread has a part
    return -(-frames // (rounds * slots))


def _file(folder: Path, number: int) -> Path:
    return folder / f"part-{number:06d}.parquet"


class _Threads:
    """Fits parts in threads of this process: of its own, for the reason that `rgbd_planes._core.threads` has.

    `run` yields the number of frames that were fitted since it last did, and a part, if one is done.
    """

    def __init__(self, num_threads: int | None, settings: FitSettings) -> None:
        most = MOST_THREADS_OF_SEGMENTS if settings.segments else MOST_THREADS
        self.slots = num_threads or min(num_cores(), most)

    def run(
        self, sequence: FrameSequence, settings: FitSettings, columns: Columns, tasks: list[Task], folder: Path
    ) -> Generator[tuple[int, Part | None], None, None]:
        to_do: SimpleQueue[Task] = SimpleQueue()
        fitted: SimpleQueue[None] = SimpleQueue()  # an item for each frame
        done: SimpleQueue[Part | BaseException] = SimpleQueue()
        is_stopped = False
        for task in tasks:
            to_do.put(task)

        def work_off() -> None:
            while not is_stopped:
                try:
                    number, start, stop = to_do.get_nowait()
                except Empty:
                    return
                frames, file = sequence[start:stop], _file(folder, number)
                try:
                    part = fit_part(
                        frames, start, settings, columns, file, lambda: is_stopped, partial(fitted.put, None)
                    )
                except BaseException as error:  # the caller raises it
                    done.put(error)
                    return
                done.put(part)

        def newly_fitted() -> int:
            count = fitted.qsize()
            for _ in range(count):
                fitted.get()
            return count

        started: list[Thread] = []
        try:
            with suppress(RuntimeError):  # there are no more threads, by a limit or since the main thread has ended
                for _ in range(min(self.slots, len(tasks))):
                    thread = Thread(target=work_off, name="rgbd_planes_batch", daemon=True)
                    thread.start()
                    started.append(thread)
            if not started:
                work_off()
            left = len(tasks)
            while left:
                try:
                    part = done.get(timeout=PROGRESS_SECONDS)
                except Empty:
                    yield newly_fitted(), None
                    continue
                if isinstance(part, BaseException):
                    raise part
                left -= 1
                yield newly_fitted(), part
        finally:
            is_stopped = True
            for thread in started:
                thread.join()


class _Cluster:
    """Fits parts in the workers of a Dask cluster; `run` is as that of `_Threads`."""

    def __init__(self, client: Any) -> None:
        self._client = client
        client.wait_for_workers(1, timeout=60)
        self.slots = max(1, sum(client.ncores().values()))

    def run(
        self, sequence: FrameSequence, settings: FitSettings, columns: Columns, tasks: list[Task], folder: Path
    ) -> Generator[tuple[int, Part | None], None, None]:
        from distributed import as_completed

        waiting = iter(tasks)
        running: dict[Any, Task] = {}

        def submit(task: Task) -> Any:
            # Dask runs it again elsewhere when a worker dies. Not pure: another call must run again.
            future = self._client.submit(
                fit_part, sequence[task[1] : task[2]], task[1], settings, columns, pure=False, retries=2
            )
            running[future] = task
            return future

        first = [submit(task) for task in islice(waiting, 2 * self.slots)]
        completed = as_completed(first, loop=self._client.loop)
        for future in completed:
            task, part = running.pop(future), future.result()
            with write_beside(_file(folder, task[0])) as beside:
                beside.write_bytes(part.content)
            future.release()
            yield task[2] - task[1], part
            for next_task in islice(waiting, 1):
                completed.add(submit(next_task))


@contextmanager
def _workers(scheduler: str | None, num_threads: int | None, settings: FitSettings) -> Iterator[_Threads | _Cluster]:
    if scheduler is None:
        yield _Threads(num_threads, settings)
        return
    if not (isinstance(scheduler, str) and re.fullmatch(r"\w+://.+:\d+", scheduler)):
        raise ValueError(f"expected the scheduler's address as tcp://host:port, got {scheduler!r}")
    with needs("distributed", "dask"):
        from distributed import Client
    try:
        client = Client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise OSError(f"no Dask scheduler answers at {scheduler} ({error})") from None
    with client:
        yield _Cluster(client)
