"""Teach a new object by touch: one clip, no training, and it is known again.

An index is built of some touched parts. A part that it has never met is taken for the most similar
one; after one clip of it was taught, other clips of it are called by its name. `forget` undoes it::

    python examples/teach_object.py                  simulated touches, made on the spot
    python examples/teach_object.py DATASET          your clips, with part ids
"""

import argparse
import sys
import tempfile
from pathlib import Path

from exumi_data.dataset import open_dataset
from exumi_data.demo import TouchSettings, write_touch_dataset
from exumi_data.errors import ExumiError
from exumi_loaders import Clips, TactileIndex, TextureEncoder


def main() -> None:
    """Ask, teach, ask again, forget."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path, nargs="?")
    parser.add_argument("--part", help="the part to teach; default the last one")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        try:
            teach(arguments.dataset, arguments.part, Path(scratch))
        except ExumiError as error:
            sys.exit(f"error: {error}")


def teach(dataset: Path | None, part: str | None, scratch: Path) -> None:
    """Leave one part out of an index, and teach it."""
    if dataset is None:
        print("Simulating touches of ten parts ...")
        write_touch_dataset(scratch / "touches", TouchSettings(parts=10, clips=4))
        dataset = scratch / "touches"
    opened = open_dataset(dataset)
    part_of = [str(name) for name in opened.catalog.column("part_id").to_pylist()]
    parts = sorted(set(part_of) - {"None"})
    if len(parts) < 2:
        sys.exit(f"error: {dataset} has {len(parts)} parts with part ids: this needs two or more")
    new = part or parts[-1]
    own = [number for number, name in enumerate(part_of) if name == new]
    if len(own) < 2:
        sys.exit(
            f"error: part {new!r} has {len(own)} clips: one to teach and one to ask are needed"
        )

    seen = opened.select(part_id=[name for name in parts if name != new])
    index = TactileIndex.build(seen, TextureEncoder(), path=scratch / "index")
    clips = Clips(opened)
    name, others = f"our {new}", own[1:]
    print(f"{len(index)} clips of {len(parts) - 1} parts are known; {new} is not.")
    asked = clips.read(others[0])
    print(f"Before: {index.line(index.query(*asked, k=3))}")
    index.teach([clips.read(own[0])], name=name, provenance="human")
    print(f"One clip taught: {index.line(index.query(*asked, k=3))}")
    again = sum(index.query(*clips.read(one), k=1)[0].name == name for one in others)
    print(f"Of {len(others)} other clips of it, {again} are called by its name.")
    index.forget(name)
    print(f"Forgotten: {index.line(index.query(*asked, k=1))}")


if __name__ == "__main__":
    main()
