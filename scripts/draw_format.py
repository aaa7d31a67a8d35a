"""Draw the pictures of ``docs/format.md``: ``docs/images/format-*.svg``.

Without ``--check`` it writes; with it, it compares, and returns 1 if anything differs.
"""

import argparse
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"

# Fill and stroke of what was measured, what is known, what is computed, and what is neither.
MEASURED = ("#e8f0fb", "#2f6aa8")
KNOWN = ("#fdf1df", "#b3721f")
DERIVED = ("#e9f5e6", "#48823a")
PLAIN = ("#f4f4f4", "#777777")
# Height, name, rate and clock, times in milliseconds.
Lanes = tuple[tuple[int, str, tuple[str, str], list[float]], ...]

INK, SOFT, ALARM = "#1d1d1f", "#55585c", "#b3261e"


def _tip(colour: str) -> str:
    """Return the tip of arrows of a colour."""
    return (
        f'<marker id="tip{colour[1:]}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" '
        f'markerHeight="7" orient="auto"><path d="M0,0 L10,5 L0,10 z" fill="{colour}"/></marker>'
    )


@dataclass
class Drawing:
    """Shapes on a light ground; sizes are in pixels."""

    width: int
    height: int
    title: str
    shapes: list[str] = field(default_factory=list)

    def text(
        self,
        x: float,
        y: float,
        words: str,
        *,
        size: int = 14,
        colour: str = INK,
        bold: bool = False,
        anchor: str = "start",
        mono: bool = False,
    ) -> None:
        """Write a line; `y` is its base line."""
        family = ' font-family="ui-monospace, Menlo, Consolas, monospace"' if mono else ""
        weight = ' font-weight="bold"' if bold else ""
        escaped = words.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
        self.shapes.append(
            f'<text x="{x:g}" y="{y:g}" font-size="{size}" fill="{colour}" '
            f'text-anchor="{anchor}"{weight}{family} xml:space="preserve">{escaped}</text>'
        )

    def box(
        self,
        x: float,
        y: float,
        width: float,
        height: float,
        look: tuple[str, str] = PLAIN,
        *,
        dashed: bool = False,
        radius: int = 5,
    ) -> None:
        """Draw a rectangle."""
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        self.shapes.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="{radius}" '
            f'fill="{look[0]}" stroke="{look[1]}" stroke-width="1.3"{dash}/>'
        )

    def named(
        self,
        x: float,
        y: float,
        width: float,
        height: float,
        look: tuple[str, str],
        *lines: str,
        mono: bool = False,
    ) -> None:
        """Draw a rectangle with lines in its middle, the first one bold."""
        self.box(x, y, width, height, look)
        top = y + height / 2 - 9 * (len(lines) - 1) + 5
        for i, line in enumerate(lines):
            self.text(
                x + width / 2,
                top + 18 * i,
                line,
                size=14 if i == 0 else 12,
                bold=i == 0,
                colour=INK if i == 0 else SOFT,
                anchor="middle",
                mono=mono and i == 0,
            )

    def line(
        self,
        points: Iterable[tuple[float, float]],
        colour: str = SOFT,
        *,
        width: float = 1.5,
        arrow: bool = False,
        dashed: bool = False,
    ) -> None:
        """Draw a line through points."""
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        more = f' marker-end="url(#tip{colour[1:]})"' if arrow else ""
        more += ' stroke-dasharray="5 4"' if dashed else ""
        self.shapes.append(
            f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{width:g}"'
            f"{more}/>"
        )

    def dot(self, x: float, y: float, radius: float, colour: str) -> None:
        """Draw a filled circle."""
        self.shapes.append(f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{colour}"/>')

    def svg(self) -> str:
        """Return the whole picture."""
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" '
            f'width="{self.width}" height="{self.height}" '
            'font-family="Helvetica, Arial, sans-serif" role="img">\n'
            f"<title>{self.title}</title>\n"
            f"<defs>{''.join(map(_tip, (SOFT, ALARM)))}</defs>\n"
            f'<rect width="{self.width}" height="{self.height}" rx="8" fill="#ffffff"/>\n'
        )
        return head + "\n".join(self.shapes) + "\n</svg>\n"


