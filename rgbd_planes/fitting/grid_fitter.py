"""Frames of one camera fitted one by one, many at once, or as they come: what the fitters of grids share."""

from __future__ import annotations

import itertools
import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.arrays import Arrays
from rgbd_planes._core.checks import FixedArguments, each_of
from rgbd_planes._core.compile_notice import announced
from rgbd_planes._core.threads import Work, choose_num_threads, run_in_ranges, submit
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import DepthFrame, as_depth_frame, as_depth_frames
from rgbd_planes.camera.frame import as_numbered_frame
from rgbd_planes.camera.frame_warnings import warn_of_noise

if TYPE_CHECKING:
    from rgbd_planes.camera.frame import Frame

_MANY = 8  # frames for each thread that are enough to share out whole ones fairly
# Of frames in one array a thread fits so many in one call: only in between, in Python, do threads wait for one another.
_PIXELS_AT_ONCE = 5_000_000

Result = TypeVar("Result")


class GridFitter(FixedArguments, Generic[Result]):
    """A base of the fitters of a grid of tiles: `fit`, `fit_batch` and `fit_stream`.

    A subclass sets camera, tile and the attributes below, and says how arrays are allocated and filled.

    Attributes
    ----------
    _grid : (R, C)
        Number of rows and columns of tiles.
    _num_threads : int or None
    _takes_stacks : bool
        Whether several frames in one array can be fitted in one call.
    _compiled_for : tuple
        What the kernels are compiled for, besides a frame's kind.
    """

    camera: Camera
    tile: tuple[int, int]
    _grid: tuple[int, int]
    _num_threads: int | None
    _takes_stacks: bool
    _compiled_for: tuple[Any, ...]
    _noise_is_asked: threading.Lock  # kept from the first frame on that tells; no thread waits for it

    def _arrays(self, frames: tuple[int, ...], out: Result | None) -> Arrays:
        """Return new arrays, or those of a result for so many frames, once it has been checked."""
        raise NotImplementedError

    def _result(self, arrays: Arrays) -> Result:
        raise NotImplementedError

    def _into(self, arrays: Arrays) -> Callable[[DepthFrame], Work]:
        """Return a function of a frame that returns a function to fit some of its tile rows into ``arrays``.

        Or of as many frames, all at once, as there are arrays for.
        """
        raise NotImplementedError

    def _into_result(self, out: Result) -> Callable[[DepthFrame], Work]:
        """`_into` the arrays of a result."""
        return self._into(self._arrays((), out))

    def fit(self, depth: npt.ArrayLike, out: Result | None = None) -> Result:
        """Fit the tiles of a frame.

        Parameters
        ----------
        depth : (H, W) array_like
            Integers in the camera's ``depth_scale`` or ``disparity``, or floats: metres, or, where the camera has
            ``disparity``, disparities.
        out : TilePlanes or TileSurfaces, optional
            An earlier result of this fitter for a frame. Its arrays are overwritten, and it is returned. Its
            uncertainties are written again if they were asked for.

        Returns
        -------
        TilePlanes or TileSurfaces
            Arrays of shape (R, C, ...).

        Raises
        ------
        TypeError, ValueError
            The frame is not an array of the camera's size, or holds integers without a unit. Or ``out`` is not a result
            of this fitter for one frame.

        Warns
        -----
        UserWarning
            Something in the frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.
        """
        return self._fit(as_depth_frame(depth, self.camera), out)

    def _fit(self, frame: DepthFrame, out: Result | None = None) -> Result:
        if out is None:
            arrays = self._arrays((), None)
            fit, out = self._into(arrays), self._result(arrays)
        else:
            fit = self._into_result(out)
        threads = choose_num_threads(self._num_threads, frame.raw.size)
        with announced((*self._compiled_for, frame.is_disparity, frame.raw.dtype)):
            run_in_ranges(fit(frame), self._grid[0], threads)
        return out

    def fit_batch(
        self, frames: Sequence[npt.ArrayLike | Frame] | npt.NDArray[Any], out: Result | None = None
    ) -> Result:
        """Fit the tiles of many frames, which threads share.

        Parameters
        ----------
        frames : (F, H, W) array, or sequence of (H, W) array_like or of Frame
            A `Frame` must come from this fitter's camera, as those of `open_sequence` do. With four threads or more, an
            array takes less time than a sequence. Each frame is read once if there are eight or more for each thread;
            otherwise threads share frames, and may read one twice.
        out : TilePlanes or TileSurfaces, optional
            An earlier result of this fitter for as many frames: it is overwritten and returned.

        Returns
        -------
        TilePlanes or TileSurfaces
            Arrays of shape (F, R, C, ...).

        Raises
        ------
        TypeError, ValueError
            A frame cannot be used, as in `fit`. Or there is no frame, or no length to count them by.

        Warns
        -----
        UserWarning
            Something in a frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.
        """
        if isinstance(frames, Mapping) or not (hasattr(frames, "__len__") and hasattr(frames, "__getitem__")):
            raise TypeError(f"expected a sequence of frames, got {type(frames).__name__}: fit_stream takes any")
        if len(frames) == 0:
            raise ValueError("expected at least one frame, got none")
        arrays = self._arrays((len(frames),), out)
        rows = self._grid[0]

        stack = None
        if isinstance(frames, np.ndarray) and frames.ndim == 3 and self._takes_stacks:
            stack = frames
        at_once = 1 if stack is None else max(1, _PIXELS_AT_ONCE // math.prod(self.camera.shape))

        def fit_some(start: int, stop: int) -> None:
            """Fit tile rows ``start`` to ``stop``, counted through all frames."""
            end = -(-stop // rows)
            for first in range(start // rows, end, at_once):
                last = min(first + at_once, end)
                if stack is None:
                    frame = as_numbered_frame(first, frames[first], self.camera)
                else:
                    frame = as_depth_frames(stack[first:last], self.camera)
                fit = self._into({name: array[first:last] for name, array in arrays.items()})
                with announced((*self._compiled_for, frame.is_disparity, frame.raw.dtype)):
                    fit(frame)(max(start - first * rows, 0), min(stop, last * rows) - first * rows)

        threads = choose_num_threads(self._num_threads, len(frames) * self.camera.width * self.camera.height)
        # A frame that two threads share is read twice; but of a few whole ones, some threads would get many more than
        # others.
        step = rows if len(frames) >= _MANY * threads else 1
        run_in_ranges(lambda start, stop: fit_some(step * start, step * stop), len(frames) * rows // step, threads)
        return self._result(arrays) if out is None else out

    def fit_stream(self, frames: Iterable[npt.ArrayLike | Frame]) -> Iterator[Result]:
        """Fit the tiles of frames one after the other, as they come, in constant memory.

        Parameters
        ----------
        frames : iterable of (H, W) array_like, or of Frame by this camera
            Of any length, even without end: a generator that reads a camera or files.

        Yields
        ------
        TilePlanes or TileSurfaces
            Of one frame, in order.

        Raises
        ------
        TypeError, ValueError
            A frame cannot be used, as in `fit`: the error takes the place of its result, and no more come. Exceptions
            from ``frames`` itself come after the results of all earlier frames.

        Warns
        -----
        UserWarning
            Something in a frame is most likely not meant as it is, such as its unit: `fit_tiles` lists what.

        Notes
        -----
        With ``num_threads`` above 1, that many frames are read ahead and fitted at a time. A frame must then not be
        overwritten before its result has come. Otherwise each frame is finished before the next is asked for.
        """
        return self._stream(each_of(frames))

    def _stream(self, source: Iterator[npt.ArrayLike | Frame]) -> Iterator[Result]:
        ahead = 1 if self._num_threads is None else self._num_threads
        if ahead == 1:
            for number, frame in enumerate(source):
                yield self._fit(as_numbered_frame(number, frame, self.camera))
            return
        waiting: deque[Callable[[], Result]] = deque()
        wrong: Exception | None = None
        for number in itertools.count():
            try:
                frame = next(source)
            except StopIteration:  # not kept: it refers to this call's variables, which would refer to it
                break
            except Exception as error:  # raised after the results of earlier frames
                wrong = error
                break
            waiting.append(submit(self._fit_alone, ahead, number, frame))
            if len(waiting) == ahead:
                yield waiting.popleft()()
        while waiting:
            yield waiting.popleft()()
        if wrong is not None:
            raise wrong

    def _fit_alone(self, number: int, depth: npt.ArrayLike | Frame) -> Result:
        """Fit a frame in this thread."""
        arrays = self._arrays((), None)
        frame = as_numbered_frame(number, depth, self.camera)
        with announced((*self._compiled_for, frame.is_disparity, frame.raw.dtype)):
            self._into(arrays)(frame)(0, self._grid[0])
        return self._result(arrays)

    def _warn_of_noise(self, frame: DepthFrame) -> None:
        """Ask one frame of all, the first with measurements, whether the noise is in other units."""
        if self._noise_is_asked.acquire(blocking=False) and not warn_of_noise(frame, self.camera.noise):
            self._noise_is_asked.release()
