"""Whether this is an episode, of a version and with features that are known.

Nothing else can be judged where these rules are broken.
"""

from collections.abc import Iterator

from exumi_data.model.episode import CONVENTION_UUID, EPISODE_FORMAT
from exumi_validators.context import EXUMI, ROOT, EpisodeContext
from exumi_validators.document_rules import DOCUMENT_RULES, document_problems
from exumi_validators.findings import problem
from exumi_validators.registry import check
from exumi_validators.report import Problem

__all__ = ["conventions", "documents", "root_group"]

_DERIVED_FORMAT = "exumi-derived"


@check(*DOCUMENT_RULES)
def documents(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge the root's document and that of ``derived``."""
    derived = episode.load("derived/zarr.json")
    if episode.root is not None:
        yield from document_problems(episode.root, episode.document, EPISODE_FORMAT, EXUMI)
    if derived is not None:
        yield from document_problems(derived, episode.derived_document, _DERIVED_FORMAT, EXUMI)


@check("ROOT-001")
def root_group(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the root is a group with an ``exumi`` attribute."""
    root = episode.root
    if root is None:
        if "." in episode.listing.closed:
            return  # nobody knows: the folder is listed as not checked
        is_special = ROOT in episode.listing.links
        detail = "zarr.json is a link or a special file" if is_special else "there is no zarr.json"
        yield problem("ROOT-001", ROOT, detail=detail)
    elif root.value is None:
        return
    elif root.value.get("zarr_format") != 3 or root.value.get("node_type") != "group":
        yield problem("ROOT-001", ROOT, pointer=(), detail="the root is not a Zarr v3 group")
    elif episode.document is None:
        yield problem("ROOT-001", ROOT, pointer=EXUMI, detail="the root has no attribute `exumi`")


@check("ROOT-002")
def conventions(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that generic tools can recognise the format."""
    if episode.root is None or episode.root.value is None or episode.document is None:
        return
    entries = episode.root.value["attributes"].get("zarr_conventions")
    known = entries if isinstance(entries, list) else []
    if not any(isinstance(entry, dict) and entry.get("uuid") == CONVENTION_UUID for entry in known):
        pointer = ("attributes", "zarr_conventions")
        yield problem("ROOT-002", ROOT, pointer=pointer, expected=CONVENTION_UUID)