def tree() -> Drawing:
    """Draw an episode's folder, and which part is what."""
    d = Drawing(
        900, 520, "An episode is one folder: metadata, streams, derived arrays, calibration"
    )
    d.text(24, 34, "018f…a1.zarr", size=17, bold=True, mono=True)
    d.text(172, 34, "one episode: a folder, or the same files in one zip", colour=SOFT)
    rows = (
        (
            60,
            40,
            KNOWN,
            "zarr.json",
            "all metadata: task, streams, clocks, calibration, labels, licence",
            "one small read opens the episode",
        ),
        (
            112,
            236,
            MEASURED,
            "streams/",
            "one group a sensor, each with its own times and its own rate",
            "written once, never changed",
        ),
        (
            360,
            84,
            DERIVED,
            "derived/",
            "computed from the streams: activity, salient frames",
            "may be computed again: outside of the digest",
        ),
        (456, 40, KNOWN, "calibration/", "maps and reference images that are too big for JSON", ""),
    )
    for y, height, look, name, what, note in rows:
        d.box(24, y, 852, height, look)
        d.text(40, y + 25, name, bold=True, mono=True)
        d.text(172, y + 25, what, size=13)
        if note:
            d.text(
                862,
                y + 25 if height < 50 else y + height - 12,
                note,
                size=12,
                colour=look[1],
                anchor="end",
            )
    streams = (
        ("rgb/", ("time", "data", "offset", "crc32c"), "a camera's JPEG files, end to end"),
        (
            "tactile_left/",
            ("time", "data", "offset", "crc32c", "reference"),
            "and the gel without contact",
        ),
        (
            "pose/",
            ("time", "time_host", "data", "raw", "flags"),
            "x y z qx qy qz qw, and what the device said",
        ),
        ("width/", ("time", "data", "raw"), "metres, and the encoder's counts"),
    )
    for i, (name, arrays, about) in enumerate(streams):
        y = 152 + 42 * i
        d.text(60, y + 20, name, mono=True)
        x = 190.0
        for array in arrays:
            wide = 16 + 8.2 * len(array)
            d.box(x, y + 2, wide, 26, ("#ffffff", MEASURED[1]))
            d.text(x + wide / 2, y + 20, array, size=13, mono=True, anchor="middle")
            x += wide + 8
        d.text(862, y + 20, about, size=12, colour=SOFT, anchor="end")
    d.text(60, 415, "tactile_left/", mono=True)
    x = 190.0
    for array in ("activity", "salient"):
        wide = 16 + 8.2 * len(array)
        d.box(x, 397, wide, 26, ("#ffffff", DERIVED[1]))
        d.text(x + wide / 2, 415, array, size=13, mono=True, anchor="middle")
        x += wide + 8
    return d


def _lane(d: Drawing, y: float, name: str, about: tuple[str, str]) -> None:
    d.text(24, y - 4, name, bold=True, mono=True)
    d.text(24, y + 13, about[0], size=12, colour=SOFT)
    d.text(24, y + 29, about[1], size=12, colour=SOFT)
    d.line([(230, y), (870, y)], "#c9ccd1", width=1)


