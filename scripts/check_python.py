"""Say clearly, before anything is installed, when this Python is too old.

Written so that any Python 3 can run it as far as the message.
"""

import sys

OLDEST = (3, 11)

if sys.version_info < OLDEST:
    sys.exit(
        "exUMI Data needs Python 3.11 or newer, and {} is Python {}.{}.\n"
        "Name a newer one: make setup PYTHON=python3.12".format(
            sys.executable, *sys.version_info[:2]
        )
    )
