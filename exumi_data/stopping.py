"""What a signal that ends the program raises, so that it unwinds and tidies up."""

__all__ = ["Stopped"]


class Stopped(SystemExit):
    """Somebody told this process to end: nobody may go on for what follows.

    Apart from a `SystemExit` that code of a third party raises, which concerns that code alone.
    """