def timeline() -> Drawing:
    """Draw sensors of many rates and clocks on one time, and a tick that a reader asks for."""
    d = Drawing(900, 500, "Sensors of many rates and clocks on one time axis")
    left, scale = 290.0, 5.6  # pixels a millisecond
    asked = 56.0  # ms

    def x(ms: float) -> float:
        return left + scale * ms

    d.text(24, 34, "One time, many rates", size=17, bold=True)
    d.text(
        250, 34, "each sample lies where it was measured; nothing is moved onto a grid", colour=SOFT
    )
    d.line([(x(asked), 56), (x(asked), 408)], ALARM, width=1.5, dashed=True)
    d.line([(x(0), 62), (x(0), 408)], "#9a9da2", width=1)
    d.text(x(0), 56, "start", size=12, colour=SOFT, anchor="middle")

    lanes: Lanes = (
        (
            100,
            "rgb",
            ("60 frames/s", "clock: camera, container_pts"),
            [-5 + 16.68 * i for i in range(7)],
        ),
        (
            180,
            "tactile_left",
            ("30 frames/s", "clock: hub, kernel_rx"),
            [7 + 33.3 * i for i in range(3)],
        ),
        (
            260,
            "pose",
            ("90/s, two samples lost", "clock: headset, device"),
            [-8 + 11.1 * i for i in range(11) if i not in (3, 4)],
        ),
        (340, "width", ("500/s", "clock: hub, bracket_mid"), [-9 + 2.0 * i for i in range(55)]),
    )
    for y, name, about, times in lanes:
        _lane(d, y, name, about)
        for ms in times:
            d.dot(x(ms), y, 3 if name == "width" else 6, MEASURED[1])
    d.box(x(-8 + 11.1 * 2) + 10, 247, scale * 33.3 - 20, 26, ("#fbe9e7", ALARM), dashed=True)
    d.text(x(-8 + 11.1 * 3.5), 264, "gap: after 2, lost 2", size=12, colour=ALARM, anchor="middle")

    _found(d, x, asked, lanes)
    d.line([(x(-9), 408), (868, 408)], SOFT, width=1.5, arrow=True)
    for ms in (0, 20, 40, 60, 80, 100):
        d.line([(x(ms), 408), (x(ms), 414)], SOFT)
        d.text(
            x(ms), 430, f"{ms} ms" if ms == 100 else f"{ms}", size=12, colour=SOFT, anchor="middle"
        )
    d.text(24, 430, "time: int64, ns since start", size=12, colour=SOFT)
    d.dot(34, 462, 6, MEASURED[1])
    d.text(48, 467, "a sample, at its own time", size=13)
    d.line([(250, 450), (250, 474)], ALARM, dashed=True)
    d.text(
        262,
        467,
        "a tick that a reader asks for: the nearest frame, the pose and the width between two "
        "samples",
        size=13,
    )
    return d


def _found(d: Drawing, x: Callable[[float], float], asked: float, lanes: Lanes) -> None:
    """Mark what a reader takes for a tick."""
    for y, name, _, times in lanes:
        before = max(ms for ms in times if ms <= asked)
        after = min(ms for ms in times if ms > asked)
        if name in ("rgb", "tactile_left"):
            nearest = before if asked - before < after - asked else after
            d.shapes.append(
                f'<circle cx="{x(nearest):g}" cy="{y}" r="10" fill="none" stroke="{ALARM}" '
                'stroke-width="2"/>'
            )
        else:
            d.line(
                [(x(before), y - 11), (x(before), y - 15), (x(after), y - 15), (x(after), y - 11)],
                ALARM,
                width=2,
            )
            d.dot(x(asked), y, 3.5, ALARM)


def frame() -> Drawing:
    """Draw how a frame is found in the three encodings."""
    d = Drawing(900, 560, "How a frame is found: one read at a known place")
    d.text(24, 34, "Frame 2 of encoded images, with one read", size=17, bold=True)
    d.text(24, 84, "offset", bold=True, mono=True)
    edges = ("0", "7812", "15904", "23411", "31070", "38766")
    for i, edge in enumerate(edges):
        hit = i in (2, 3)
        d.box(130 + 118 * i, 62, 106, 34, ("#fde7e5", ALARM) if hit else PLAIN)
        d.text(183 + 118 * i, 84, edge, mono=True, anchor="middle", colour=ALARM if hit else INK)
        d.text(183 + 118 * i, 112, f"[{i}]", size=12, colour=SOFT, anchor="middle")
    d.text(24, 190, "data", bold=True, mono=True)
    d.text(24, 208, "file data/c/0", size=12, colour=SOFT)
    names = ("JPEG 0", "JPEG 1", "JPEG 2", "JPEG 3", "JPEG 4")
    starts = [130 + 142 * i for i in range(6)]
    for i, name in enumerate(names):
        d.box(starts[i], 170, 142, 44, ("#fde7e5", ALARM) if i == 2 else MEASURED, radius=0)
        d.text(starts[i] + 71, 197, name, anchor="middle", bold=i == 2)
    d.line([(419, 118), (starts[2] + 3, 166)], ALARM, arrow=True)
    d.line([(537, 118), (starts[3] - 3, 166)], ALARM, arrow=True)
    d.line([(starts[2] + 71, 214), (starts[2] + 71, 250)], ALARM, arrow=True)
    d.named(300, 254, 370, 40, ("#ffffff", ALARM), "pread(file, 7507 bytes, at 15904)", mono=True)
    d.line([(670, 274), (712, 274)], SOFT, arrow=True)
    d.named(716, 254, 160, 40, PLAIN, "any JPEG decoder")
    d.text(24, 268, "Uncompressed, in order,", size=13, colour=SOFT)
    d.text(24, 286, "without holes: byte i of the", size=13, colour=SOFT)
    d.text(24, 304, "data is byte i of the file.", size=13, colour=SOFT)
    d.line([(24, 330), (876, 330)], "#dcdfe3", width=1)

    d.text(24, 362, "array", bold=True, mono=True)
    d.text(100, 362, "pixels, lossless: one chunk a frame, data[2]", size=13, colour=SOFT)
    for i in range(5):
        d.named(
            100 + 150 * i, 376, 142, 34, ("#fde7e5", ALARM) if i == 2 else MEASURED, f"chunk {i}"
        )
    d.text(24, 450, "video", bold=True, mono=True)
    d.text(
        100,
        450,
        "a camera's file, kept whole: start at the keyframe, decode up to the frame's pts",
        size=13,
        colour=SOFT,
    )
    for i in range(10):
        key = i % 5 == 0
        look = ("#fde7e5", ALARM) if i == 7 else (KNOWN if key else MEASURED)
        d.box(100 + 76 * i, 464, 76, 34, look, radius=0)
        d.text(138 + 76 * i, 486, f"key {i}" if key else f"{i}", size=13, anchor="middle")
    d.line([(518, 506), (518, 522), (670, 522), (670, 503)], ALARM, arrow=True)
    d.text(690, 526, "keyframe[7] = 5, pts[7]", size=13, mono=True, colour=ALARM)
    return d


