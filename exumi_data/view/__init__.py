"""Episodes in the Rerun viewer: every stream at its own times, in a layout that fits them.

`saving.save_view` writes a Rerun recording (``.rrd``), `looking.look` opens one in the native
viewer, `serving.served` in the browser. They need the extra ``view``; importing this package does
not.
"""

__all__: list[str] = []
