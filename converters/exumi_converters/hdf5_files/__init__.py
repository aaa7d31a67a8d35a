"""Format ``hdf5``: robomimic's files of demonstrations, and FreeTacMan's file an episode."""

__all__: list[str] = []
