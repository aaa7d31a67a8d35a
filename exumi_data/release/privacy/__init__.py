"""What in a dataset may be private: found, and kept or taken out before it is released."""

from exumi_data.release.privacy.documents import Removal
from exumi_data.release.privacy.finding import find_private, people_of, private_in
from exumi_data.release.privacy.kinds import (
    KINDS,
    Kind,
    PrivateItem,
    check_kinds,
    counted,
    unresolved,
)
from exumi_data.release.privacy.removing import (
    REMOVAL_STEP,
    Cleaned,
    dataset_without_private,
    remove_private,
    without_private,
)

__all__ = [
    "KINDS",
    "REMOVAL_STEP",
    "Cleaned",
    "Kind",
    "PrivateItem",
    "Removal",
    "check_kinds",
    "counted",
    "dataset_without_private",
    "find_private",
    "people_of",
    "private_in",
    "remove_private",
    "unresolved",
    "without_private",
]