def derivation() -> Drawing:
    """Draw what is computed from what."""
    d = Drawing(900, 500, "What was measured, what is known, and what is computed from both")
    # Far enough apart for DejaVu Sans, which is wider than the fonts that are asked for.
    for x, look, words in (
        (24, MEASURED, "measured: never changed"),
        (280, KNOWN, "known: with its method and uncertainty"),
        (600, DERIVED, "computed: can be computed again"),
    ):
        d.box(x, 20, 22, 18, look)
        d.text(x + 30, 34, words, size=13)
    rows = (
        (
            64,
            ("raw time", "time_host, time_device"),
            ("clock", "offset, drift, latency"),
            ("time", "ns since start"),
            "time = (raw − t_ref) · (1 + drift) + offset − latency",
        ),
        (
            194,
            ("raw width", "encoder counts"),
            ("calibration", "width_map: counts to metres"),
            ("data", "metres"),
            "a better calibration: computed again from the counts",
        ),
        (
            324,
            ("tactile frames", "as the sensor gave them"),
            ("reference", "the gel without contact"),
            ("convex, concave", "clamped, never wrapped"),
            "convex = max(g − r, 0), concave = max(r − g, 0)",
        ),
    )
    for y, raw, known, made, words in rows:
        d.named(24, y, 220, 62, MEASURED, *raw)
        d.text(262, y + 39, "+", size=20, anchor="middle", bold=True, colour=SOFT)
        d.named(280, y, 240, 62, KNOWN, *known)
        d.line([(520, y + 31), (576, y + 31)], arrow=True)
        d.named(580, y, 200, 62, DERIVED, *made)
        d.text(280, y + 86, words, size=13, colour=SOFT)
    d.line([(134, 386), (134, 422)], arrow=True)
    d.named(24, 426, 220, 54, DERIVED, "salient", "the frames that change most")
    d.line([(680, 386), (680, 422)], arrow=True)
    d.named(580, 426, 200, 54, DERIVED, "activity", "share of pixels that changed")
    return d


PICTURES = {
    "format-tree.svg": tree,
    "format-timeline.svg": timeline,
    "format-frame.svg": frame,
    "format-derived.svg": derivation,
}


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    check = parser.parse_args().check
    wrong = 0
    for name, draw in PICTURES.items():
        path, text = IMAGES / name, draw().svg()
        if not check:
            path.write_text(text, "utf-8")
        elif not path.is_file() or path.read_text("utf-8") != text:
            sys.stderr.write(f"differs: {path}\n")
            wrong += 1
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
