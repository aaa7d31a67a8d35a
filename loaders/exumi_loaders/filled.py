"""Batches that are filled already: what a DataLoader need not collate."""

from typing import Any, NoReturn

from exumi_data.errors import UsageError

__all__ = ["FilledBatch"]


class FilledBatch(dict[str, Any]):
    """A dict of tensors with one axis for the batch; not the list that PyTorch collates."""

    def __missing__(self, key: object) -> NoReturn:
        if isinstance(key, int):  # PyTorch's default collate function asks for the first item
            raise UsageError(
                "the windows have filled a whole batch, which is not to be collated",
                fix="Take .loader(batch_size), or give your DataLoader a collate_fn that returns "
                "what it is given.",
            )
        raise KeyError(key)
