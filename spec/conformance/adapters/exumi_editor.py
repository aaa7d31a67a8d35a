#!/usr/bin/env python3
"""Change a finished episode with `exumi_data`: what ``run_editor.py`` asks of an editor.

Exit code 0: written. Anything else: it failed.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from exumi_data.episode import open_episode
from exumi_data.errors import ExumiError
from exumi_data.model import EpisodeMetadata
from exumi_data.model.documents import dump
from exumi_data.store.episode_writer import EpisodeWriter


def changed(metadata: EpisodeMetadata, changes: list[dict[str, Any]]) -> EpisodeMetadata:
    """Return metadata with values put at JSON pointers, one revision later."""
    document = dump(metadata)
    for change in changes:
        *parents, last = change["pointer"].split("/")[1:]
        place: Any = document
        for part in parents:
            place = place[int(part)] if isinstance(place, list) else place[part]
        if isinstance(place, list):
            place.append(change["value"])
        else:
            place[last] = change["value"]
    context = {"newer_minor": metadata.is_newer_minor}
    later = EpisodeMetadata.model_validate_json(json.dumps(document), context=context)
    later.revision = metadata.revision + 1
    return later


def edit(source: Path, changes: list[dict[str, Any]], target: Path) -> None:
    """Write an episode anew, with its metadata changed."""
    with open_episode(source) as episode:
        episode.check_complete()
        metadata = changed(episode.metadata, changes)
        with EpisodeWriter(target, metadata, durable=False) as writer:
            for name in episode.streams:
                writer.copy_stream(episode, name)
            writer.copy_group(episode, "calibration")
            writer.copy_derived(episode)


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    for name in ("source", "edit", "target"):
        parser.add_argument(name, type=Path, metavar=name.upper())
    arguments = parser.parse_args()
    try:
        changes = json.loads(arguments.edit.read_bytes())["set"]
        edit(arguments.source, changes, arguments.target)
    except ExumiError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
