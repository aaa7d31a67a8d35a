"""Pictures of a dataset for its card: what the fingers felt, what the cameras saw, one episode."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from exumi_data.dataset import Dataset
from exumi_data.demo.canvas import Canvas
from exumi_data.demo.look import CONCAVE, CONVEX, GROUND, PANEL, QUIET
from exumi_data.episode import Episode, StreamView
from exumi_data.release.signals import signals_picture, title
from exumi_data.tactile import paint_change

__all__ = ["pictures_of"]

_WIDTH = 1000
_MARGIN = 24
_GAP = 10
_HEAD = 64
_WORDS = 30
_TOUCHES = 5
_TOUCH_ROWS = 3
_VIEWS = 4
_VIEW_ROWS = 2
_TRIES = 4
# Of 256 levels: what is left of a sensor's noise would be most of a file.
_STEP = 4
UInt8Array = npt.NDArray[np.uint8]


def pictures_of(dataset: Dataset) -> dict[str, bytes]:
    """Draw what a dataset looks and feels like. A handful of frames is decoded.

    The same dataset gives the same pictures.

    Parameters
    ----------
    dataset : Dataset

    Returns
    -------
    dict of str to bytes
        PNG files by name: ``touch.png``, ``camera.png`` and ``signals.png``, those that there is
        something for.

    Raises
    ------
    ExumiError
        An episode cannot be read.
    """
    makers: dict[str, Callable[[Dataset], Canvas | None]] = {
        "touch.png": _touch_picture,
        "camera.png": _camera_picture,
        "signals.png": signals_picture,
    }
    drawn = {name: make(dataset) for name, make in makers.items()}
    return {name: _png(canvas) for name, canvas in drawn.items() if canvas is not None}


def _png(canvas: Canvas) -> bytes:
    pixels = cv2.cvtColor(canvas.pixels, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert done  # noqa: S101  # a PNG of 8-bit pixels can always be made
    return data.tobytes()


def _touch_picture(dataset: Dataset) -> Canvas | None:
    found = list(_of_kind(dataset, "tactile", _touch, _TOUCHES * _TOUCH_ROWS))
    if not found:
        return None
    tile = (_WIDTH - 2 * _MARGIN - (_TOUCHES - 1) * _GAP) / _TOUCHES
    tall = tile * found[0][1][0].shape[0] / found[0][1][0].shape[1]
    each = max(len(images) for _, images in found)
    row = each * (tall + 4) + _WORDS
    rows = -(-len(found) // _TOUCHES)
    canvas = Canvas(_WIDTH, round(_HEAD + rows * row + _MARGIN), GROUND)
    title(canvas, "Touch", "the frame with most contact of an episode each")
    if each > 1:
        _legend(canvas)
    for number, (name, images) in enumerate(found):
        x = _MARGIN + number % _TOUCHES * (tile + _GAP)
        y = _HEAD + number // _TOUCHES * row
        for position, image in enumerate(images):
            fitted = _fitted(image, tile / tall)
            _place(canvas, (x, y + position * (tall + 4), tile, tall), fitted)
        _words(canvas, (x + 2, y + each * (tall + 4) + 16), name, tile)
    return canvas


def _legend(canvas: Canvas) -> None:
    x = float(_WIDTH - _MARGIN)
    for name, color in (("darker", CONCAVE), ("brighter", CONVEX)):
        x -= canvas.text((x, 38), name, size=17, color=QUIET, align="right") + 14
        canvas.dot((x, 32), color, radius=5)
        x -= 20
    canvas.text((x, 38), "below it, against no contact:", size=17, color=QUIET, align="right")


def _camera_picture(dataset: Dataset) -> Canvas | None:
    found = list(_of_kind(dataset, "rgb", _view, _VIEWS * _VIEW_ROWS))
    if not found:
        return None
    tile = (_WIDTH - 2 * _MARGIN - (_VIEWS - 1) * _GAP) / _VIEWS
    tall = tile * 0.75
    rows = -(-len(found) // _VIEWS)
    canvas = Canvas(_WIDTH, round(_HEAD + rows * (tall + _WORDS) + _MARGIN), GROUND)
    title(canvas, "Cameras", "the middle of an episode each")
    for number, (name, images) in enumerate(found):
        x = _MARGIN + number % _VIEWS * (tile + _GAP)
        y = _HEAD + number // _VIEWS * (tall + _WORDS)
        _place(canvas, (x, y, tile, tall), _fitted(images[0], tile / tall))
        _words(canvas, (x + 2, y + tall + 18), name, tile)
    return canvas


def _words(canvas: Canvas, at: tuple[float, float], text: str, width: float) -> None:
    most = max(4, int(width / 8.5))
    shown = text if len(text) <= most else f"{text[: most - 1]}…"
    canvas.text(at, shown, size=15, color=QUIET)


def _of_kind(
    dataset: Dataset,
    kind: str,
    frames_of: Callable[[Episode, StreamView], list[UInt8Array] | None],
    most: int,
) -> Iterator[tuple[str, list[UInt8Array]]]:
    """Yield name and pictures of streams, of episodes that are as different as may be."""
    rows = dataset.catalog.select(["object_id", "part_id", "task", "streams"]).to_pylist()
    having = [i for i, row in enumerate(rows) if any(s["kind"] == kind for s in row["streams"])]
    given = 0
    for index in _different(having, rows, most * _TRIES):
        with dataset[index] as episode:
            for stream in episode.of_kind(kind):
                images = frames_of(episode, stream) if len(stream) else None
                if images is not None:
                    yield _name(rows[index], stream, len(episode.of_kind(kind))), images
                    given += 1
                if given == most:
                    return


def _different(indices: Sequence[int], rows: Sequence[dict[str, Any]], most: int) -> list[int]:
    """Choose episodes: one of each thing first, spread over all of them."""
    groups: dict[str, list[int]] = {}
    for index in indices:
        row = rows[index]
        thing = row["part_id"] or row["object_id"] or row["task"]
        groups.setdefault(thing, []).append(index)
    ordered = [groups[thing] for thing in sorted(groups)]
    rounds = max(map(len, ordered), default=0)
    firsts = [[group[turn] for group in ordered if turn < len(group)] for turn in range(rounds)]
    chosen: list[int] = []
    for some in firsts:
        left = most - len(chosen)
        if len(some) > left:
            # Those that are shown first are spread over all, too.
            places = np.unique(np.linspace(0, len(some) - 1, max(left, 1)).round().astype(int))
            some = [some[place] for place in places]  # noqa: PLW2901  # the rest is not needed
        chosen += _spread_first(some)
        if len(chosen) >= most:
            break
    return chosen[:most]


def _spread_first(items: list[int]) -> list[int]:
    """Reorder, so that the first few are spread over all."""
    return [item for start in range(_TRIES) for item in items[start::_TRIES]]


def _name(row: dict[str, Any], stream: StreamView, among: int) -> str:
    thing = row["part_id"] or row["object_id"] or row["task"]
    return f"{thing}, {stream.name.removeprefix('tactile_')}" if among > 1 else str(thing)


def _touch(episode: Episode, stream: StreamView) -> list[UInt8Array] | None:
    activity = stream.activity
    if activity is None or not len(activity):
        index = len(stream) // 2
    else:
        index = int(np.argmax(activity))
        if not activity[index]:
            return None
    frame = stream.frames[index]
    reference = stream.reference
    if reference is None:
        return [frame]
    grey = stream.frames.read([index], grey=True)[0, ..., 0]
    return [frame, paint_change(grey, reference, ground=PANEL, brighter=CONVEX, darker=CONCAVE)]


def _view(episode: Episode, stream: StreamView) -> list[UInt8Array] | None:
    return [stream.frames[len(stream) // 2]]


def _fitted(image: UInt8Array, shape: float) -> UInt8Array:
    """Cut an image to a ratio of width to height, about its middle."""
    height, width = image.shape[:2]
    across, down = min(width, round(height * shape)), min(height, round(width / shape))
    left, top = (width - across) // 2, (height - down) // 2
    return image[top : top + down, left : left + across]


def _place(canvas: Canvas, box: tuple[float, float, float, float], image: UInt8Array) -> None:
    """Place an image, in steps of some levels: what is left out is noise, and most of a file."""
    size = (round(box[2]), round(box[3]))
    scaled = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    calm = (scaled // _STEP * _STEP + _STEP // 2).astype(np.uint8)
    canvas.image(box, calm.reshape(size[1], size[0], image.shape[2]), radius=6)
