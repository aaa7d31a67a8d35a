"""The next batch travels to the device while the current one is used."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import torch
from torch import Tensor

__all__ = ["DeviceBatches", "prefetch_to_device"]

Move = Callable[[Tensor], Tensor]


def prefetch_to_device(
    loader: Iterable[Any],
    device: torch.device | str,
    *,
    transform: Callable[[Any], Any] | None = None,
) -> "DeviceBatches":
    """Copy batches to a device ahead of their use.

    On CUDA the next batch is pinned, copied and transformed on a stream of its own while the
    current one is used; the memory of a batch is not used again before the work that was queued
    with it is done. On the CPU batches pass through, and on other devices they are copied.

    Parameters
    ----------
    loader : iterable
        Of tensors, or of (nested) dicts, lists and tuples of tensors. What is no tensor stays.
    device : torch.device or str
    transform : callable, optional
        Applied to each batch on the device, on the same stream as the copy: such as a
        ``torch.nn.Sequential`` of the modules of `exumi_loaders.device`.

    Returns
    -------
    DeviceBatches
        Iterate it as often as the loader. It has the loader's length.

    Examples
    --------
    >>> import torch
    >>> [batch["x"].sum().item() for batch in prefetch_to_device([{"x": torch.ones(3)}], "cpu")]
    [3.0]
    """
    return DeviceBatches(loader, torch.device(device), transform)


class DeviceBatches:
    """Batches of a loader, on a device; made by `prefetch_to_device`."""

    def __init__(
        self,
        loader: Iterable[Any],
        device: torch.device,
        transform: Callable[[Any], Any] | None,
    ) -> None:
        self.loader = loader
        self.device = device
        self._transform = transform

    def __len__(self) -> int:
        return len(self.loader)  # type: ignore[arg-type]  # an iterable without one says so itself

    def __iter__(self) -> Iterator[Any]:
        return self._ahead() if self.device.type == "cuda" else self._directly()

    def _directly(self) -> Iterator[Any]:
        for batch in self.loader:
            yield self._prepared(_mapped(batch, lambda tensor: tensor.to(self.device)))

    def _ahead(self) -> Iterator[Any]:
        side = torch.cuda.Stream(self.device)  # type: ignore[no-untyped-call]  # torch's
        # What the transform holds (weights, buffers) was written on the stream in use.
        side.wait_stream(torch.cuda.current_stream(self.device))
        waiting: tuple[Any, torch.cuda.Event] | None = None
        for batch in self.loader:
            sent = self._sent(batch, side)
            if waiting is not None:
                yield self._received(*waiting)
            waiting = sent
        if waiting is not None:
            yield self._received(*waiting)

    def _sent(self, batch: Any, side: torch.cuda.Stream) -> tuple[Any, torch.cuda.Event]:
        with torch.cuda.stream(side):
            moved = self._prepared(_mapped(batch, self._copied))
            done = torch.cuda.Event()  # type: ignore[no-untyped-call]  # torch's
            done.record(side)
        return moved, done

    def _copied(self, tensor: Tensor) -> Tensor:
        if tensor.device.type == "cpu" and not tensor.is_pinned():
            # The allocator of pinned memory waits for the copy before it gives the block away.
            tensor = tensor.pin_memory()
        return tensor.to(self.device, non_blocking=True)

    def _received(self, batch: Any, done: torch.cuda.Event) -> Any:
        # An event for each batch: the stream itself is already busy with the next one.
        current = torch.cuda.current_stream(self.device)
        current.wait_event(done)

        def used_here(tensor: Tensor) -> Tensor:
            if tensor.is_cuda:
                tensor.record_stream(current)
            return tensor

        return _mapped(batch, used_here)

    def _prepared(self, batch: Any) -> Any:
        return batch if self._transform is None else self._transform(batch)


def _mapped(value: Any, move: Move) -> Any:
    """Apply a function to all tensors of a nested structure."""
    if isinstance(value, Tensor):
        return move(value)
    if isinstance(value, dict):
        return {name: _mapped(item, move) for name, item in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*(_mapped(item, move) for item in value))
    if isinstance(value, list | tuple):
        return type(value)(_mapped(item, move) for item in value)
    return value
